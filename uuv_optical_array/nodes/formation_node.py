"""From the track of the follower to the velocity command that keeps station behind the leader."""

import math
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from visualization_msgs.msg import MarkerArray

from uuv_optical_array.control.formation import FormationController, FormationSettings
from uuv_optical_array.core.geometry import Array, covariance_5x5
from uuv_optical_array.core.messages import stamp_ns
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.nodes.shared import markers, messages
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.node import LASTING, publish, run, steady_clock, subscribe
from uuv_optical_array.nodes.shared.parameters import Parameter, Parameters, parameters_of, shared

PARAMETERS = {
    **shared("frame_prefix", "base_frame", "beacon_frame"),
    **parameters_of(FormationSettings),
    "rate_hz": Parameter(10.0, Quantity("commands a second", "Hz", 0.1, 1000), True),
    "start_engaged": Parameter(
        True, Quantity("steer from the start, or when ~/engage says so"), True
    ),
}


class FormationNode(Node):
    """Command the follower to its station; slow it to a stop when the light is lost.

    Tracks come by topic where it is `subscribed`; else a node of the same process calls `on_track`.
    The service ``~/engage`` (std_srvs/SetBool) lets it steer, or stops the follower and lets it go.
    """

    def __init__(self, subscribed: bool = True, **options: Any) -> None:
        super().__init__("formation_node", **options)
        self.parameters = Parameters(self, PARAMETERS, self.on_change)
        self.controller = FormationController(self.settings({}))
        self.diagnostics = Diagnostics(self)
        self.commands = publish(self, TwistStamped, "cmd_vel")
        self.shapes = markers.Shapes(self, publish(self, MarkerArray, "markers", LASTING))
        self.shown: Any = None  # frame and station of the marker that was published
        if subscribed:
            subscribe(self, Odometry, "relative_odometry", self.on_message)
        self.create_service(SetBool, "~/engage", self.on_engage)
        self.engage(self.parameters["start_engaged"])
        period_s = 1.0 / self.parameters["rate_hz"]
        self.timer = self.create_timer(period_s, self.on_timer, clock=steady_clock(self))

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

    def on_engage(self, request: Any, response: Any) -> Any:
        """Steer from the next track on, or stop the follower and leave it to others."""
        response.success = True
        response.message = f"it steers to station_m {list(self.parameters['station_m'])}"
        if not request.data:
            response.message = "it commanded a stop, and commands nothing until it is engaged"
        if request.data != self.engaged:
            # Nothing is left of the time before, as others may have commanded since.
            self.controller = FormationController(self.settings({}))
            self.engage(request.data)
            if not request.data:
                self.send(np.zeros(3), np.zeros(3))
        return response

    def engage(self, wanted: bool) -> None:
        """Note whether it steers, and tell the diagnostics."""
        self.engaged = wanted
        self.diagnostics.warn("" if wanted else "not engaged: the follower is left to others")

    def on_change(self, changes: dict[str, Any]) -> None:
        """Take over a parameter that was set while the node runs."""
        self.controller.configure(self.settings(changes))

    def on_message(self, message: Odometry) -> None:
        """Take a track from outside, which may be of anything."""
        given, own = message.header.frame_id, self.parameters.frame("beacon_frame")
        if given == own:
            self.on_track(message)
        else:
            self.diagnostics.refuse(f"wrong frame: the track is in {given!r}, not in {own}")

    def on_track(self, message: Odometry) -> None:
        """Tell the controller where the follower is, and how it moves."""
        stamp = stamp_ns(message.header)
        with self.diagnostics.refusing():
            pose = messages.pose_from_message(message)
            covariance = covariance_5x5(pose, messages.covariance_from_message(message))
            rate = messages.rate_from_message(message)
            self.controller.update(stamp * 1e-9, pose, covariance, rate)
            self.diagnostics.answer(stamp, lambda: {"range_m": f"{-pose[0]:.2f}"})
            self.show_station(message.header.frame_id)

    def show_station(self, frame: str) -> None:
        """Show the station in the frame of the lamp, where it is not there yet."""
        place = list(self.parameters["station_m"])
        if self.shown != (place, frame):
            self.shown = place, frame
            self.shapes.show([markers.station(np.array(place), frame)])

    def on_timer(self) -> None:
        """Publish the command, from the first pose on."""
        now_s = self.get_clock().now().nanoseconds * 1e-9
        command = self.controller.command(now_s) if self.engaged else None
        if command is not None:
            self.send(*command)

    def send(self, linear: Array, angular: Array) -> None:
        """Publish a command, m/s and rad/s."""
        now, frame = self.get_clock().now().to_msg(), self.parameters.frame("base_frame")
        message = messages.twist_to_message(linear, angular, Header(stamp=now, frame_id=frame))
        self.commands.publish(message)


main = partial(run, FormationNode)
