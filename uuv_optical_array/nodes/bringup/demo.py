"""All nodes of the demonstration in one process, and the record of what they published."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.control.fleet import Follower
from uuv_optical_array.control.follow_record import FollowRecord
from uuv_optical_array.control.follow_states import state_from_status
from uuv_optical_array.control.following import State
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.messages import image_from_message, odometry_pose, stamp_ns
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared.diagnostics import (
    SEPARATE,
    UNKNOWN,
    publishers,
    several_publishers,
)
from uuv_optical_array.nodes.shared.messages import pose_from_message
from uuv_optical_array.nodes.shared.node import spin, start, steady_clock
from uuv_optical_array.nodes.simulator_node import SEEDS, SimulatorNode
from uuv_optical_array.nodes.vehicles_node import VehiclesNode
from uuv_optical_array.recording.bag import RUN, BagWriter

START_S = 15.0  # how long the leader may wait for a follower that neither compiles nor searches
DISCOVERY_S = 2.0  # in which the nodes of another run are found
DEPTH = 100  # reliable and deep: what is recorded should lack nothing
TOLD = QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # of states


class RecorderNode(Node):
    """Record what one follower's nodes publish, from when the `leader` of that topic sets off."""

    def __init__(self, record: FollowRecord, scene: Scene, leader: str, **options: Any) -> None:
        super().__init__("recorder_node", **options)
        self.record, self.scene = record, scene
        self.started_ns: int | None = None
        for message_type, topic, callback in (
            (Odometry, leader, self.on_leader),
            (Odometry, "follower/odometry", self.on_follower),
            (Image, "array/image", self.on_image),
            (PoseWithCovarianceStamped, "relative_pose", self.on_pose),
        ):
            self.create_subscription(message_type, topic, callback, qos_profile_sensor_data)
        self.state: State | None = None  # the last one, since a time of the clock
        self.create_subscription(DiagnosticStatus, "follow_state", self.on_state, TOLD)

    def add(self, series: dict[float, Array], header: Header, value: Array) -> None:
        """Add a value to a series of the record, at its time since the leader set off, s."""
        stamp = stamp_ns(header)
        if self.started_ns is not None and stamp >= self.started_ns:
            series[(stamp - self.started_ns) * 1e-9] = value

    def start(self, stamp_ns: int) -> None:
        """Begin at a time, unless it has begun."""
        if self.started_ns is None:
            self.started_ns = stamp_ns
            self.add_state()  # the one in which it begins

    def on_leader(self, message: Odometry) -> None:
        """Record the leader's position."""
        if message.twist.twist != Twist():
            self.start(stamp_ns(message.header))
        self.add(self.record.leader_path, message.header, odometry_pose(message)[0])

    def on_state(self, message: DiagnosticStatus) -> None:
        """Record what the follower does."""
        self.state = state_from_status(message)
        self.add_state()

    def add_state(self) -> None:
        """Add the state to the record where it is not there yet, at its time of the run."""
        if self.state is None or self.started_ns is None:
            return
        state = self.state._replace(since_s=self.state.since_s - self.started_ns * 1e-9)
        if self.record.states[-1:] != [state]:
            self.record.states.append(state)

    def on_follower(self, message: Odometry) -> None:
        """Record the follower's position."""
        self.add(self.record.follower_path, message.header, odometry_pose(message)[0])

    def on_image(self, message: Image) -> None:
        """Record the image."""
        image = image_from_message(message, self.scene.array, self.scene.lamp_count)
        self.add(self.record.images, message.header, image)

    def on_pose(self, message: PoseWithCovarianceStamped) -> None:
        """Record the estimate."""
        self.add(self.record.estimates, message.header, pose_from_message(message))


class BagRecorderNode(Node):
    """Write each message of `RUN` as it came, and when, into a bag; rosbag2 is not needed."""

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


def refuse_other_runs(spaces: Sequence[str]) -> None:
    """Raise ValueError where another run publishes on topics of the followers' namespaces."""
    lookout = rclpy.create_node("lookout")
    names = [f"{space}/{topic}" for space in spaces for topic in RUN]
    topics = [lookout.resolve_topic_name(name.lstrip("/")) for name in [*names, "leader/odometry"]]
    try:
        deadline = time.monotonic() + DISCOVERY_S
        while time.monotonic() < deadline:
            for topic in topics:
                others = publishers(lookout, topic)
                if others and UNKNOWN not in others:
                    raise ValueError(
                        f"another run is on this network: {topic} of {' and '.join(others)}; "
                        f"{SEPARATE}"
                    )
            rclpy.spin_once(lookout, timeout_sec=0.05)
    finally:
        lookout.destroy_node()


def options_of(follower: Follower, fleet: Sequence[Follower]) -> dict[str, Any]:
    """Return the options of the nodes of one follower of a fleet."""
    others = " ".join(f"/{topic}" for topic in follower.others(fleet))
    return {
        "namespace": follower.namespace,
        "cli_args": ["--ros-args", "-r", f"leader/odometry:=/{follower.lamp_odometry}"],
        "parameter_overrides": [
            Parameter("vehicles", value="follower"),
            Parameter("station_m", value=list(follower.station_m)),
            Parameter("others", value=others),
        ],
    }


