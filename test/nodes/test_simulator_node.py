"""The simulator node: the image that the core exposes, for poses composed with SciPy."""

import numpy as np
import pytest
from conftest import write_scene
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from odometries import odometry as odometry_message
from odometries import time_of
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.others import Other, sight
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.simulator_node import SimulatorNode

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
BEACON = [-0.7, 0.1, 0.2]
SEED = 11
ABREAST = np.zeros(3), Rotation.identity()
BEHIND = np.array([-5.0, 0.0, 0.0]), Rotation.identity()
LOST = np.array([0.0, np.nan, 0.0]), Rotation.identity()
HALF_A_TURN = Rotation.from_euler("X", np.pi)


def odometry(seconds, place, child="rov/base_link", frame="odom"):
    return odometry_message(round(seconds * 10**9), *place, frame, child)


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


class Sea:
    """Publishes the odometry of both vehicles and collects the images."""

    def __init__(self, lab, scene_file, **parameters):
        self.lab = lab
        given = {"seed": SEED, "beacon_position_m": BEACON, **parameters}
        named = {f"simulator_node:{name}": value for name, value in given.items()}
        lab.begin({"scene": scene_file, **named})
        self.node = lab.start(SimulatorNode)
        self.leader = lab.talk(Odometry, "leader/odometry")
        self.follower = lab.talk(Odometry, "follower/odometry")
        self.images = lab.listen(Image, "array/image")
        lab.connect()

    def image(self, seconds):
        message = self.lab.answer(self.images, time_of(round(seconds * 10**9)), "an image")
        assert (message.encoding, message.width) == ("mono16", 5)
        return np.frombuffer(message.data, "<u2").reshape(message.height, 5)

    def lead(self, seconds, place=ABREAST):
        self.leader.publish(odometry(seconds, place))

    def follow(self, seconds, place=BEHIND, **names):
        self.follower.publish(odometry(seconds, place, **names))

    def look(self, seconds, leader=ABREAST, follower=BEHIND):
        """Publish both poses of one instant and return the image of it."""
        self.lead(seconds, leader)
        self.follow(seconds, follower)
        return self.image(seconds)

    def seconds_answered(self):
        return [image.header.stamp.sec for image in self.images]


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
    values = {pair.key: float(pair.value) for pair in status.values}
    assert values["refused"] == 0
    assert 4 <= values["range_m"] <= 6


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


ONE, TWO = "/rov_1/odometry", "/rov_2/odometry"
BESIDE = np.array([-0.2, 1.4, 0.1]), Rotation.from_euler("ZYX", [0.1, -0.05, 0.2])
BETWEEN = np.array([-3.0, -0.4, -0.5]), Rotation.from_euler("ZYX", [0.3, 0.2, 0.0])


def among(others, scene, noise, codes=(0, 0)):
    """Return the image of `BEHIND` that the core draws with others."""
    model, beacon = ForwardModel(load_scene(scene)), tuple(BEACON)
    vehicles = [
        Other(at, turn.as_matrix(), code=code, lamp_m=beacon)
        for (at, turn), code in zip([ABREAST, *others], [0, *codes], strict=False)
    ]
    follower = BEHIND[0], BEHIND[1].as_matrix()
    seen = sight(model, follower, vehicles[0], vehicles[1:], {}, 1.0)
    return model.read(seen.light, noise, seen.beside)


@pytest.mark.parametrize("apart", [False, True])
def test_the_image_has_the_lamps_and_bodies_of_others_where_they_were_at_its_stamp(lab, apart):
    scene = "sunlit_modulated"
    sea = Sea(lab, scene, others=f"{ONE}  {TWO}", code_by_vehicle=apart)
    talkers = [lab.talk(Odometry, name) for name in (ONE, TWO)]
    lab.connect()
    step = np.array([0.05, -0.1, 0.02])
    for talker, (at, turn) in zip(talkers, (BESIDE, BETWEEN), strict=True):
        for share in (-1, 1):  # they pass their places at 1 s
            talker.publish(odometry(1 + 0.1 * share, (at + share * step, turn)))
    lab.until(lambda: all(each.newest_ns == 1.1e9 for each in sea.node.others.values()), "both")
    image = sea.look(1)
    noises = [np.random.default_rng(SEED) for _ in range(2)]
    codes = (1, 2) if apart else (0, 0)
    np.testing.assert_array_equal(image, among([BESIDE, BETWEEN], scene, noises[0], codes))
    alone = among([], scene, noises[1])
    assert (abs(image - alone).max() > 50) == (not apart)
    lab.report(sea.node, OK)


def test_an_other_that_never_speaks_is_left_out_and_told_of(sea_of_two):
    sea, talkers = sea_of_two
    np.testing.assert_array_equal(sea.look(1), sea.model_alone())
    sea.lab.report(sea.node, WARN, f"left out: no pose of {ONE}, {TWO} at")
    talkers[0].publish(odometry(2, BESIDE))
    sea.lab.until(lambda: sea.node.others[ONE].newest_ns, "the first")
    sea.look(2)
    sea.lab.report(sea.node, WARN, f"left out: no pose of {TWO} at")


def test_an_image_waits_for_an_other_that_is_late_and_not_for_one_that_fell_silent(sea_of_two):
    sea, (one, two) = sea_of_two
    for talker in (one, two):
        talker.publish(odometry(1.0, BESIDE))
    sea.lab.until(lambda: all(each.newest_ns for each in sea.node.others.values()), "both")
    sea.lead(1.0)
    sea.lead(1.3)
    sea.follow(1.1)
    sea.lab.until(lambda: len(sea.node.waiting) == 1, "a pose to wait")
    one.publish(odometry(1.2, BESIDE))
    sea.lab.until(lambda: sea.node.others[ONE].newest_ns > 1.1e9, "the first")
    assert not sea.images
    two.publish(odometry(1.2, BESIDE))
    sea.image(1.1)
    for seconds in (1.6, 1.9):
        one.publish(odometry(seconds, BESIDE))
        sea.lead(seconds)
    sea.lab.until(lambda: sea.node.others[ONE].newest_ns == 1.9e9, "the first alone")
    sea.follow(1.8)  # 0.6 s after the second's last
    sea.image(1.8)
    sea.lab.report(sea.node, WARN, f"left out: no pose of {TWO} at")


def test_an_other_in_another_frame_is_refused(sea_of_two):
    sea, (one, two) = sea_of_two
    two.publish(odometry(1, BESIDE))
    sea.look(1)
    one.publish(odometry(1, BESIDE, frame="map"))
    sea.lab.report(sea.node, WARN, f"{ONE}, frames differ", "map")


@pytest.fixture
def sea_of_two(lab, scene_file):
    sea = Sea(lab, scene_file, others=f"{ONE} {TWO}")
    talkers = [lab.talk(Odometry, name) for name in (ONE, TWO)]
    lab.connect()
    sea.model_alone = lambda: among([], scene_file, np.random.default_rng(SEED))
    return sea, talkers
