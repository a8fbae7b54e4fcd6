"""Three operating-system processes answer the odometry of a fourth, over DDS."""

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from node_processes import Probe, node_processes
from odometries import odometry, position, rotation
from rclpy.qos import QoSProfile
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image

from uuv_optical_array.core.messages import stamp_ns

# The bound on the error across is 5.7 of its standard deviations away with so many; with 250, 1.6.
POSES = 500
NODES = ("simulator_node", "feature_node", "estimator_node")


@pytest.fixture
def sensor_processes(tmp_path):
    given = {"scene": "reference", "simulator_node:seed": 7, "estimator_node:method": "sam"}
    given["estimator_node:tracking"] = "false"  # poses of this test make no track
    with node_processes(tmp_path / "log", NODES, **given):
        yield


class Fleet(Probe):
    """Publishes both odometries of one random relative pose at a time and collects answers."""

    def __init__(self):
        super().__init__("fleet")
        reliable = QoSProfile(depth=10)
        self.leader = self.node.create_publisher(Odometry, "leader/odometry", reliable)
        self.follower = self.node.create_publisher(Odometry, "follower/odometry", reliable)
        self.peaks, self.answers = {}, {}
        self.node.create_subscription(Image, "array/image", self.on_image, reliable)
        self.node.create_subscription(
            PoseWithCovarianceStamped, "relative_pose", self.on_pose, reliable
        )

    def on_image(self, message):
        self.peaks[stamp_ns(message.header)] = np.frombuffer(message.data, "<u2").max()

    def on_pose(self, message):
        self.answers[stamp_ns(message.header)] = message

    def connect(self):
        """Publish an aligned pose, again and again, until the first answer comes back."""
        seconds = 0

        def answered():
            nonlocal seconds
            seconds += 1
            for publisher, x in ((self.leader, 0.0), (self.follower, -6.0)):
                publisher.publish(odometry(seconds * 10**9, [x, 0.0, 0.0]))
            return self.answers

        self.wait_for(answered, "the four processes to find each other")
        return seconds


def test_every_lit_pose_is_answered_within_the_specified_error(sensor_processes):
    rng = np.random.default_rng(20161)
    angle = np.radians(20.0)
    poses = rng.uniform(
        [-8.0, -0.6, -0.6, -angle, -angle], [-4.0, 0.6, 0.6, angle, angle], (POSES, 5)
    )
    rclpy.init()
    try:
        fleet = Fleet()
        first = fleet.connect() + 1
        stamps = [first * 10**9 + i * 10**8 + 1 for i in range(POSES)]
        for stamp, pose in zip(stamps, poses, strict=True):
            leader = Rotation.from_euler("ZYX", rng.uniform(-0.5, 0.5, 3))
            beacon = rng.uniform(-50.0, 50.0, 3)
            follower = leader * Rotation.from_euler("ZYX", [pose[4], pose[3], 0.0])
            place = beacon + leader.apply(pose[:3])
            fleet.leader.publish(odometry(stamp, beacon, leader))
            fleet.follower.publish(odometry(stamp, place, follower))
            fleet.wait_for(
                lambda stamp=stamp: stamp in fleet.answers and stamp in fleet.peaks,
                f"the answer to pose {pose} with stamp {stamp}",
            )
    finally:
        rclpy.try_shutdown()

    assert min(fleet.peaks.values()) > 20  # every pose of this volume has light
    assert [stamp for stamp in sorted(fleet.answers) if stamp >= first * 10**9] == stamps
    errors, normalised = [], []
    for stamp, pose in zip(stamps, poses, strict=True):
        message = fleet.answers[stamp]
        assert message.header.frame_id == "leader/beacon"
        found_yaw, found_pitch, found_roll = rotation(message).as_euler("ZYX")
        assert abs(found_roll) < 1e-9
        errors.append([*position(message) - pose[:3], found_pitch - pose[3], found_yaw - pose[4]])
        covariance = np.reshape(message.pose.covariance, (6, 6))
        np.linalg.cholesky(covariance)
        std = np.sqrt(covariance.diagonal()[[0, 1, 2, 4, 5]])
        normalised.append(np.array(errors[-1]) / std)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    range_m, across_m = rms[0], np.sqrt(np.mean(rms[1:3] ** 2))
    angle_deg = np.degrees(np.sqrt(np.mean(rms[3:] ** 2)))
    print(f"RMS error: range {range_m:.3f} m, across {across_m:.3f} m, angle {angle_deg:.2f} deg")
    assert range_m <= 0.4
    assert across_m <= 0.25
    assert angle_deg <= 7.0
    # Published standard deviations are of the errors' size in every degree of freedom.
    spread = np.sqrt(np.mean(np.square(normalised), axis=0))
    assert (spread > 0.5).all(), spread
    assert (spread < 2.0).all(), spread
