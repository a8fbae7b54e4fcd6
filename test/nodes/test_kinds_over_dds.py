"""Seas that differ from the scene, through the nodes: they say what the library says."""

from contextlib import suppress

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from node_processes import Probe, node_processes
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from uuv_optical_array.core.geometry import covariance_6x6
from uuv_optical_array.estimation.estimator import Estimator, NoPose
from uuv_optical_array.estimation.table.disk import cached_table
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.nodes.shared.messages import image_to_message
from uuv_optical_array.studies.mismatches import kinds_named

KINDS = (
    "k-0.04,beam+0.6,power_x0.8,ambient_10,gradient_30,second_lamp_0.3,gains_0.01,dead_detector,"
    "stuck_detector,shade_0.05,half_shadow,mirrored,near_2m,noise,blob"
)
FRAMES = 8  # of each kind


def frames_of(scene):
    """Return images of all kinds, one kind after the other."""
    model, images = ForwardModel(scene), []
    for kind in kinds_named(KINDS, scene):
        poses = lit_poses(model, FRAMES, np.random.default_rng(3), kind.draw)
        images.append(
            model.read(kind.light(model, poses, np.random.default_rng(4)), np.random.default_rng(5))
        )
    return np.concatenate(images)


class Sea(Probe):
    """Publishes images, and collects poses and the diagnostics of the estimator."""

    def __init__(self):
        super().__init__("sea")
        reliable = QoSProfile(depth=10)
        self.images = self.node.create_publisher(Image, "array/image", reliable)
        self.poses, self.told = {}, {}
        self.node.create_subscription(
            PoseWithCovarianceStamped, "relative_pose", self.on_pose, reliable
        )
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.on_told, 10)

    def on_pose(self, message):
        self.poses[message.header.stamp.sec] = message

    def on_told(self, message):
        for status in message.status:
            if "estimator_node" in status.name:
                self.told = {pair.key: pair.value for pair in status.values}

    def show(self, image, seconds):
        header = Header(stamp=Time(sec=seconds), frame_id="array")
        self.images.publish(image_to_message(image, header))


def test_the_nodes_answer_and_refuse_what_the_library_does(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    scene = load_scene("follow")
    cached_table(scene)  # else the nodes begin with a coarse one
    estimator, model = Estimator(scene), ForwardModel(scene)
    rng = np.random.default_rng(6)
    here = np.array([-6.0, 0.1, -0.1, 0.05, 0.05])
    given = {"scene": "follow", "estimator_node:tracking": "false"}  # poses that make no track
    rclpy.init()
    try:
        with node_processes(tmp_path / "log", ("feature_node", "estimator_node"), **given):
            sea, seconds = Sea(), 0

            def ready():
                nonlocal seconds
                seconds += 1
                sea.show(model.expose(here, rng), seconds)
                return sea.poses and sea.told.get("fit") == "compiled"

            sea.wait_for(ready, "the compiled fit")
            images = frames_of(scene)
            first = seconds + 1
            for i, image in enumerate(images):
                # Answers come in order, and to an honest image there is one.
                sea.show(image, first + 2 * i)
                sea.show(model.expose(here, rng), first + 2 * i + 1)
                sea.wait_for(
                    lambda i=i: first + 2 * i + 1 in sea.poses, f"the answer after image {i}"
                )
    finally:
        rclpy.try_shutdown()
    answered = 0
    for i, image in enumerate(images):
        published = sea.poses.get(first + 2 * i)
        expected = None
        with suppress(NoPose):
            expected = estimator.estimate(image)
        assert (published is None) == (expected is None), f"image {i}"
        if expected is None:
            continue
        answered += 1
        place = published.pose.pose.position
        stds = np.sqrt(expected.covariance.diagonal())
        off = np.array([place.x, place.y, place.z]) - expected.pose[:3]
        assert (np.abs(off) < 1e-3 * stds[:3]).all(), f"image {i}"
        np.testing.assert_allclose(
            np.reshape(published.pose.covariance, (6, 6)),
            covariance_6x6(expected.pose, expected.covariance, 0.02),
            rtol=1e-3,
            atol=1e-9,
        )
    print(f"{answered} of {len(images)} answered")
    # Broken detectors, shadows and noise are most of what is refused.
    assert 8 * FRAMES <= answered <= 11 * FRAMES
