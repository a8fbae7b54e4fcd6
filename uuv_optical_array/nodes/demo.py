"""All nodes of the demonstration in one process, and the record of what they published."""

import time
from collections.abc import Callable

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image

from uuv_optical_array.control.follow_record import FollowRecord
from uuv_optical_array.core.geometry import relative_pose
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared.bag_recorder import BagRecorderNode
from uuv_optical_array.nodes.shared.graph import SEPARATE, UNKNOWN, publishers, several_publishers
from uuv_optical_array.nodes.shared.messages import (
    image_from_message,
    odometry_pose,
    pose_from_message,
    stamp_ns,
)
from uuv_optical_array.nodes.shared.node import spin, start
from uuv_optical_array.nodes.simulator_node import SimulatorNode
from uuv_optical_array.nodes.vehicles_node import VehiclesNode
from uuv_optical_array.recording.bag import BagWriter

START_S = 15.0  # how long the leader may wait for the follower to see it
DISCOVERY_S = 1.0  # in which the nodes of another run are found


class RecorderNode(Node):
    """Keep what the other nodes publish, from the moment when the leader sets off."""

    TOPICS = ("leader/odometry", "follower/odometry", "array/image", "relative_pose", "cmd_vel")

    def __init__(self, record: FollowRecord, side: int) -> None:
        super().__init__("recorder_node")
        self.record, self.side = record, side
        self.started_ns: int | None = None
        self.leaders: dict[float, Odometry] = {}
        for message_type, topic, callback in (
            (Odometry, "leader/odometry", self.on_leader),
            (Odometry, "follower/odometry", self.on_follower),
            (Image, "array/image", self.on_image),
            (PoseWithCovarianceStamped, "relative_pose", self.on_pose),
        ):
            self.create_subscription(message_type, topic, callback, qos_profile_sensor_data)

    def seconds(self, message) -> float | None:
        """Return a message's time since the leader set off, s; nothing before."""
        stamp = stamp_ns(message.header)
        if self.started_ns is None or stamp < self.started_ns:
            return None
        return (stamp - self.started_ns) * 1e-9

    def on_leader(self, message: Odometry) -> None:
        """Keep the leader's position."""
        if self.started_ns is None and message.twist.twist != Twist():
            self.started_ns = stamp_ns(message.header)
        if (stamp := self.seconds(message)) is not None:
            self.leaders[stamp] = message
            self.record.leader_path[stamp] = odometry_pose(message)[0]

    def on_follower(self, message: Odometry) -> None:
        """Keep the follower's position and, where the leader's is known, the true pose."""
        if (stamp := self.seconds(message)) is None:
            return
        position, quaternion = odometry_pose(message)
        self.record.follower_path[stamp] = position
        leader = self.leaders.pop(stamp, None)
        if leader is not None:
            leader_position, leader_quaternion = odometry_pose(leader)
            self.record.truth[stamp], _ = relative_pose(
                leader_position,
                Rotation.from_quat(leader_quaternion).as_matrix(),
                position,
                Rotation.from_quat(quaternion).as_matrix(),
            )

    def on_image(self, message: Image) -> None:
        """Keep the image."""
        if (stamp := self.seconds(message)) is not None:
            self.record.images[stamp] = image_from_message(message, self.side)

    def on_pose(self, message: PoseWithCovarianceStamped) -> None:
        """Keep the estimate."""
        if (stamp := self.seconds(message)) is not None:
            self.record.estimates[stamp] = pose_from_message(message)


def refuse_company() -> None:
    """Raise ValueError where another run is on the network, before a node of ours publishes."""
    lookout = rclpy.create_node("lookout")
    try:
        deadline = time.monotonic() + DISCOVERY_S
        while time.monotonic() < deadline:
            for topic in map(lookout.resolve_topic_name, RecorderNode.TOPICS):
                others = publishers(lookout, topic)
                if others and UNKNOWN not in others:
                    raise ValueError(
                        f"another run is on this network: {topic} of {' and '.join(others)}; "
                        f"{SEPARATE}"
                    )
            rclpy.spin_once(lookout, timeout_sec=0.05)
    finally:
        lookout.destroy_node()


def follow(
    ros_args: list[str],
    duration_s: float,
    on_tick: Callable[[FollowRecord, float], None],
    bag: BagWriter | None = None,
) -> tuple[FollowRecord, float, bool]:
    """Run the demonstration in real time.

    Parameters
    ----------
    ros_args
        ROS arguments for every node, such as a parameter file.
    duration_s
        Length of the run, s, from the moment when the leader sets off.
    on_tick
        Called five times a second with the record so far and the elapsed time, s.
    bag
        An open one, which gets what the nodes publish.

    Returns
    -------
    record : FollowRecord
        What was published, until the end or until it was interrupted.
    light_timeout_s
        How long the formation control bears to be without a pose, s.
    interrupted : bool
        Whether a signal ended it.

    Raises
    ------
    ValueError
        For a parameter or a scene that a node refuses, and where another run publishes on the
        topics of this one, whether it was there first or comes later.
    """
    start(["--ros-args", *ros_args])
    try:
        refuse_company()
        formation, simulator = FormationNode(), SimulatorNode()
        record = FollowRecord(tuple(formation.parameters["station_m"]))
        recorder = RecorderNode(record, simulator.model.array.side)
        executor = SingleThreadedExecutor()
        for node in (
            recorder,
            formation,
            simulator,
            FeatureNode(),
            EstimatorNode(),
            VehiclesNode(),
        ):
            executor.add_node(node)
        if bag is not None:
            executor.add_node(BagRecorderNode(bag))
        clock = recorder.get_clock()
        ready_ns = clock.now().nanoseconds

        def elapsed_s(since_ns: int | None) -> float:
            return 0.0 if since_ns is None else (clock.now().nanoseconds - since_ns) * 1e-9

        def goes_on() -> bool:
            for topic in map(recorder.resolve_topic_name, RecorderNode.TOPICS):
                text = several_publishers(recorder, topic)
                if text and UNKNOWN not in text:
                    raise ValueError(text)
            if recorder.started_ns is None:
                return elapsed_s(ready_ns) < START_S
            return elapsed_s(recorder.started_ns) < duration_s

        recorder.create_timer(0.2, lambda: on_tick(record, elapsed_s(recorder.started_ns)))
        interrupted = spin(executor, goes_on)
        return record, formation.parameters["light_timeout_s"], interrupted
    except ParameterException as error:
        raise ValueError(str(error)) from None
    finally:
        rclpy.try_shutdown()
