"""From the track of the follower to the velocity command that keeps station behind the leader.

Without light it coasts, searches and ends as `control.following` says, and publishes its state.
"""

import math
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from uuv_optical_array.control.darkness import SearchSettings
from uuv_optical_array.control.following import Following, State
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.motion import Glow
from uuv_optical_array.control.leader.told_motion import Message, twist_of_lamp
from uuv_optical_array.core.geometry import Array, covariance_5x5
from uuv_optical_array.core.messages import checked_twist, stamp_ns, up_of_odometry
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.shared import markers, messages
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.node import LASTING, publish, run, steady_clock, subscribe
from uuv_optical_array.nodes.shared.parameters import Parameter, Parameters, parameters_of, shared
from uuv_optical_array.nodes.shared.stamp_time import StampTime
from uuv_optical_array.nodes.shared.state_teller import StateTeller

PARAMETERS = {
    **shared("scene", "frame_prefix", "base_frame", "beacon_frame", "beacon_position_m"),
    **parameters_of(FormationSettings),
    **parameters_of(SearchSettings),
    "rate_hz": Parameter(10.0, Quantity("rate of the commands", "Hz", 0.1, 1000), True),
    "start_engaged": Parameter(
        True, Quantity("steer from the start; false: steer when ~/engage says so"), True
    ),
    "use_odometry": Parameter(
        False,
        Quantity("read the follower's own motion from odometry, for times without light"),
        True,
    ),
    "use_leader_odometry": Parameter(
        False, Quantity("read the leader's own motion from leader/odometry"), True
    ),
}
ENOUGH = 0.7  # of max_surge_m_per_s, that a follower at its station has to be allowed


