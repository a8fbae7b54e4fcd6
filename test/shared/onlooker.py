"""An estimator that sees what a study shows it."""

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.estimator import Estimator


class Onlooker(Estimator):
    """An estimator that keeps the images it is given, and knows no pose."""

    def __init__(self, scene):
        super().__init__(scene, compiled=False)
        self.images = []

    def estimate(self, image, *rest, **options):
        self.images.append(image)
        raise NoPose("it only looks")
