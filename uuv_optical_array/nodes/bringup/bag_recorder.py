"""What the nodes of one process publish, recorded in a bag; rosbag2 is not needed."""

from functools import partial
from importlib import import_module
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from uuv_optical_array.recording.bag import RUN, BagWriter

DEPTH = 100  # reliable and deep: what is recorded should lack nothing


class BagRecorderNode(Node):
    """Write each message of `RUN` as it came, and when; options as of `Node`."""

    def __init__(self, bag: BagWriter, **options: Any) -> None:
        super().__init__("bag_recorder_node", **options)
        self.bag = bag
        for topic, kind in RUN.items():
            package, _, name = kind.split("/")
            self.create_subscription(
                getattr(import_module(f"{package}.msg"), name),
                topic,
                partial(self.on_message, self.resolve_topic_name(topic), kind),
                QoSProfile(depth=DEPTH),
                raw=True,
            )

    def on_message(self, topic: str, kind: str, data: bytes) -> None:
        """Write one message."""
        self.bag.write(topic, kind, self.get_clock().now().nanoseconds, bytes(data))
