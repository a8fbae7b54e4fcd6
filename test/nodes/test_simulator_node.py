"""The simulator node: the image that the core exposes, for poses composed with SciPy."""

import math

import numpy as np
import pytest
from conftest import write_scene
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from odometries import time_of
from rclpy.parameter import Parameter
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image, Range
from simulated_seas import ABREAST, BEACON, BEHIND, SEED, Sea, odometry

from uuv_optical_array.forward.aim import apparent
from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import power_offsets
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.simulator_node import SimulatorNode

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
LOST = np.array([0.0, np.nan, 0.0]), Rotation.identity()
HALF_A_TURN = Rotation.from_euler("X", np.pi)


def random_places(rng):
    """Return a leader somewhere and a rolled follower in the beam of its lamp."""
    leader_turn = Rotation.from_euler("ZYX", rng.uniform(-1.0, 1.0, 3))
    leader = rng.uniform(-50.0, 50.0, 3), leader_turn
    relative = rng.uniform([-6.0, -0.4, -0.4], [-4.0, 0.4, 0.4])
    turn = Rotation.from_euler("ZYX", rng.uniform(-0.25, 0.25, 3))
    lamp = leader[0] + leader_turn.apply(BEACON)
    return leader, (lamp + leader_turn.apply(relative), leader_turn * turn)


def seen(leader, follower, beacon=BEACON):
    """Return pose and roll of a follower in the beacon frame."""
    (leader_position, leader_turn), (position, turn) = leader, follower
    lamp = leader_position + leader_turn.apply(beacon)
    relative = leader_turn.inv().apply(position - lamp)
    yaw, pitch, roll = (leader_turn.inv() * turn).as_euler("ZYX")
    return np.array([*relative, pitch, yaw]), roll


@pytest.fixture
def sea(lab, scene_file):
    return Sea(lab, scene_file)


@pytest.mark.parametrize(("axes", "flip"), [("flu", Rotation.identity()), ("frd", HALF_A_TURN)])
def test_an_image_is_what_the_core_exposes_at_the_pose_and_time_of_its_stamp_with_the_same_seed(
    lab, tmp_path, axes, flip
):
    drift = {"std": 0.3, "time_scale_s": 3.0, "seed": 2}
    scene_file = str(write_scene(tmp_path, "wavering", effects={"lamp_drift": drift}))
    sea, model = Sea(lab, scene_file, odometry_axes=axes), ForwardModel(load_scene(scene_file))
    noise, rng = np.random.default_rng(SEED), np.random.default_rng(5)
    handed_over = {}
    sea.node.hand_over = lambda header, pose: handed_over.update({header.stamp.sec: pose})
    for seconds in range(1, 21):
        (at, turn), (position, attitude) = random_places(rng)
        pose, roll = seen((at, turn), (position, attitude))
        # The leader is heard before and after that instant, and moves and turns in between.
        way, turned_by = rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.2, 0.2, 3)
        for share in (-0.3, 0.7):
            turned = turn * Rotation.from_rotvec(share * turned_by)
            place = flip.apply(at + share * way), flip * turned * flip
            sea.lead(seconds + 0.4 * share, place)
        sea.follow(seconds, (flip.apply(position), flip * attitude * flip))
        expected = model.expose(pose, noise, roll, time_s=float(seconds))
        assert expected.max() > 50  # enough light to tell poses apart
        np.testing.assert_array_equal(sea.image(seconds), expected)
        np.testing.assert_allclose(handed_over[seconds], pose, atol=1e-9)
    status = sea.lab.report(sea.node, OK, "answered")
    values = {pair.key: pair.value for pair in status.values}
    assert values["refused"] == "0"
    assert 4 <= float(values["range_m"]) <= 6


def test_followers_that_come_before_their_leader_wait_for_it(sea):
    sea.lead(1.0)
    for seconds in (1.1, 1.2, 1.3):
        sea.follow(seconds)
    sea.lab.until(lambda: len(sea.node.waiting) == 3, "three poses to wait")
    assert not sea.images
    sea.lead(1.25)
    sea.image(1.1)
    sea.image(1.2)
    assert len(sea.node.waiting) == 1
    sea.lead(1.35)
    sea.image(1.3)
    tenths = [time_of(t * 10**8) for t in (11, 12, 13)]
    assert [image.header.stamp for image in sea.images] == tenths


