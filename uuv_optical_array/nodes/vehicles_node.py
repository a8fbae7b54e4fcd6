"""The demonstration's two vehicles: a leader on its path and a follower that obeys ``cmd_vel``.

The leader sets off once every follower has been commanded, which the formation control does from
the first pose on, and has the fit that it will keep: while a fit is compiled, frames may be late.
Then the sea begins to move too. ``cmd_vel`` is a velocity through the water; the leader can see the
ground, and steers against the current. Each can be alone, so that several followers share a leader.
"""

from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.time import Time

from uuv_optical_array.control.bluerov2 import BlueRov2
from uuv_optical_array.control.formation import FormationSettings
from uuv_optical_array.control.leader_path import lead
from uuv_optical_array.control.sea import CURRENT, Sea, WaveSettings
from uuv_optical_array.control.vehicles import Vehicle, start_behind
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.messages import odometry_pose, twist_from_message
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.nodes.shared import messages
from uuv_optical_array.nodes.shared.attitude import roll_pitch_yaw
from uuv_optical_array.nodes.shared.diagnostics import UNKNOWN, Diagnostics, publishers
from uuv_optical_array.nodes.shared.node import publish, run, subscribe, transform_publisher
from uuv_optical_array.nodes.shared.parameters import Parameter, Parameters, parameters_of, shared

MODELS: dict[str, type[Vehicle]] = dict(kinematic=Vehicle, bluerov2=BlueRov2)

PARAMETERS = {
    **shared("frame_prefix", "publish_tf"),
    "vehicles": Parameter(
        "both",
        Quantity("which swim; a follower alone starts by the leader's odometry"),
        True,
        ("both", "leader", "follower"),
    ),
    "followers": Parameter(
        1, Quantity("that a leader alone waits for: follower_1/cmd_vel, ...", "", 1, 100), True
    ),
    "vehicle_model": Parameter(
        "kinematic", Quantity("velocities within limits, or a BlueROV2 Heavy"), True, tuple(MODELS)
    ),
    "current_m_per_s": Parameter([0.0, 0.0, 0.0], CURRENT),
    **parameters_of(WaveSettings),
    "rate_hz": Parameter(10.0, Quantity("odometry messages a second", "Hz", 1, 1000), True),
    "station_m": Parameter(
        list(FormationSettings.station_m),
        Quantity("in the leader's base_link; the follower starts near it", "m", -50, 50),
        True,
    ),
    "command_timeout_s": Parameter(
        1.0, Quantity("age of cmd_vel from which the follower stops", "s", 0.05, 60)
    ),
    "world_frame": Parameter("odom", Quantity("frame of both odometries"), True),
}


