"""The leader without a pose to steer by: closed forms of its way, and of what corrects it."""

import math

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from uuv_optical_array.control.leader.motion import (
    ALIKE_S,
    CHANCE,
    CHANGE,
    LEFT_BY_CLOUDS,
    RATE_STD,
    TURN_S,
    Glow,
    LeaderMotion,
    seen_at,
    turning,
)

STATION = np.array([-4.5, 0.0, 0.0, 0.0, 0.0])
KEPT = (0.5, 0.0, 0.0, 0.0, 0.0)  # twist of a follower that keeps its station
POSE = np.array([-4.0, 0.7, -0.3, 0.1, -0.2])


def moved(by):
    """Return the station, moved."""
    return STATION + np.array(by)


def gone(speed=(0.5, 0.0, 0.0), turn=(0.0, 0.0), pose=STATION, covariance=None):
    """Return a leader whose speed and turn are known by a tenth of `RATE_STD`."""
    motion = LeaderMotion(0.0, pose, 1e-4 * np.eye(5) if covariance is None else covariance)
    motion.speed, motion.turn = np.array(speed, dtype=float), np.array(turn, dtype=float)
    motion.covariance[5:, 5:] /= 100
    return motion


def later(motion, seconds, step=0.01, twist=(0.0,) * 5, begin=0.0):
    for k in range(round(seconds / step)):
        motion.advance(begin + (k + 1) * step, np.array(twist))
    return motion


@pytest.mark.parametrize("speed", [(0.5, 0.0, 0.0), (0.4, 0.2, -0.1)])
@pytest.mark.parametrize("pose", [STATION, POSE])
def test_a_leader_goes_straight_on_and_is_less_and_less_known(speed, pose):
    motion = later(gone(speed, pose=pose), 6.0)
    np.testing.assert_allclose(motion.place, 6.0 * np.array(speed), rtol=1e-9)
    np.testing.assert_allclose(motion.heading, 0, atol=1e-12)
    # A random walk of the velocity, and its integral.
    begun = gone(speed, pose=pose).covariance
    of_rate = np.square(RATE_STD / 10) + np.square(CHANGE) * 6.0
    of_pose = (
        begun.diagonal()[:5] + np.square(RATE_STD / 10) * 36.0 + np.square(CHANGE) * 6.0**3 / 3
    )
    np.testing.assert_allclose(motion.covariance.diagonal()[5:], of_rate, rtol=1e-9)
    np.testing.assert_allclose(motion.covariance.diagonal()[:5], of_pose, rtol=1e-4)
    assert motion.unseen_s == pytest.approx(6.0)


def test_a_leader_that_turned_is_expected_to_turn_on_for_a_while():
    motion = later(gone(turn=(0.01, 0.1)), 6.0, 0.002)
    lasts = TURN_S * (1 - math.exp(-6.0 / TURN_S))
    assert motion.heading == pytest.approx([0.01 * lasts, 0.1 * lasts], rel=2e-3)
    # Along its own axis all the while: the way is as long as without a turn, but for the chord.
    assert np.linalg.norm(motion.place) == pytest.approx(3.0, rel=0.02)
    assert motion.place[1] > 0.3


@pytest.mark.parametrize("turn", [0.4, -0.2])
def test_the_way_of_a_step_is_the_chord_of_its_arc(turn):
    motion = later(gone(turn=(0.0, turn)), 0.5, 0.5)
    angle, radius = 0.5 * turn, 0.5 / turn
    chord = [radius * np.sin(angle), radius * (1 - np.cos(angle)), 0.0]
    np.testing.assert_allclose(motion.place, chord, atol=1e-3)
    assert motion.heading[1] == pytest.approx(angle)


@pytest.mark.parametrize("pose", [STATION, POSE])
def test_what_a_pose_knows_of_its_leader_follows_from_its_slopes(pose):
    root = np.diag([0.3, 0.05, 0.08, 0.02, 0.04]) + 0.01 * np.tri(5)
    own, covariance = pose.copy(), root @ root.T
    slopes = np.array(
        [
            approx_fprime(pose, lambda at, i=i: np.concatenate(seen_at(own, at))[i], 1e-7)
            for i in range(5)
        ]
    )
    found = gone(pose=pose, covariance=covariance).covariance[:5, :5]
    np.testing.assert_allclose(found, slopes @ covariance @ slopes.T, atol=1e-6)


