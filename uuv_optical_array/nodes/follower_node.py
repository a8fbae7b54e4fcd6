"""Feature, estimator and formation node in one process, which hand a frame on without DDS.

Each has its name, parameters, topics and diagnostics as it has in a process of its own. They run in
one thread, so that while a frame is worked on others wait, of which the newest comes next.
"""

from collections.abc import Callable
from functools import partial

from std_msgs.msg import Header

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared.node import run


def follower() -> tuple[FeatureNode, EstimatorNode, FormationNode]:
    """Return the three nodes, joined."""
    formation = FormationNode(subscribed=False)
    estimator = EstimatorNode(hand_over=formation.on_track)

    def on_image(header: Header, image: Array, features: Callable[[], Array | None]) -> None:
        if estimator.fits:  # so that the pose waits for no key parameters
            estimator.on_image(header, image)
        else:
            estimator.on_features(header, features(), image)

    def on_look(header: Header, parameters: Array | None, faint: Array | None) -> None:
        formation.on_look(header, parameters)
        if faint is not None:
            formation.on_faint_light(header, faint)
        estimator.rest.finish()

    return FeatureNode(on_image, on_look), estimator, formation


main = partial(run, follower)
