"""The demonstration's vehicles: a leader on its path and a follower that obeys ``cmd_vel``.

The leader sets off once every follower has been commanded, which the formation control does from
the first pose on, and has the fit that it will keep: while a fit is compiled, frames may be late.
A follower that says by its ``follow_state`` that it has not found the leader is waited for. Then
the sea begins to move too. ``cmd_vel`` is a velocity through the water; the leader can see the
ground, and steers against the current. Each can be alone, so that several followers share a leader.

Once ``leader/cmd_vel`` comes, the leader waits for no follower and obeys these commands only: it
has left its path for good, and stops in the water when the commands end.
"""

from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.time import Time

from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.vehicles.leader_path import lead, leader_path
from uuv_optical_array.control.vehicles.models import MODELS
from uuv_optical_array.control.vehicles.sea import CURRENT, Sea, WaveSettings
from uuv_optical_array.control.vehicles.vehicle import Vehicle, start_behind
from uuv_optical_array.core.messages import odometry_pose
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.nodes.shared import messages
from uuv_optical_array.nodes.shared.attitude import roll_pitch_yaw
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.helm import Helm
from uuv_optical_array.nodes.shared.node import (
    LASTING,
    publish,
    run,
    steady_clock,
    subscribe,
    transform_publisher,
)
from uuv_optical_array.nodes.shared.parameters import Parameter, Parameters, parameters_of, shared
from uuv_optical_array.nodes.shared.waiting import Waiting

# Of the velocities, (m/s)^2 and (rad/s)^2, as a test tank's tracking would know them.
TWIST_COVARIANCE = np.diag(np.repeat([0.02, 0.02], 3) ** 2).ravel()
# A longer step, in periods and in seconds, is not made: the clock jumped, or the node slept.
PAUSE_PERIODS, PAUSE_S = 5, 1.0

PARAMETERS = {
    **shared("frame_prefix", "publish_tf"),
    "vehicles": Parameter(
        "both",
        Quantity("vehicles that swim; a follower alone starts from the leader's odometry"),
        True,
        ("both", "leader", "follower"),
    ),
    "followers": Parameter(
        1,
        Quantity(
            "number of followers that a leader alone waits for: follower_1/cmd_vel, ...", "", 1, 100
        ),
        True,
    ),
    "vehicle_model": Parameter(
        "kinematic",
        Quantity("model of the vehicles: velocities within limits, or a BlueROV2"),
        True,
        tuple(MODELS),
    ),
    "leader_path": Parameter(
        "demonstration",
        Quantity("path of the leader: the name of a ready one, or a CSV file"),
        True,
    ),
    "current_m_per_s": Parameter([0.0, 0.0, 0.0], CURRENT),
    **parameters_of(WaveSettings),
    "rate_hz": Parameter(10.0, Quantity("rate of the odometry messages", "Hz", 1, 1000), True),
    "station_m": Parameter(
        list(FormationSettings.station_m),
        Quantity("station in the leader's base_link; the follower starts near it", "m", -50, 50),
        True,
    ),
    "command_timeout_s": Parameter(
        1.0, Quantity("age of cmd_vel beyond which its vehicle stops", "s", 0.05, 60)
    ),
    "world_frame": Parameter("odom", Quantity("frame of the odometries"), True),
}


