"""From the track of the follower to the velocity command that keeps station behind the leader."""

import math
from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from std_msgs.msg import Header

from uuv_optical_array.control.formation import FormationController, FormationSettings
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import covariance_5x5
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.messages import (
    Refused,
    covariance_from_message,
    pose_from_message,
    rate_from_message,
    stamp_ns,
    twist_to_message,
)
from uuv_optical_array.nodes.shared.node import publish, run, subscribe
from uuv_optical_array.nodes.shared.parameters import Parameter, Parameters, parameters_of, shared

PARAMETERS = {
    **shared("frame_prefix", "base_frame"),
    **parameters_of(FormationSettings),
    "rate_hz": Parameter(10.0, Quantity("commands a second", "Hz", 0.1, 1000), True),
}


class FormationNode(Node):
    """Command the follower to its station; slow it to a stop when the light is lost.

    Tracks come by topic where it is `subscribed`; else a node of the same process calls `on_track`.
    """

    def __init__(self, subscribed: bool = True, **options: Any) -> None:
        super().__init__("formation_node", **options)
        self.parameters = Parameters(self, PARAMETERS, self.on_change)
        self.controller = FormationController(self.settings({}))
        self.diagnostics = Diagnostics(self)
        self.commands = publish(self, TwistStamped, "cmd_vel")
        if subscribed:
            subscribe(self, Odometry, "relative_odometry", self.on_track)
        self.timer = self.create_timer(1.0 / self.parameters["rate_hz"], self.on_timer)

    def settings(self, changes: dict[str, Any]) -> FormationSettings:
        """Return the settings with a change; ValueError for a station that cannot be reached."""
        settings = self.parameters.settings(FormationSettings, changes)
        range_m = math.hypot(*settings.station_m)
        if range_m < settings.min_distance_m:
            raise ValueError(
                f"min_distance_m: {settings.min_distance_m:g} is beyond the station, which is "
                f"{range_m:.3g} m from the lamp; lower it, or move station_m away"
            )
        return settings

    def on_change(self, changes: dict[str, Any]) -> None:
        """Take over a parameter that was set while the node runs."""
        self.controller.configure(self.settings(changes))

    def on_track(self, message: Odometry) -> None:
        """Tell the controller where the follower is, and how it moves."""
        try:
            pose = pose_from_message(message)
            covariance = covariance_5x5(pose, covariance_from_message(message))
            rate = rate_from_message(message)
            self.controller.update(stamp_ns(message.header) * 1e-9, pose, covariance, rate)
        except (Refused, NoPose, ValueError) as reason:
            self.diagnostics.refuse(str(reason))
            return
        self.diagnostics.answer(stamp_ns(message.header), lambda: {"range_m": f"{-pose[0]:.2f}"})

    def on_timer(self) -> None:
        """Publish the command, from the first pose on."""
        now = self.get_clock().now()
        command = self.controller.command(now.nanoseconds * 1e-9)
        if command is not None:
            header = Header(stamp=now.to_msg(), frame_id=self.parameters.frame("base_frame"))
            self.commands.publish(twist_to_message(*command, header))


def main(args: list[str] | None = None) -> None:
    """Run the node."""
    run(FormationNode, args)
