"""Images of a topic handed to a function, until enough were seen."""

from collections.abc import Callable

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.messages import Readout, Refused, image_from_message, stamp_ns
from uuv_optical_array.nodes.shared.messages import StampOrder
from uuv_optical_array.nodes.shared.node import spin, start

WAITING = 1000  # images that are kept while others are looked at


def listen(
    topic: str,
    array: Readout,
    take: Callable[[int, Array], None],
    wanted: Callable[[], bool],
    lamps: int = 1,
) -> None:
    """Hand over each image of a topic while they are wanted, until SIGINT or SIGTERM.

    `take` gets stamp, ns, and counts, ``(lamps side, side)``. Its errors, or `Refused`, end this.
    """
    start(None)
    try:
        node, order = Node("image_listener"), StampOrder()

        def on_image(message: Image) -> None:
            try:
                order.check(message.header)
            except Refused:
                return
            take(stamp_ns(message.header), image_from_message(message, array, lamps))

        qos = QoSProfile(depth=WAITING, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(Image, topic, on_image, qos)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        spin(executor, wanted)
    finally:
        rclpy.try_shutdown()