class VehiclesNode(Node):
    """Move the vehicles and publish where they are; options as of `Node`.

    They move by the time of a steady clock, or of the simulated one, whose jumps do not move them.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("vehicles_node", **options)
        self.parameters = Parameters(self, PARAMETERS, self.on_change)
        self.on_change({})
        self.model = MODELS[self.parameters["vehicle_model"]]
        self.path = leader_path(self.parameters["leader_path"])
        self.vehicles: dict[str, Vehicle] = {}
        self.path_s: float | None = None  # time since the leader set off
        self.on_path = True
        self.clock = steady_clock(self)
        self.moved: Time | None = None
        self.helms = {name: Helm(self.clock) for name in ("leader", "follower")}
        self.diagnostics = Diagnostics(self)
        role = self.parameters["vehicles"]
        self.odometry = {
            name: publish(self, Odometry, f"{name}/odometry")
            for name in ("leader", "follower")
            if role in (name, "both")
        }
        self.send_transform = transform_publisher(self, self.parameters["publish_tf"])
        numbers = range(1, self.parameters["followers"] + 1) if role == "leader" else []
        self.waiting = Waiting(self, [f"follower_{n}/" for n in numbers] or [""])
        for n in numbers:
            heard = partial(self.on_command, f"follower_{n}/")
            subscribe(self, TwistStamped, f"follower_{n}/cmd_vel", heard)
            told = partial(self.waiting.on_state, f"follower_{n}/")
            subscribe(self, DiagnosticStatus, f"follower_{n}/follow_state", told, qos=LASTING)
        if role != "leader":
            subscribe(self, TwistStamped, "cmd_vel", partial(self.on_command, ""))
        if role == "both":
            told = partial(self.waiting.on_state, "")
            subscribe(self, DiagnosticStatus, "follow_state", told, qos=LASTING)
        if role == "follower":
            self.diagnostics.warn("follower waits: no leader/odometry has come yet")
            subscribe(self, Odometry, "leader/odometry", self.on_leader)
        else:
            heard_of = self.waiting.on_diagnostics
            self.create_subscription(DiagnosticArray, "/diagnostics", heard_of, 100)
            subscribe(self, TwistStamped, "leader/cmd_vel", self.on_leader_command)
            self.diagnostics.warn(self.waiting.text)
            self.vehicles["leader"] = self.model(np.zeros(3))
        if role == "both":
            self.place_follower(self.vehicles["leader"])
        period_s = 1.0 / self.parameters["rate_hz"]
        self.pause_s = max(PAUSE_PERIODS * period_s, PAUSE_S)
        self.timer = self.create_timer(period_s, self.on_timer, clock=self.clock)

    def on_change(self, changes: dict[str, Any]) -> None:
        """Take over the sea of the parameters with changes to them."""
        current = changes.get("current_m_per_s", self.parameters["current_m_per_s"])
        self.sea = Sea(current, self.parameters.settings(WaveSettings, changes))

    def place_follower(self, leader: Vehicle) -> None:
        """Start the follower near its station."""
        self.vehicles["follower"] = start_behind(leader, self.parameters["station_m"])

    def on_leader(self, message: Odometry) -> None:
        """Place a follower without a leader of its own behind the one whose odometry comes."""
        if "follower" in self.vehicles:
            return
        with self.diagnostics.refusing("leader/odometry"):
            position, quaternion = odometry_pose(message)
            _, pitch, yaw = roll_pitch_yaw(quaternion)
            self.place_follower(self.model(position, pitch, yaw))
            self.diagnostics.warn("")

    def on_command(self, space: str, message: TwistStamped) -> None:
        """Take a follower's command; the leader sets off once every follower has had one."""
        with self.diagnostics.refusing("cmd_vel"):
            self.helms["follower"].take(message)
            if self.vehicles and self.path_s is None:
                if "leader" not in self.vehicles or self.waiting.on_command(space):
                    self.set_off()
                else:
                    self.diagnostics.warn(self.waiting.text)
            self.diagnostics.answer()

    def on_leader_command(self, message: TwistStamped) -> None:
        """Take a command of the leader, which leaves its path, or sets off, by the first."""
        with self.diagnostics.refusing("leader/cmd_vel"):
            self.helms["leader"].take(message)
            self.on_path = False
            if self.path_s is None:
                self.set_off()
            self.diagnostics.answer()

    def set_off(self) -> None:
        """Let the leader set off, and the sea move."""
        self.path_s = 0.0
        for vehicle in self.vehicles.values():
            vehicle.t_s = 0.0  # one clock of the sea, however long the leader waited
        self.diagnostics.warn("")

    def on_timer(self) -> None:
        """Move the vehicles to the present and publish their odometry."""
        step_s = self.step_s()
        timeout_s = self.parameters["command_timeout_s"]
        if self.path_s is not None:  # until then the sea is still
            for vehicle in self.vehicles.values():
                vehicle.sea = self.sea
        if "leader" in self.vehicles:
            if not self.on_path:
                self.vehicles["leader"].step(*self.helms["leader"].command(timeout_s), step_s)
            elif self.path_s is not None:
                self.path_s = lead(self.vehicles["leader"], self.path_s, step_s, self.path)
        if "follower" in self.vehicles:
            self.vehicles["follower"].step(*self.helms["follower"].command(timeout_s), step_s)
        stamp = self.get_clock().now()
        for name, vehicle in self.vehicles.items():
            self.publish_odometry(name, vehicle, stamp)

    def step_s(self) -> float:
        """Return the time since the last step; 0 at the first, and where the clock jumped."""
        now = self.clock.now()
        step_s = 0.0 if self.moved is None else (now - self.moved).nanoseconds * 1e-9
        self.moved = now
        if 0 <= step_s <= self.pause_s:
            return step_s
        self.diagnostics.refuse(f"paused: a step of {step_s:.3g} s; the vehicles were not moved")
        return 0.0

    def publish_odometry(self, name: str, vehicle: Vehicle, now: Time) -> None:
        """Publish one vehicle's pose and velocity."""
        child_frame = f"{self.parameters['frame_prefix']}{name}/base_link"
        message = Odometry(child_frame_id=child_frame)
        message.header.stamp = now.to_msg()
        message.header.frame_id = self.parameters.frame("world_frame")
        attitude = vehicle.pitch, vehicle.yaw, vehicle.roll
        messages.write_pose(message.pose.pose, vehicle.position, *attitude)
        messages.write_twist(message.twist.twist, vehicle.linear, vehicle.angular)
        message.twist.covariance = TWIST_COVARIANCE
        self.odometry[name].publish(message)
        self.send_transform(message.header, message.child_frame_id, message.pose.pose)


main = partial(run, VehiclesNode)
