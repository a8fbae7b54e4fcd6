"""Print poses and the follower's state as they come, where there is no `ros2 topic echo`.

Run: python3 listen.py [SECONDS], while `uuv_array follow` or the nodes run
"""

import signal
import sys
import threading
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions


def pose(message: PoseWithCovarianceStamped) -> None:
    """Print where the follower is behind the lamp, and how far that can be trusted."""
    place, variance = message.pose.pose.position, message.pose.covariance
    std = [variance[7 * axis] ** 0.5 for axis in range(3)]
    print(
        f"x {place.x:6.2f} +- {std[0]:.2f}, y {place.y:5.2f} +- {std[1]:.2f},"
        f" z {place.z:5.2f} +- {std[2]:.2f} m"
    )


def state(message: DiagnosticStatus) -> None:
    """Print what the follower does, and why."""
    values = {pair.key: pair.value for pair in message.values}
    print(f"{message.message}: {values['reason']}")


if __name__ == "__main__":
    # By rclpy's own handlers a signal ends the context while it is used.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    node = rclpy.create_node("listen")
    lasting = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(DiagnosticStatus, "follow_state", state, lasting)
    node.create_subscription(
        PoseWithCovarianceStamped, "relative_pose", pose, qos_profile_sensor_data
    )
    end = time.monotonic() + float([*sys.argv[1:], "inf"][0])
    while not stopped.is_set() and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    rclpy.shutdown()
