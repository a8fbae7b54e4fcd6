"""What the nodes of one process publish, recorded in a bag; rosbag2 is not needed."""

from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, PointCloud2

from uuv_optical_array.recording.bag import BagWriter

TOPICS: dict[str, Any] = {
    "array/image": Image,
    "array/features": PointCloud2,
    "relative_pose": PoseWithCovarianceStamped,
    "relative_odometry": Odometry,
    "leader/odometry": Odometry,
    "follower/odometry": Odometry,
}
DEPTH = 100  # reliable and deep: what is recorded should lack nothing


class BagRecorderNode(Node):
    """Write each message of `TOPICS` as it came, and when; options as of `Node`."""

    def __init__(self, bag: BagWriter, **options: Any) -> None:
        super().__init__("bag_recorder_node", **options)
        self.bag = bag
        for topic, kind in TOPICS.items():
            name = self.resolve_topic_name(topic)
            self.create_subscription(
                kind, topic, partial(self.on_message, name, kind), QoSProfile(depth=DEPTH), raw=True
            )

    def on_message(self, topic: str, kind: type, data: bytes) -> None:
        """Write one message."""
        package, _, _ = kind.__module__.partition(".")
        now = self.get_clock().now().nanoseconds
        self.bag.write(topic, f"{package}/msg/{kind.__name__}", now, bytes(data))
