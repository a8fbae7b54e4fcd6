"""``uuv_array commission`` live and on a bag, and the nodes of an array that is wired so."""

import os
import select
import sys

import numpy as np
import pytest
from bags import image_message, write_bag
from builtin_interfaces.msg import Time
from command_line import begun, ended, run, text_of
from nav_msgs.msg import Odometry
from needs import rosbags
from odometries import odometry, time_of
from scenes import changed
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header
from test_wiring import torch_run

from uuv_optical_array.core.messages import as_wired
from uuv_optical_array.estimation.signature.features import scene_parameters
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, save_scene
from uuv_optical_array.nodes.feature_node import FeatureNode
from uuv_optical_array.nodes.shared.messages import features_from_message, image_to_message
from uuv_optical_array.nodes.simulator_node import SimulatorNode

WIRED = [int(place) for place in np.random.default_rng(9).permutation(25)]


@pytest.fixture
def sent():
    """Stamps and images of both sweeps, as an array sends them that is wired anyhow."""
    return [(s, as_wired(i, WIRED)) for s, i in torch_run(5, np.random.default_rng(6))]


@rosbags
def test_a_bag_of_both_sweeps_gives_the_scene_its_wiring(sent, tmp_path):
    bag = write_bag(tmp_path / "torch", [image_message(*each) for each in sent], "MCAP")
    output = tmp_path / "sea.yaml"
    assert "readings are of other detectors" in text_of(run, "commission", bag, "-o", output)
    assert load_scene(output).array.wiring == WIRED
    # Again, from a scene that has a wiring already: the same, and its comments are kept.
    output.write_text(f"# My rig.\n{output.read_text('utf-8')}# Mine.\n", encoding="utf-8")
    for _ in range(2):
        run("commission", bag, "--scene", output, "-o", output)
        assert load_scene(output).array.wiring == WIRED
        comments = [line for line in output.read_text("utf-8").splitlines() if line[:1] == "#"]
        assert comments == [
            "# Commissioned by uuv_array commission, starting from sea.",
            "# My rig.",
            "# Commissioned by uuv_array commission, starting from follow.",
            "# Mine.",
        ]


def test_the_test_on_deck_needs_the_distance_of_the_lamp():
    line = run("commission", "torch", "--in-air", code=2)
    assert "--in-air: it is of the acceptance test; give --lamp, too" in line


@rosbags
def test_an_array_that_is_wired_right_gets_no_wiring_and_a_bag_that_ends_early_no_scene(tmp_path):
    frames = [image_message(*each) for each in torch_run(5, np.random.default_rng(6))]
    output = tmp_path / "sea.yaml"
    half = write_bag(tmp_path / "half", frames[: len(frames) // 2], "MCAP")
    assert "not seen: the torch of sweep 2" in run("commission", half, "-o", output, code=1)
    assert not output.exists()
    bag = write_bag(tmp_path / "torch", frames, "MCAP")
    assert "wiring: in reading order" in text_of(run, "commission", bag, "-o", output)
    assert load_scene(output).array.wiring is None


# The command takes sensor data, of which a busy machine may lose some.
LOSING_NOTHING = """
from rclpy.qos import ReliabilityPolicy
from uuv_optical_array.nodes.shared import image_listener
image_listener.ReliabilityPolicy = lambda: None
image_listener.ReliabilityPolicy.BEST_EFFORT = ReliabilityPolicy.RELIABLE
from uuv_optical_array.commands import main
main()
"""


def test_live_images_are_taken_until_both_sweeps_are_seen(lab, sent, tmp_path):
    lab.begin()
    images = lab.probe.create_publisher(Image, "bow/array/image", 1000)
    output = tmp_path / "sea.yaml"
    words = ("commission", "--set", "image_topic=bow/array/image", "-o", output)
    told, stamp = b"", sent[0][0] - 10**12

    def show(stamp, image):
        images.publish(image_to_message(image, Header(stamp=time_of(stamp))))

    def background_is_measured():
        """Show the dark until the command has heard enough of it: it hears us later than we it."""
        nonlocal told, stamp
        stamp += 10**8
        show(stamp, sent[0][1])
        if select.select([process.stdout], [], [], 0)[0]:
            told += os.read(process.stdout.fileno(), 4096)
        return b"sweep 1 of 2" in told

    with begun([sys.executable, "-c", LOSING_NOTHING, *words]) as process:
        lab.until(background_is_measured, "the command to measure the background")
        for each in sent:
            show(*each)
        out, _ = ended(process)
    assert load_scene(output).array.wiring == WIRED
    assert "sweep 2 of 2" in out


def test_the_nodes_of_a_wired_array_see_what_those_of_a_right_one_see(lab, tmp_path):
    """The simulator sends readings as they are wired; the feature node sets them right."""
    scene, path = load_scene("follow"), tmp_path / "wired.yaml"
    save_scene(changed(scene, array={"wiring": WIRED}), path, "Wired.")
    lab.begin({"scene": str(path), "simulator_node:seed": 5, "simulator_node:draw_sea": False})
    for node in (SimulatorNode, FeatureNode):
        lab.start(node)
    talkers = [lab.talk(Odometry, f"{name}/odometry") for name in ("leader", "follower")]
    images, features = lab.listen(Image, "array/image"), lab.listen(PointCloud2, "array/features")
    lab.connect()
    stamp = Time(sec=7)
    for talker, x in zip(talkers, (0.0, -6.0), strict=True):
        talker.publish(odometry(7 * 10**9, [x, 0.1 * x, 0.0]))
    pose = np.array([-6.0, -0.6, 0.0, 0.0, 0.0])
    image = ForwardModel(scene).expose(pose, np.random.default_rng(5), 0.0, time_s=7.0)
    sent = lab.answer(images, stamp)
    pixels = np.frombuffer(bytes(sent.data), "<u2")
    np.testing.assert_array_equal(pixels[WIRED], image.ravel())
    assert (pixels != image.ravel()).any()
    found = features_from_message(lab.answer(features, stamp))
    expected = scene_parameters(image, scene)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