def test_a_pose_of_the_time_before_the_clock_was_set_back_keeps_none_waiting(sea):
    sea.lead(100.0)
    sea.follow(100.1)
    sea.lab.until(lambda: sea.node.waiting, "a pose to wait")
    for seconds in (1.0, 1.1):
        sea.follow(seconds)
    sea.lead(1.05)
    sea.lead(1.2)
    sea.image(1.1)
    assert not sea.node.waiting


def test_a_leader_that_never_speaks_is_told_of(sea):
    for i in range(1, 52):
        sea.follow(i / 10)
        sea.lab.until(lambda i=i: len(sea.node.waiting) == min(i, 50), "the pose to wait")
    sea.lab.report(sea.node, WARN, "no leader", "50 poses")
    assert not sea.images


@pytest.mark.parametrize(
    ("leader", "follower", "words"),
    [
        (odometry(2, ABREAST, frame="map"), odometry(2, BEHIND), ("frames differ", "map", "odom")),
        (odometry(2, ABREAST), odometry(2, LOST), ("follower/odometry, not finite", "nan")),
        (odometry(2, LOST), None, ("leader/odometry, not finite", "nan")),
        (odometry(2, ABREAST), odometry(1.5, BEHIND), ("gap of 1 s", "0.5")),
        (odometry(2, ABREAST), odometry(0.5, BEHIND), ("stamp not later",)),
        (odometry(0.8, ABREAST), odometry(0.9, BEHIND), ("stamp not later",)),
    ],
)
def test_a_bad_odometry_gives_no_image_but_is_told_and_the_next_good_ones_work(
    sea, leader, follower, words
):
    sea.look(1)
    if leader:
        sea.leader.publish(leader)
    if follower:
        sea.follower.publish(follower)
    sea.lab.report(sea.node, WARN, *words)
    sea.look(3)
    assert sea.seconds_answered() == [1, 3]
    sea.look(4)
    sea.lab.report(sea.node, OK)


def test_a_follower_older_than_the_leaders_record_gets_no_image(sea):
    sea.lead(5)
    sea.follow(4)
    sea.lab.report(sea.node, WARN, "older than every pose on record")
    sea.look(6)
    assert sea.seconds_answered() == [6]


@pytest.mark.parametrize("given", ["", "bow_eye"])
def test_the_images_frame_stands_beside_the_followers_base_link_or_is_given(lab, scene_file, given):
    sea = Sea(lab, scene_file, array_frame=given)
    frames = {"fleet/rov_2/base_link": "fleet/rov_2/array", "base_link": "array"}
    for seconds, child in enumerate(frames, start=1):
        sea.lead(seconds)
        sea.follow(seconds, child=child)
        sea.image(seconds)
    assert [image.header.frame_id for image in sea.images] == [given or f for f in frames.values()]


@pytest.mark.parametrize(("seed", "alike"), [(-1, False), (0, True), (SEED, True)])
def test_a_seed_repeats_the_noise_and_minus_one_draws_a_new_one_at_each_start(
    lab, scene_file, seed, alike
):
    lab.begin({"scene": scene_file, "seed": seed})
    sides = []
    for name in ("/a", "/b"):
        lab.start(SimulatorNode, name)
        talkers = [lab.talk(Odometry, f"{name}/{who}/odometry") for who in ("leader", "follower")]
        sides.append((talkers, lab.listen(Image, f"{name}/array/image")))
    lab.connect()
    readings = []
    for (leader, follower), images in sides:
        leader.publish(odometry(1, ABREAST))
        follower.publish(odometry(1, BEHIND))
        readings.append(lab.answer(images, time_of(10**9)).data.tobytes())
    assert (readings[0] == readings[1]) == alike