class FormationNode(Node):
    """Command the follower to its station, and to find its leader again when the light is gone.

    Tracks and key parameters come by topic where they are `subscribed`; else nodes of the same
    process call `on_track`, `on_look` and `on_faint_light`. The service ``~/engage``
    (std_srvs/SetBool) lets it steer, or stops the follower and lets it go; ``~/search``
    (std_srvs/Trigger) begins a search.
    """

    def __init__(self, subscribed: bool = True, **options: Any) -> None:
        super().__init__("formation_node", **options)
        self.parameters = Parameters(self, PARAMETERS, self.on_change)
        self.following = Following(*self.settings({}))
        self.time = StampTime(self)
        side = load_scene(self.parameters["scene"]).array.detectors_per_side
        self.half = max((side - 1) / 2, 0.5)  # detectors from the array's middle to its edge
        self.diagnostics = Diagnostics(self)
        self.commands = publish(self, TwistStamped, "cmd_vel")
        self.shapes = markers.Shapes(self, publish(self, MarkerArray, "markers", LASTING))
        self.station: tuple[list[float], str] | None = None  # of the marker, and its frame
        self.teller = StateTeller(self, publish(self, DiagnosticStatus, "follow_state", LASTING))
        if subscribed:
            subscribe(self, Odometry, "relative_odometry", self.on_message)
            subscribe(self, PointCloud2, "array/features", self.on_features)
            subscribe(self, PointCloud2, "array/faint_features", self.on_faint_features)
        if self.parameters["use_odometry"]:
            subscribe(self, Odometry, "odometry", self.on_odometry)
        if self.parameters["use_leader_odometry"]:
            subscribe(self, Odometry, "leader/odometry", self.on_leader)
        self.create_service(SetBool, "~/engage", self.on_engage)
        self.create_service(Trigger, "~/search", self.on_search)
        if not self.parameters["start_engaged"]:
            self.following.engage(False, self.time.now_s())
        self.slow = slow_station(self.settings({})[0])
        self.tell_state()
        period_s = 1.0 / self.parameters["rate_hz"]
        self.timer = self.create_timer(period_s, self.on_timer, clock=steady_clock(self))

    def settings(self, changes: dict[str, Any]) -> tuple[FormationSettings, SearchSettings]:
        """Return the settings with a change; ValueError for a station that cannot be reached."""
        settings = self.parameters.settings(FormationSettings, changes)
        range_m = math.hypot(*settings.station_m)
        if range_m < settings.min_distance_m:
            raise ValueError(
                f"min_distance_m: {settings.min_distance_m:g} is beyond the station, which is "
                f"{range_m:.3g} m from the lamp; lower it, or move station_m away"
            )
        return settings, self.parameters.settings(SearchSettings, changes)

    @property
    def engaged(self) -> bool:
        """Whether it steers."""
        return self.following.state.name != "disengaged"

    def on_engage(self, request: Any, response: Any) -> Any:
        """Steer once new poses agree, or stop the follower and leave it to others."""
        response.success = True
        response.message = f"it steers to station_m {list(self.parameters['station_m'])}"
        if not request.data:
            response.message = "it commanded a stop, and commands nothing until it is engaged"
        if request.data != self.engaged:
            # Nothing is left of the time before, as others may have commanded since.
            self.following.engage(request.data, self.time.now_s())
            self.tell_state()
            if not request.data:
                self.send(np.zeros(3), np.zeros(3))
        return response

    def on_search(self, request: Any, response: Any) -> Any:
        """Search for the leader now, unless it is seen, images are missing or others steer."""
        name = self.following.state.name
        response.success = False
        if name == "disengaged":
            response.message = "it is not engaged: call ~/engage with true first"
        elif name == "locked":
            response.message = "it is locked: the leader's light steers"
        elif not self.following.images_come(self.time.now_s()):
            response.message = "no image comes, so that a search would be blind"
        else:
            self.following.search(self.time.now_s())
            response.success = True
            self.tell_state()
            response.message = f"it searches for {self.parameters['search_time_s']:g} s at most"
        return response

    def tell_state(self) -> None:
        """Publish a state that is new."""
        if self.teller.note(self.following.state):
            self.show()
        self.diagnostics.warn(self.slow, self.teller.warning)

    def on_change(self, changes: dict[str, Any]) -> None:
        """Take over a parameter that was set while the node runs."""
        settings, search = self.settings(changes)
        self.following.configure(settings, search)
        self.slow = slow_station(settings)
        self.tell_state()

    def on_message(self, message: Odometry) -> None:
        """Take a track from outside, which may be of anything."""
        given, own = message.header.frame_id, self.parameters.frame("beacon_frame")
        if given == own:
            self.on_track(message)
        else:
            self.diagnostics.refuse(f"wrong frame: the track is in {given!r}, not in {own}")

    def on_track(self, message: Odometry) -> None:
        """Tell the law where the follower is, and how it moves."""
        stamp = stamp_ns(message.header)
        with self.diagnostics.refusing():
            pose = messages.pose_from_message(message)
            covariance = covariance_5x5(pose, messages.covariance_from_message(message))
            rate = messages.rate_from_message(message)
            spread = None
            if self.parameters["use_leader_odometry"]:
                spread = messages.rate_covariance_from_message(message)
            self.following.update(self.time.of(stamp, "track"), pose, covariance, rate, spread)
            self.diagnostics.take(stamp, lambda: {"range_m": f"{-pose[0]:.2f}"})
            self.show_station(message.header.frame_id)
        self.tell_state()

    def on_features(self, message: PointCloud2) -> None:
        """Take what a topic says of an image, with light or without."""
        with self.diagnostics.refusing():
            self.on_look(message.header, messages.features_from_message(message))

    def on_look(self, header: Header, parameters: Array | None) -> None:
        """Note that an image was taken, and by its key parameters where it is brightest."""
        glow = None if parameters is None else self.glow(parameters)
        self.following.looked(self.time.of(stamp_ns(header), "features"), glow)

    def on_faint_features(self, message: PointCloud2) -> None:
        """Take what a topic says of light that no single image shows."""
        with self.diagnostics.refusing():
            parameters = messages.features_from_message(message)
            if parameters is not None:
                self.on_faint_light(message.header, parameters)

    def on_faint_light(self, header: Header, parameters: Array) -> None:
        """Let light that no single image shows guide a search, by its key parameters."""
        stamp_s = self.time.of(stamp_ns(header), "faint_features")
        self.following.glimmered(stamp_s, self.glow(parameters))

    def glow(self, parameters: Array) -> Glow:
        """Return where the array is lit brightest, by key parameters."""
        peak, to_starboard, down, *_ = parameters.tolist()
        return Glow(-to_starboard / self.half, -down / self.half, peak)

    def on_odometry(self, message: Odometry) -> None:
        """Tell the law how the follower moves by its own instruments."""
        with self.diagnostics.refusing("odometry"):
            linear, angular = checked_twist(message.twist.twist, message.child_frame_id)
            up = up_of_odometry(message)
            stamp_s = self.time.of(stamp_ns(message.header), "odometry")
            self.following.moved(stamp_s, linear, angular, up)

    def on_leader(self, message: Odometry) -> None:
        """Tell the law how the leader moves, by a modem or a test tank."""
        with self.diagnostics.refusing("leader/odometry"):
            twist = np.concatenate(checked_twist(message.twist.twist, message.child_frame_id))
            covariance = messages.twist_covariance_from_message(message)
            twist, covariance = twist_of_lamp(
                self.parameters["beacon_position_m"], twist, covariance
            )
            stamp_s = self.time.of(stamp_ns(message.header), "leader/odometry")
            told = Message(stamp_s, twist[:3], twist[3:], covariance)
            self.following.leader_moves(self.time.now_s(), told)

    def show_station(self, frame: str) -> None:
        """Show the station in the frame of the lamp, where it is not there yet."""
        station = list(self.parameters["station_m"]), frame
        if self.station != station:
            self.station = station
            self.show()

    def show(self) -> None:
        """Show the state above the follower, and the station."""
        told: State = self.teller.state
        shapes = [markers.state(told, self.parameters.frame("base_frame"))]
        if self.station is not None:
            place, frame = self.station
            shapes.append(markers.station(np.array(place), frame))
        self.shapes.show(shapes)

    def on_timer(self) -> None:
        """Publish the command, once poses agree for the first time, or from the first search on."""
        command = self.following.command(self.time.now_s())
        if command is not None:
            self.send(*command)
        self.tell_state()

    def send(self, linear: Array, angular: Array) -> None:
        """Publish a command, m/s and rad/s."""
        now, frame = self.get_clock().now().to_msg(), self.parameters.frame("base_frame")
        message = messages.twist_to_message(linear, angular, Header(stamp=now, frame_id=frame))
        if self.commands.publish(message):
            self.diagnostics.answer()


def slow_station(s: FormationSettings) -> str:
    """Say that the minimum distance slows a follower at its station; empty where it does not."""
    if s.min_distance_m == 0:
        return ""
    # As the law caps the speed towards the lamp, so as to stop when the light goes out.
    spare_m = math.hypot(*s.station_m) - s.min_distance_m
    most = spare_m / s.blind_s
    if most >= ENOUGH * s.max_surge_m_per_s:
        return ""
    return (
        f"slow station: {spare_m:.3g} m from the minimum distance a follower swims {most:.2g} m/s "
        f"at most, and max_surge_m_per_s is {s.max_surge_m_per_s:g}"
    )


main = partial(run, FormationNode)