class VehiclesNode(Node):
    """Move the vehicles by the node's clock and publish where they are; options as of `Node`."""

    def __init__(self, **options: Any) -> None:
        super().__init__("vehicles_node", **options)
        self.parameters = Parameters(self, PARAMETERS, self.on_change)
        self.on_change({})
        self.model = MODELS[self.parameters["vehicle_model"]]
        self.vehicles: dict[str, Vehicle] = {}
        self.path_s: float | None = None  # time on the leader's path, once all are commanded
        self.moved: Time | None = None
        self.commanded = self.get_clock().now()
        self.command: tuple[Array, Array] = np.zeros(3), np.zeros(3)
        self.diagnostics = Diagnostics(self)
        role = self.parameters["vehicles"]
        self.odometry = {
            name: publish(self, Odometry, f"{name}/odometry")
            for name in ("leader", "follower")
            if role in (name, "both")
        }
        self.send_transform = transform_publisher(self, self.parameters["publish_tf"])
        # The commands that the leader waits for; and of those that came, who compiles the fit.
        self.awaited: dict[str, str] = {}
        self.fits: dict[str, str] = {}  # what each estimator says of its fit
        if role == "leader":
            for n in range(1, self.parameters["followers"] + 1):
                self.awaited[f"follower_{n}/cmd_vel"] = ""
                heard = partial(self.on_command, f"follower_{n}/cmd_vel")
                subscribe(self, TwistStamped, f"follower_{n}/cmd_vel", heard)
        else:
            self.awaited["cmd_vel"] = ""
            subscribe(self, TwistStamped, "cmd_vel", partial(self.on_command, "cmd_vel"))
        if role == "follower":
            self.diagnostics.warn("follower waits: no leader/odometry has come yet")
            subscribe(self, Odometry, "leader/odometry", self.on_leader)
        else:
            self.create_subscription(DiagnosticArray, "/diagnostics", self.on_diagnostics, 100)
            self.warn_of_waiting()
            self.vehicles["leader"] = self.model(np.zeros(3))
        if role == "both":
            self.place_follower(self.vehicles["leader"])
        self.timer = self.create_timer(1.0 / self.parameters["rate_hz"], self.on_timer)

    def on_change(self, changes: dict[str, Any]) -> None:
        """Take over the sea of the parameters with changes to them."""
        current = changes.get("current_m_per_s", self.parameters["current_m_per_s"])
        self.sea = Sea(current, self.parameters.settings(WaveSettings, changes))

    def place_follower(self, leader: Vehicle) -> None:
        """Start the follower near its station."""
        self.vehicles["follower"] = start_behind(leader, self.parameters["station_m"])

    def warn_of_waiting(self) -> None:
        """Report which commands the leader waits for, and whose fit."""
        silent = ", ".join(topic for topic, compiler in self.awaited.items() if not compiler)
        compilers = ", ".join(filter(None, self.awaited.values()))
        reasons = [f"no {silent} has come yet"] if silent else []
        reasons += [f"{compilers} compiling the fit, once on a machine"] if compilers else []
        self.diagnostics.warn(f"leader waits: {' and '.join(reasons)}" if reasons else "")

    def on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note how the fit of each estimator runs."""
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "method" in values:
                self.fits[f"/{status.name}"] = values.get("fit", "")

    def compiler(self, topic: str) -> str:
        """Name the estimator beside who commands, where its fit may change yet."""
        name = f"{self.resolve_topic_name(topic).rpartition('/')[0]}/estimator_node"
        there = {name, UNKNOWN} & {*publishers(self, "/diagnostics")}
        changes = self.fits.get(name, "being compiled").endswith("being compiled")
        return name if there and changes else ""

    def on_leader(self, message: Odometry) -> None:
        """Place a follower without a leader of its own behind the one whose odometry comes."""
        if "follower" in self.vehicles:
            return
        with self.diagnostics.refusing("leader/odometry"):
            position, quaternion = odometry_pose(message)
            _, pitch, yaw = roll_pitch_yaw(quaternion)
            self.place_follower(self.model(position, pitch, yaw))
            self.diagnostics.warn("")

    def on_command(self, topic: str, message: TwistStamped) -> None:
        """Take a command; the leader sets off once every follower has had one."""
        with self.diagnostics.refusing("cmd_vel"):
            self.command = twist_from_message(message)
            self.commanded = self.get_clock().now()
            if self.vehicles and topic in self.awaited:
                self.awaited[topic] = self.compiler(topic) if "leader" in self.vehicles else ""
                if not self.awaited[topic]:
                    del self.awaited[topic]
                self.warn_of_waiting()
                if not self.awaited:
                    self.path_s = 0.0
                    for vehicle in self.vehicles.values():
                        vehicle.t_s = 0.0  # one clock of the sea, however long the leader waited
            self.diagnostics.answer()

    def on_timer(self) -> None:
        """Move the vehicles to the present and publish their odometry."""
        now = self.get_clock().now()
        if self.moved is None or now < self.moved:
            self.moved = self.commanded = now  # the first tick, or a clock that was set back
        step_s = (now - self.moved).nanoseconds * 1e-9
        self.moved = now
        if (now - self.commanded).nanoseconds * 1e-9 > self.parameters["command_timeout_s"]:
            self.command = np.zeros(3), np.zeros(3)
        if self.path_s is not None:  # until then the sea is still
            for vehicle in self.vehicles.values():
                vehicle.sea = self.sea
        if "leader" in self.vehicles and self.path_s is not None:
            self.path_s = lead(self.vehicles["leader"], self.path_s, step_s)
        if "follower" in self.vehicles:
            self.vehicles["follower"].step(*self.command, step_s)
        for name, vehicle in self.vehicles.items():
            self.publish_odometry(name, vehicle, now)

    def publish_odometry(self, name: str, vehicle: Vehicle, now: Time) -> None:
        """Publish one vehicle's pose and velocity."""
        child_frame = f"{self.parameters['frame_prefix']}{name}/base_link"
        message = Odometry(child_frame_id=child_frame)
        message.header.stamp = now.to_msg()
        message.header.frame_id = self.parameters.frame("world_frame")
        attitude = vehicle.pitch, vehicle.yaw, vehicle.roll
        messages.write_pose(message.pose.pose, vehicle.position, *attitude)
        messages.write_twist(message.twist.twist, vehicle.linear, vehicle.angular)
        self.odometry[name].publish(message)
        self.send_transform(message.header, message.child_frame_id, message.pose.pose)


main = partial(run, VehiclesNode)
