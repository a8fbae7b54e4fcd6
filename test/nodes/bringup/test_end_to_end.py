"""Three operating-system processes answer the odometry of a fourth, over DDS, as the core does."""

import numpy as np
import pytest
import rclpy
from asker import assert_is, place_of
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from node_processes import Probe, node_processes
from odometries import odometry
from rclpy.qos import QoSProfile
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image

from uuv_optical_array.core.geometry import covariance_6x6
from uuv_optical_array.core.messages import stamp_ns
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature.features import scene_parameters
from uuv_optical_array.forward.model import ForwardModel

POSES = 20
ROLL_STD_RAD = 1e-6  # it is 0
NODES = ("simulator_node", "feature_node", "estimator_node")


@pytest.fixture
def sensor_processes(tmp_path, scene_file):
    given = {"scene": scene_file, "simulator_node:seed": 7, "estimator_node:method": "sam"}
    given["estimator_node:tracking"] = "false"  # poses of this test make no track
    given["estimator_node:roll_std_rad"] = f"{ROLL_STD_RAD}"
    with node_processes(tmp_path / "log", NODES, **given):
        yield


class Fleet(Probe):
    """Publishes both odometries of one random relative pose at a time and collects answers."""

    def __init__(self):
        super().__init__("fleet")
        reliable = QoSProfile(depth=10)
        self.leader = self.node.create_publisher(Odometry, "leader/odometry", reliable)
        self.follower = self.node.create_publisher(Odometry, "follower/odometry", reliable)
        self.images, self.answers = {}, {}
        self.node.create_subscription(Image, "array/image", self.on_image, reliable)
        self.node.create_subscription(
            PoseWithCovarianceStamped, "relative_pose", self.on_pose, reliable
        )

    def on_image(self, message):
        assert stamp_ns(message.header) not in self.images, "two simulators are on this domain"
        image = np.frombuffer(message.data, "<u2").reshape(message.height, message.width)
        self.images[stamp_ns(message.header)] = image

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


def apart(message, estimate):
    position, _ = place_of(message)
    covariance = covariance_6x6(estimate.pose, estimate.covariance, ROLL_STD_RAD).ravel()
    said, expected = [*position, *message.pose.covariance], [*estimate.pose[:3], *covariance]
    return np.abs(np.subtract(said, expected)).max()


def test_every_pose_is_answered_with_the_match_of_its_image(sensor_processes, scene, table):
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
                lambda stamp=stamp: stamp in fleet.answers and stamp in fleet.images,
                f"the answer to pose {pose} with stamp {stamp}",
            )
    finally:
        rclpy.try_shutdown()

    assert [stamp for stamp in sorted(fleet.answers) if stamp >= first * 10**9] == stamps
    matching = Estimator(table, "sam")
    images = np.array([fleet.images[stamp] for stamp in stamps])
    for stamp, image in zip(stamps, images, strict=True):
        answer, signature = fleet.answers[stamp], scene_parameters(image, scene)
        assert answer.header.frame_id == "leader/beacon"
        # One signature of a thousand is as far from two rows, but for rounding, and has either.
        found = [
            matching.estimate(image, signature + off)
            for off in (np.zeros(5), *(1e-15 * np.eye(5)), *(-1e-15 * np.eye(5)))
        ]
        assert_is(answer, min(found, key=lambda one: apart(answer, one)), ROLL_STD_RAD)
    # Each image is of its pose. How many were drawn before depends on when the processes found each
    # other, so the noise does, too: over its draws the mean of 500 squares is 1.00 +- 0.063.
    model = ForwardModel(scene)
    light = model.light(poses)
    assert 0.7 < np.mean((images - light) ** 2 / model.variance(light)[0]) < 1.3