def test_a_lamp_is_switched_off_and_on_again_while_the_node_runs(lab):
    scene = load_scene("leading_lights")
    sea = Sea(lab, "leading_lights")
    model, noise = ForwardModel(scene), np.random.default_rng(SEED)
    images, expected = [], []
    for seconds, powers in enumerate(([1.0], [1.0, 0.0, 0.5], [0.0], [1.0, 1.0, 1.0]), start=1):
        lab.set(sea.node, "lamp_power", powers)
        images.append(sea.look(seconds).reshape(3, 5, 5))
        expected.append(model.expose(seen(ABREAST, BEHIND)[0], noise).reshape(3, 5, 5))
    np.testing.assert_array_equal(images[0], expected[0])
    np.testing.assert_array_equal(images[1][0], expected[1][0])
    np.testing.assert_array_equal(images[3], expected[3])
    black = scene.black_counts
    assert max(images[1][1].max(), images[2].max()) < black + 10 < images[0].max(axis=(1, 2)).min()
    np.testing.assert_allclose(images[1][2] - black, (expected[1][2] - black) / 2, atol=10)
    with pytest.raises(ValueError, match="lamp_power: 2 values; give 1, or 3, one for each lamp"):
        sea.node.on_change({"lamp_power": [1.0, 0.0]})


@pytest.mark.parametrize("name", ["follow", "leading_lights"])
def test_the_sea_is_drawn_from_the_prior_by_the_seed_and_said(lab, name):
    sea, scene = Sea(lab, name, draw_sea=True), load_scene(name)
    model, noise = ForwardModel(scene), np.random.default_rng(SEED)
    drawn = draw_sea(scene, np.random.default_rng((SEED, 1)))
    pose, roll = seen(ABREAST, BEHIND)
    (aimed,) = apparent(scene, pose[None], drawn.aims[None])
    assert not sea.node.set_parameters([Parameter("draw_sea", value=False)])[0].successful
    for seconds, power in ((1, 1.0), (2, 0.5)):
        assert lab.set(sea.node, "lamp_power", [power]).successful
        offsets = {key: np.array(value) for key, value in drawn.offsets.items()}
        for key, offset in power_offsets([power], scene.lamp_count).items():
            offsets[key] = offsets[key] + offset
        light = model.with_gains(model.light(aimed, roll, offsets, float(seconds)), drawn.gains)
        np.testing.assert_array_equal(sea.look(seconds), model.read(light, noise))
    values = {pair.key: pair.value for pair in lab.report(sea.node, OK).values}
    head = f"drawn from the prior of scene {name}, seed {SEED}: "
    assert values["sea"] == head + drawn.in_words(scene)


def test_a_sea_that_is_the_scenes_is_said_to_be_so(lab):
    sea = Sea(lab, "follow")
    sea.look(1)
    values = {pair.key: pair.value for pair in lab.report(sea.node, OK).values}
    assert values["sea"] == f"exactly that of scene follow, seed {SEED}"


def test_without_a_seed_the_sea_is_another_at_each_start(lab):
    lab.begin({"scene": "follow"})
    nodes = [SimulatorNode() for _ in range(2)]
    lab.nodes += nodes
    one, other = (node.sea_in_words for node in nodes)
    assert one.startswith("drawn from the prior of scene follow, seed ")
    assert one != other


def test_ranges_are_distances_from_lamp_to_base_link_with_noise_at_their_rate_while_wanted(lab):
    sea = Sea(lab, "follow", range_std_m=0.5, range_rate_hz=2.0)
    ranges = lab.listen(Range, "range")
    lab.connect()
    lamp = np.array(BEACON)
    for k in range(160):
        seconds = 1 + k / 4
        sea.look(seconds)
        if k == 140:
            assert lab.set(sea.node, "range_std_m", 0.0).successful
    stamps = [message.header.stamp for message in ranges]
    assert stamps == [time_of(10**9 + k * 10**9 // 2) for k in range(71)]
    expected = np.linalg.norm(BEHIND[0] - lamp)
    off = np.array([message.range for message in ranges]) - expected
    assert abs(off.mean()) < 5 * 0.5 / math.sqrt(71)
    assert abs(off.std() / 0.5 - 1) < 5 / math.sqrt(2 * 71)
    for message in ranges:
        assert message.header.frame_id == "rov/base_link"
        assert message.min_range < message.range < message.max_range
        assert getattr(message, "variance", 0.25) == 0.25
