"""What stands for an estimator or a pipeline: it keeps its images, and answers none."""

from types import SimpleNamespace

from uuv_optical_array.core.errors import NoPose


class Blind:
    def __init__(self, scene):
        self.scene, self.images = scene, []

    def estimate(self, image, parameters=None):
        self.images.append(image)
        raise NoPose("blind")

    def answer(self, stamp_ns, image):
        return SimpleNamespace(track=None)
