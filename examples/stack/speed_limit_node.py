"""A node of one's own between `formation_node` and the vehicle: no command is faster than a limit.

It reads ``cmd_vel`` and publishes ``cmd_vel_limited``, for ``python3 speed_limit_node.py``.
test_stack.py beside it tests it with the whole package.
"""

import math

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


class SpeedLimitNode(Node):
    """Pass commands on, those that are too fast shortened to ``max_speed_m_per_s``."""

    def __init__(self) -> None:
        super().__init__("speed_limit_node")
        self.fastest = self.declare_parameter("max_speed_m_per_s", 0.7).value
        self.publisher = self.create_publisher(TwistStamped, "cmd_vel_limited", 10)
        self.create_subscription(TwistStamped, "cmd_vel", self.limit, 10)

    def limit(self, command: TwistStamped) -> None:
        """Publish a command with its direction and at most the limit's speed."""
        velocity = command.twist.linear
        speed = math.hypot(velocity.x, velocity.y, velocity.z)
        if speed > self.fastest:
            shorter = self.fastest / speed
            velocity.x, velocity.y, velocity.z = (
                shorter * value for value in (velocity.x, velocity.y, velocity.z)
            )
        self.publisher.publish(command)


if __name__ == "__main__":
    rclpy.init()
    try:
        rclpy.spin(SpeedLimitNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
