"""Feature, estimator and formation node in one process, which hand a frame on without DDS.

Each has its name, parameters, topics and diagnostics as it has in a process of its own. They run in
one thread, so that while a frame is worked on others wait, of which the newest comes next.
"""

from functools import partial

from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared.node import run


def follower() -> tuple[FeatureNode, EstimatorNode, FormationNode]:
    """Return the three nodes, joined."""
    formation = FormationNode(subscribed=False)
    estimator = EstimatorNode(hand_over=formation.on_track)
    return FeatureNode(hand_over=estimator.on_frame), estimator, formation


main = partial(run, follower)
