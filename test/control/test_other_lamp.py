"""A lamp that is not the leader's: closed forms of where a leader can get, and what goes on."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from uuv_optical_array.control.leader.motion import CHANCE, LeaderMotion
from uuv_optical_array.control.leader.other_lamp import (
    MOST_CHANGE,
    ROOM,
    OtherLamp,
    goes_on,
    within_reach,
)
from uuv_optical_array.control.leader.sight import SightSettings

STATION = np.array([-4.5, 0.3, -0.2, 0.05, -0.1])
FIVE, ONE = chi2.isf(CHANCE, 5), chi2.isf(CHANCE, 1)
SURE = 1e-6 * np.eye(5)


@pytest.mark.parametrize("share", [0.98, 1.02])
@pytest.mark.parametrize("axis", range(5))
def test_a_leader_gets_as_far_as_it_speeds_up_and_turns_beside_what_a_pose_errs(axis, share):
    std, since_s = 0.1, 0.7
    reach = ROOM[axis] + MOST_CHANGE[axis] * since_s**2 / 2
    off = np.zeros(5)
    off[axis] = share * math.sqrt(FIVE * (std**2 + reach**2 / ONE))
    assert within_reach(off, std**2 * np.eye(5), since_s) == (share < 1)


@pytest.mark.parametrize("share", [0.98, 1.02])
def test_a_leader_that_turns_where_it_is_goes_on_by_its_turn_alone(share):
    """The follower swings round it: 1.5 m in a pose whose lamp has not moved."""
    since_s = 1.0
    turned = share * math.sqrt(FIVE / ONE) * (ROOM[4] + MOST_CHANGE[4] * since_s**2 / 2)
    back = Rotation.from_euler("z", -turned)
    pose = np.array([*back.apply(STATION[:3]), STATION[3], STATION[4] - turned])
    assert np.linalg.norm(pose[:3] - STATION[:3]) > 1.4
    assert goes_on(STATION, pose, 1e-8 * np.eye(5), since_s) == (share < 1)


@pytest.mark.parametrize("share", [0.98, 1.02])
@pytest.mark.parametrize("axis", range(3))
def test_a_lamp_beside_goes_on_only_from_a_leader_that_can_get_there(axis, share):
    since_s, pose = 0.5, STATION.copy()
    reach = ROOM[axis] + MOST_CHANGE[axis] * since_s**2 / 2
    pose[axis] += share * math.sqrt(FIVE / ONE) * reach
    assert goes_on(STATION, pose, 1e-8 * np.eye(5), since_s) == (share < 1)


def test_a_heading_that_passes_half_a_turn_is_no_jump():
    before = np.array([-4.5, 0.0, 0.0, 0.0, math.pi - 0.001])
    after = np.array([-4.5, 0.0, 0.0, 0.0, 0.001 - math.pi])
    assert goes_on(before, after, SURE, 0.1)


def seen(follower, lamp):
    """Return the pose, ``(5,)``, of a follower by a lamp; each a place, pitch and yaw."""
    axes = Rotation.from_euler("ZYX", [lamp[4], lamp[3], 0.0]).inv()
    return np.array([*axes.apply(follower[:3] - lamp[:3]), *(follower[3:] - lamp[3:])])


def test_a_leader_in_company_is_carried_along_by_the_other_lamp():
    leader = np.array([3.0, 1.0, -0.5, 0.0, 0.4])
    other = np.array([3.2, 2.4, -0.3, 0.0, 0.6])
    follower = np.array([-1.0, 0.2, -0.4, 0.0, 0.5])
    motion = LeaderMotion(0.0, seen(follower, leader), SURE)
    lamp = OtherLamp(0.0, seen(follower, other), SURE, motion)
    # Both as one body to another place; its own motion tells the follower where it got meanwhile.
    carried = Rotation.from_euler("z", 0.7)

    def moved(vehicle):
        place = carried.apply(vehicle[:3]) + np.array([2.0, -1.0, 0.3])
        return np.array([*place, 0.0, vehicle[4] + 0.7])

    lamp.motion = LeaderMotion(0.0, seen(follower, moved(other)), SURE)
    place, heading = lamp.beside(follower)
    expected = moved(leader)
    np.testing.assert_allclose(place, expected[:3], atol=1e-9)
    np.testing.assert_allclose(heading, expected[3:], atol=1e-9)


def test_a_pose_is_of_the_lamp_that_explains_it_better_while_that_is_alone():
    own = np.array([-4.5, 0.0, 0.0, 0.0, 0.0])
    beside = own - np.array([0.0, 1.5, 0.0, 0.0, 0.0])
    leader = LeaderMotion(0.0, own, 0.01 * np.eye(5))
    other = OtherLamp(0.0, beside, 0.01 * np.eye(5), leader)
    leader.covariance = 25 * leader.covariance  # unseen since: it may be at either
    assert leader.expects(beside, SURE)
    assert not other.has(own, SURE, [leader])
    assert other.has(beside, SURE, [leader])
    # A light that settles where the other lamp is is that light, if it knows better.
    settling = LeaderMotion(0.0, beside, SURE)
    other.motion.covariance *= 100
    assert not other.has(beside, SURE, [leader, settling])
    other.motion.covariance /= 1e4
    other.alone = False
    assert not other.has(beside, SURE, [leader])


def company(leader, other, follower):
    """Return a leader and another lamp beside it, both seen well."""
    motion = LeaderMotion(0.0, seen(follower, leader), SURE)
    lamp = OtherLamp(0.0, seen(follower, other), SURE, motion)
    return motion, lamp


def test_a_leader_in_company_has_the_speed_and_the_turn_of_one_body():
    follower = np.array([-4.5, 0.0, 0.0, 0.0, 0.2])
    motion, lamp = company(np.array([0, 0, 0, 0, 0.2]), np.array([0.3, 1.5, 0.2, 0, 0.5]), follower)
    motion.covariance *= 1e6
    lamp.motion.speed, lamp.motion.turn = np.array([0.5, 0.1, 0.0]), np.array([0.0, 0.3])
    before, _ = lamp.beside(motion.own)
    assert lamp.lead(motion)
    np.testing.assert_allclose(motion.place, before, atol=1e-9)
    # The way of a place of that body, by moving the lamp a little.
    step_s = 1e-4
    lamp.motion.advance(step_s, np.zeros(5))
    after, heading = lamp.beside(motion.own)
    by_way = motion.rotation.T @ (after - before) / step_s
    np.testing.assert_allclose(motion.speed, by_way, atol=1e-3)
    np.testing.assert_allclose(motion.turn, (heading - motion.heading) / step_s, atol=1e-3)


def test_a_leader_that_cannot_be_beside_the_other_lamp_goes_its_own_way():
    follower = np.array([-4.5, 0.0, 0.0, 0.0, 0.0])
    motion, lamp = company(np.zeros(5), np.array([0.0, 1.5, 0.0, 0.0, 0.0]), follower)
    lamp.motion = LeaderMotion(0.0, seen(follower, np.array([2.0, 1.5, 0.0, 0.0, 0.0])), SURE)
    motion.speed = np.array([0.5, 0.0, 0.0])
    assert not lamp.lead(motion)
    np.testing.assert_array_equal(motion.speed, [0.5, 0.0, 0.0])
    np.testing.assert_allclose(motion.place, 0.0, atol=1e-12)


def test_a_dim_pose_is_the_other_lamps_and_tells_nothing_of_its_motion():
    follower = np.array([-4.5, 0.0, 0.0, 0.0, 0.0])
    motion, lamp = company(np.zeros(5), np.array([0.0, 1.5, 0.0, 0.0, 0.0]), follower)
    lamp.motion.advance(1.0, np.zeros(5))
    place = lamp.motion.place.copy()
    pose = seen(follower, np.array([0.4, 1.5, 0.0, 0.0, 0.0]))
    lamp.motion.covariance += np.eye(10)
    assert lamp.has(pose, np.diag([1.1, 0.1, 0.1, 0.1, 0.1]), [motion])
    np.testing.assert_array_equal(lamp.motion.place, place)
    assert lamp.has(pose, np.diag([0.1, 0.1, 0.1, 0.1, 0.1]), [motion])
    assert np.linalg.norm(lamp.motion.place - place) > 0.1


def pair(place_y, off=(0.0, 0.0, 0.0)):
    """Return another lamp 1.5 m to port of a leader, which is expected `off` of where it is.

    The follower is 5 m behind, so far to port of the leader; both shine.
    """
    follower, to_port = np.array([-5.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.0, 1.5, 0.0, 0.0, 0.0])
    leader, other = company(np.zeros(5), to_port, follower)
    other.alone = False
    leader.own[1] = place_y
    leader.place = np.array(off)
    leader.covariance[:3, :3] = 0.2 * np.eye(3)
    return other, leader


@pytest.mark.parametrize(
    ("place_y", "mixes"), [(-0.5, False), (0.0, False), (0.75, True), (1.5, True)]
)
def test_light_is_ours_where_the_other_lamp_is_dim(place_y, mixes):
    other, leader = pair(place_y)
    assert other.mixes(leader, SightSettings()) == mixes
    other.alone = True
    assert not other.mixes(leader, SightSettings())


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.3, -0.4, 0.2), (-0.3, 0.2, 0.0)])
def test_halfway_between_two_equal_lamps_their_light_is_from_halfway(off):
    """So says symmetry. A step to a side turns the light so much that it tells little of that."""
    other, leader = pair(0.75, off)
    pose = np.array([-5.0, 0.0, 0.0, 0.0, 0.0])  # as of a lamp between the two
    for tick in range(200):
        leader.advance(0.1 * tick, np.zeros(5))
        other.see_both(pose, np.diag([0.01, 0.01, 0.01, 1e-4, 1e-4]), leader, SightSettings())
    assert leader.place[[0, 2]] == pytest.approx([0.0, 0.0], abs=0.05)
    assert math.sqrt(leader.covariance[1, 1]) > max(0.4, 0.5 * abs(leader.place[1]))
    if not off[1]:
        assert leader.place[1] == pytest.approx(0.0, abs=0.01)
    assert leader.unseen_s == 0


def test_light_where_no_leader_can_be_tells_nothing():
    other, leader = pair(0.75)
    far = np.array([-5.0, 6.0, 0.0, 0.0, 0.0])
    other.see_both(far, 1e-4 * np.eye(5), leader, SightSettings())
    assert leader.place.tolist() == [0.0, 0.0, 0.0]
