"""The demonstration's two vehicles: a leader on its path and a follower that obeys ``cmd_vel``.

The leader sets off at the first command: the formation control sends none before it has a pose.
"""

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.time import Time

from uuv_optical_array.control.vehicles import Vehicle, leader_twist, start_behind
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.messages import (
    Refused,
    twist_from_message,
    write_pose,
    write_twist,
)
from uuv_optical_array.nodes.shared.node import publish, run, subscribe, transform_publisher
from uuv_optical_array.nodes.shared.parameters import (
    FRAME_PREFIX,
    PUBLISH_TF,
    Parameter,
    Parameters,
)

PARAMETERS = {
    "rate_hz": Parameter(10.0, Quantity("odometry messages a second", "Hz", 1, 1000), True),
    "station_m": Parameter(
        [-6.0, 0.0, 0.0],
        Quantity("station in the leader's base_link, near which the follower starts", "m", -50, 50),
        True,
    ),
    "command_timeout_s": Parameter(
        1.0, Quantity("the follower stops when cmd_vel is older than this", "s", 0.05, 60)
    ),
    "world_frame": Parameter("odom", Quantity("frame of both odometries"), True),
    "frame_prefix": FRAME_PREFIX,
    "publish_tf": PUBLISH_TF,
}


class VehiclesNode(Node):
    """Move both vehicles by the node's clock and publish where they are."""

    def __init__(self) -> None:
        super().__init__("vehicles_node")
        self.parameters = Parameters(self, PARAMETERS)
        self.leader = Vehicle(np.zeros(3))
        self.follower = start_behind(self.leader, self.parameters["station_m"])
        self.path_s: float | None = None  # time on the leader's path, once it has set off
        self.moved: Time | None = None
        self.commanded = self.get_clock().now()
        self.command: tuple[Array, Array] = np.zeros(3), np.zeros(3)
        self.diagnostics = Diagnostics(self)
        self.diagnostics.warn("leader waits: no cmd_vel has come yet")
        self.odometry = {
            name: publish(self, Odometry, f"{name}/odometry") for name in ("leader", "follower")
        }
        self.send_transform = transform_publisher(self, self.parameters["publish_tf"])
        subscribe(self, TwistStamped, "cmd_vel", self.on_command)
        self.timer = self.create_timer(1.0 / self.parameters["rate_hz"], self.on_timer)

    def on_command(self, message: TwistStamped) -> None:
        """Remember what the follower is to do."""
        try:
            self.command = twist_from_message(message)
        except Refused as reason:
            self.diagnostics.refuse(f"cmd_vel, {reason}")
            return
        self.commanded = self.get_clock().now()
        if self.path_s is None:
            self.path_s = 0.0
            self.diagnostics.warn("")
        self.diagnostics.answer()

    def on_timer(self) -> None:
        """Move both vehicles to the present and publish their odometry."""
        now = self.get_clock().now()
        if self.moved is None or now < self.moved:
            # The first tick, or a clock that was set back: begin here.
            self.moved = self.commanded = now
        step_s = (now - self.moved).nanoseconds * 1e-9
        self.moved = now
        if (now - self.commanded).nanoseconds * 1e-9 > self.parameters["command_timeout_s"]:
            self.command = np.zeros(3), np.zeros(3)
        if self.path_s is not None:
            self.leader.step(*leader_twist(self.path_s + step_s / 2), step_s)
            self.path_s += step_s
        self.follower.step(*self.command, step_s)
        self.publish_odometry("leader", self.leader, now)
        self.publish_odometry("follower", self.follower, now)

    def publish_odometry(self, name: str, vehicle: Vehicle, now: Time) -> None:
        """Publish one vehicle's pose and velocity."""
        prefix = self.parameters["frame_prefix"]
        message = Odometry(child_frame_id=f"{prefix}{name}/base_link")
        message.header.stamp = now.to_msg()
        message.header.frame_id = self.parameters.frame("world_frame")
        write_pose(message.pose.pose, vehicle.position, vehicle.pitch, vehicle.yaw)
        write_twist(message.twist.twist, vehicle.linear, vehicle.angular)
        self.odometry[name].publish(message)
        self.send_transform(message.header, message.child_frame_id, message.pose.pose)


def main(args: list[str] | None = None) -> None:
    """Run the node."""
    run(VehiclesNode, args)