def sea_of(number: int, seed: int | None, exact: bool) -> list[Parameter]:
    """Return the parameters of the sea of a follower; numbers begin with 0."""
    told: list[Parameter] = [Parameter("draw_sea", value=False)] if exact else []
    if seed is not None:
        own = (seed + number) % SEEDS if seed >= 0 else seed
        told.append(Parameter("seed", value=own))
    return told


def follower_nodes(leader: str, options: dict[str, Any]) -> tuple[RecorderNode, list[Node]]:
    """Return the recorder of a follower, as `RecorderNode`, and its nodes without the vehicle."""
    simulator, formation = SimulatorNode(**options), FormationNode(**options)
    record = FollowRecord(tuple(formation.parameters["station_m"]), sea=simulator.sea_in_words)
    recorder = RecorderNode(record, simulator.scene, leader, **options)
    simulator.hand_over = partial(recorder.add, record.truth)
    nodes = [formation, recorder, simulator, FeatureNode(**options), EstimatorNode(**options)]
    return recorder, nodes


class TimeLeft:
    """The time of a run, by a clock that is never set, or by the simulated one while that goes on.

    - elapsed_s: since the leader set off, s.
    """

    def __init__(self, node: Node, duration_s: float) -> None:
        self.clock, self.elapsed_s = steady_clock(node), 0.0
        self._since = self._last = self.clock.now()
        self._duration_s, self._waiting, self._ticked_s = duration_s, True, time.monotonic()

    def wanted(self, waiting: bool, busy: bool) -> bool:
        """Say whether the run goes on: it waits, longer while it is busy, and then takes its time.

        ValueError where the simulated clock stands.
        """
        now = self.clock.now()
        if now != self._last:
            self._last, self._ticked_s = now, time.monotonic()
        elif time.monotonic() - self._ticked_s > START_S:
            raise ValueError(
                f"use_sim_time: the simulated clock stands at {now.nanoseconds * 1e-9:g} s for "
                f"{START_S:g} s; start what publishes /clock, or set use_sim_time to false"
            )
        if (busy and waiting) or waiting != self._waiting:
            self._since, self._waiting = now, waiting
        elapsed_s = (now - self._since).nanoseconds * 1e-9
        self.elapsed_s = 0.0 if waiting else elapsed_s
        return elapsed_s < (START_S if waiting else self._duration_s)


def follow(
    ros_args: list[str],
    duration_s: float,
    on_tick: Callable[[FollowRecord, float], None],
    fleet: Sequence[Follower] = (),
    bag: BagWriter | None = None,
    seed: int | None = None,
    exact_sea: bool = False,
) -> tuple[list[FollowRecord], bool]:
    """Run the demonstration in real time.

    - ros_args: ROS arguments for every node, such as a parameter file.
    - duration_s: length of the run, s, from when the leader sets off.
    - on_tick: called at 5 Hz with the first follower's record so far and the elapsed time, s.
    - fleet: the followers, each in its namespace; empty: one in none, at the parameters' station.
    - bag: an open one, which gets what the nodes publish.
    - seed: of the first follower's sea and noise, the next follower has the next; ``None``: as of
      the parameters.
    - exact_sea: whether the sea is exactly the scene's; else as of the parameters.
    - returned: a record for each follower, and whether a signal ended the run.
    - ValueError: where a node refuses a parameter or a scene, another run has the same topics, or
      the simulated clock stands.
    """
    start(["--ros-args", *ros_args])
    executor = SingleThreadedExecutor()
    try:
        refuse_other_runs([follower.namespace for follower in fleet] or [""])
        leader = "/leader/odometry" if fleet else "leader/odometry"
        options = [options_of(follower, fleet) for follower in fleet]
        options = options or [{"parameter_overrides": []}]
        recorders = []
        for number, follower_options in enumerate(options):
            follower_options["parameter_overrides"] += sea_of(number, seed, exact_sea)
            recorder, nodes = follower_nodes(leader, follower_options)
            recorders.append(recorder)
            if bag is not None:
                nodes.append(BagRecorderNode(bag, **follower_options))
            for node in nodes:
                executor.add_node(node)
        if fleet:
            alone = Parameter("vehicles", value="leader"), Parameter("followers", value=len(fleet))
            options.append({"parameter_overrides": list(alone)})
        # Vehicles come last, at the end the leader, so that none moves before the nodes are there.
        for vehicle_options in options:
            vehicles = VehiclesNode(**vehicle_options)
            executor.add_node(vehicles)
        first, records = recorders[0], [recorder.record for recorder in recorders]
        time_left = TimeLeft(first, duration_s)

        def wanted() -> bool:
            waiting = first.started_ns is None
            return time_left.wanted(waiting, vehicles.waiting.busy)

        def tick() -> None:
            for recorder in recorders:
                if vehicles.path_s is not None:  # a path may begin at rest
                    recorder.start(recorder.get_clock().now().nanoseconds)
                for topic in map(recorder.resolve_topic_name, RUN):
                    text = several_publishers(recorder, topic)
                    if text and UNKNOWN not in text:
                        raise ValueError(text)
            on_tick(first.record, time_left.elapsed_s)

        first.create_timer(0.2, tick, clock=time_left.clock)
        interrupted = spin(executor, wanted)
        return records, interrupted
    except ParameterException as error:
        raise ValueError(str(error)) from None
    finally:
        rclpy.try_shutdown()
        # Not when their memory is freed: others on the network see them until then.
        for node in executor.get_nodes():
            node.destroy_node()
