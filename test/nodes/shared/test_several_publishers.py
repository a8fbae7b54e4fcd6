"""Two publishers where there is to be one: the nodes at both ends name them while it lasts."""

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, PointCloud2

from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.vehicles_node import VehiclesNode

WARN = DiagnosticStatus.WARN


def stranger(lab, message_type, topic):
    """Return another node that publishes on a topic."""
    node = rclpy.create_node("stranger", namespace="/far", use_global_arguments=False)
    lab.executor.add_node(node)
    lab.nodes.append(node)
    node.create_publisher(message_type, topic, 1)
    return node


@pytest.mark.parametrize(
    ("node_type", "message_type", "topic", "other"),
    [
        (FeatureNode, Image, "/array/image", "/probe"),  # both are others than the node
        (FeatureNode, PointCloud2, "/array/features", "/feature_node"),
        (FormationNode, TwistStamped, "/cmd_vel", "/formation_node"),
        (VehiclesNode, Odometry, "/leader/odometry", "/vehicles_node"),
    ],
)
def test_the_diagnostics_name_both_until_one_is_gone(lab, node_type, message_type, topic, other):
    lab.begin()
    node = lab.start(node_type)
    if other == "/probe":
        lab.talk(message_type, topic)
    lab.until(lambda: node.count_publishers(topic) == 1, "the first publisher")
    node.diagnostics.warn("")  # of a leader that waits
    lab.report(node, WARN, "no input")
    second = stranger(lab, message_type, topic)
    words = f"several publishers: {topic} of", "/far/stranger", other, "ROS_DOMAIN_ID"
    lab.report(node, WARN, *words)
    lab.executor.remove_node(second)
    lab.nodes.remove(second)
    second.destroy_node()
    lab.report(node, WARN, "no input")


def test_one_publisher_each_is_no_reason_to_warn(lab):
    lab.begin()
    node = lab.start(FeatureNode)
    lab.talk(Image, "array/image")
    lab.listen(PointCloud2, "array/features")
    lab.connect()
    lab.report(node, WARN, "no input")