def test_a_pose_corrects_as_gaussians_are_joined():
    """In information form, for a pose that comes when errors are no longer alike."""
    # The follower kept its station.
    motion, seen = later(gone(), ALIKE_S, 0.1, KEPT), 0.04 * np.diag([4.0, 1.0, 1.0, 0.3, 0.3])
    before, place = motion.covariance.copy(), motion.place.copy()
    own = moved([0.5, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(motion.own, own, atol=1e-12)
    pose = moved([0.3, 0.2, 0.0, 0.0, 0.0])
    slopes = np.array(
        [
            approx_fprime(pose, lambda at, i=i: np.concatenate(seen_at(own, at))[i], 1e-7)
            for i in range(5)
        ]
    )
    known = np.linalg.inv(slopes @ seen @ slopes.T)
    sees = np.eye(5, 10)
    after = np.linalg.inv(np.linalg.inv(before) + sees.T @ known @ sees)
    off = np.concatenate(seen_at(own, pose)) - np.concatenate([place, [0, 0]])
    shift = after @ sees.T @ known @ off
    assert motion.expects(pose, seen)
    motion.see(pose, seen)
    np.testing.assert_allclose(motion.covariance, after, atol=1e-7)
    np.testing.assert_allclose(motion.place - place, shift[:3], atol=1e-7)
    np.testing.assert_allclose(motion.speed - [0.5, 0, 0], shift[5:8], atol=2e-3)
    assert motion.unseen_s == 0


def test_poses_whose_errors_are_alike_count_as_one():
    """Ten within a second leave as much as one does, but for what the motion adds."""
    often, once = later(gone(), 3.0, twist=KEPT), later(gone(), 3.0, twist=KEPT)
    for k in range(10):
        often.advance(3.0 + (k + 1) * ALIKE_S / 10, np.array(KEPT))
        often.see(STATION, 0.25 * np.eye(5))
    later(once, ALIKE_S, twist=KEPT, begin=3.0).see(STATION, 0.25 * np.eye(5))
    ratio = often.covariance.diagonal()[:3] / once.covariance.diagonal()[:3]
    assert ratio == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_light_aside_moves_the_leader_across_the_line_of_sight(side):
    motion = later(gone((0.0, 0.0, 0.0)), 3.0)
    before = motion.covariance.copy()
    for k in range(30):
        motion.advance(3.1 + 0.1 * k, np.zeros(5))
        motion.face(Glow(0.4 * side, -0.2 * side, 100.0))
    assert side * motion.place[1] > 0.1
    assert side * motion.place[2] < -0.05
    assert abs(motion.place[0]) < 0.2 * abs(motion.place[1])
    # Of the range it says nothing.
    assert motion.covariance[0, 0] > before[0, 0]
    assert motion.covariance[1, 1] < motion.covariance[0, 0]


@pytest.mark.parametrize(("yaw", "to_port"), [(math.pi, 0.0), (1.5, 0.0), (1.5, 0.5)])
def test_light_where_the_leader_cannot_be_is_not_its(yaw, to_port):
    motion = later(gone((0.0, 0.0, 0.0)), 0.5, twist=(0, 0, 0, 0, 2 * yaw))
    motion.face(Glow(to_port, 0.0, 100.0))
    assert motion.unseen_s == pytest.approx(0.5)
    assert not motion.place.any()


@pytest.mark.parametrize("range_m", [2.0, 3.5, 7.0])
def test_a_lamp_behind_the_darkest_cloud_is_kept_off_exactly(range_m):
    """Its light is that of the inverse square, less what the cloud takes."""
    peak = 600.0 * (4.5 / range_m) ** 2 * LEFT_BY_CLOUDS
    assert Glow(0.0, 0.0, peak).nearest_m(4.5, 600.0) == pytest.approx(range_m)


def test_the_rate_is_learnt_from_poses():
    """Of a leader that goes and turns steadily, with a follower that stays where it is."""
    motion, turn = LeaderMotion(0.0, STATION, 1e-4 * np.eye(5)), np.array([0.0, 0.05])
    for k in range(1, 41):
        heading = 0.1 * k * turn[1]
        arc = np.array([math.sin(heading), 1 - math.cos(heading), 0.0]) * 0.4 / turn[1]
        back = Rotation.from_euler("z", -heading)
        pose = [*back.apply(STATION[:3] - arc), 0.0, -heading]
        motion.advance(0.1 * k, np.zeros(5))
        assert motion.expects(np.array(pose), 1e-4 * np.eye(5))
        motion.see(np.array(pose), 1e-4 * np.eye(5))
    np.testing.assert_allclose(motion.speed, [0.4, 0, 0], atol=0.03)
    np.testing.assert_allclose(motion.turn, turn, atol=0.01)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("share", "expected"), [(0.999, True), (1.001, False)])
def test_a_lamp_is_the_leaders_within_what_it_and_the_pose_may_err(axis, share, expected):
    """Beside a leader that stays, by the chi-square of three places; the attitude is known."""
    known = np.diag([0.01, 0.04, 0.09, 1e-12, 1e-12])
    motion, seconds = gone((0.0, 0.0, 0.0), covariance=known), 2.0
    motion = later(motion, seconds)
    spread = 2 * known[axis, axis] + (RATE_STD[axis] / 10 * seconds) ** 2
    spread += CHANGE[axis] ** 2 * seconds**3 / 3
    off = np.zeros(5)
    off[axis] = share * math.sqrt(chi2.isf(CHANCE, 3) * spread)
    assert motion.expects(STATION - off, known) == expected


def test_a_place_turns_about_the_axes_of_pitch_and_yaw():
    turn, place = np.array([0.3, -0.2]), np.array([-4.0, 0.7, 0.5])
    np.testing.assert_allclose(turning(turn, place), np.cross([0.0, *turn], place))
