"""The simulator node and other vehicles: their lamps and bodies as the core draws them."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation
from simulated_seas import ABREAST, BEACON, BEHIND, SEED, Sea, odometry

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.others import Other, sight
from uuv_optical_array.forward.scene import load_scene

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
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
