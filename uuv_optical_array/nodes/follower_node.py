"""Feature, estimator and formation node in one process, which hand a frame on without DDS.

Each has its name, parameters, topics and diagnostics as it has in a process of its own. They run in
one thread, so that while a frame is worked on others wait, of which the newest comes next.
"""

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

    def hand_over(header: Header, parameters: Array | None, image: Array) -> None:
        formation.on_look(header, parameters)
        estimator.on_frame(header, parameters, image)

    return FeatureNode(hand_over=hand_over), estimator, formation


main = partial(run, follower)
