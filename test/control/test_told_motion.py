"""What a leader tells of its motion: its sign, its weight, what is refused, and where it leads."""

from functools import partial

import numpy as np
import pytest
from pursuit import OPEN, TICK_S, Pursuit
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.darkness import SearchSettings
from uuv_optical_array.control.formation import FormationController
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.motion import LeaderMotion
from uuv_optical_array.control.leader.told_motion import (
    AHEAD_S,
    CHANGES,
    MOST_STDS,
    OLDEST_S,
    Message,
    Told,
    ToldMotion,
    as_rate,
    twist_of_lamp,
)
from uuv_optical_array.control.vehicles.vehicle import Vehicle
from uuv_optical_array.core.geometry import relative_pose
from uuv_optical_array.studies.closed_loops.modem import LATE_S, PERIOD_S, STDS, Modem

POSE = np.array([-4.5, 0.8, -0.4, 0.2, -0.3])
TWIST = np.array([0.5, 0.1, -0.2, 0.1, 0.3])  # without the roll rate
LINEAR, ANGULAR = TWIST[:3], np.array([0.0, *TWIST[3:]])
SHOWN = np.array([-0.3, 1.1, -0.2, -0.05, -0.25])
MODEM = np.diag(STDS**2)
LINKED = MODEM + 1.1 * STDS[0] * STDS[1] * (np.eye(6, k=1) + np.eye(6, k=-1))
TINY_S = 1e-5
AHEAD = np.array([1.0, 0.0, 0.0])


def agreed(leader, since_s=0.0):
    """Let a leader tell, thrice, what exact light shows; the last time is returned."""
    rate, _ = as_rate(Told(0.0, TWIST, np.eye(5)), POSE, 0.0)
    for i in range(1, 4):
        stamp_s = since_s + 0.1 * i
        leader.light(stamp_s, POSE, rate, 1e-3 * np.eye(5))
        assert leader.told(stamp_s) is None
        leader.take(stamp_s, Message(stamp_s, LINEAR, ANGULAR, MODEM))
    return stamp_s


def covariances(count, scale=0.05):
    rng = np.random.default_rng(3)
    roots = scale * rng.normal(size=(count, 5, 5))
    return [root @ root.T + 1e-4 * np.eye(5) for root in roots]


def moved(pose, twist):
    """Return the pose of a follower at rest once its leader has gone by a twist, ``(6,)``."""
    own = Rotation.from_euler("ZYX", [pose[4], pose[3], 0.0])
    turned = Rotation.from_rotvec(twist[3:]).as_matrix()
    return relative_pose(twist[:3], turned, pose[:3], own.as_matrix())[0]


def test_the_rate_of_a_pose_is_that_of_a_follower_at_rest_as_its_leader_moves():
    twist = np.concatenate([LINEAR, ANGULAR])
    expected = (moved(POSE, TINY_S * twist) - moved(POSE, -TINY_S * twist)) / (2 * TINY_S)
    rate, _ = as_rate(Told(0.0, TWIST, np.eye(5)), POSE, 0.0)
    np.testing.assert_allclose(rate, expected, atol=1e-6)


def test_its_covariance_is_that_of_the_twist_and_grows_by_how_leaders_change_their_motion():
    (told, _), slopes = covariances(2), []
    for unit in np.eye(6)[[0, 1, 2, 4, 5]]:
        slopes.append((moved(POSE, TINY_S * unit) - moved(POSE, -TINY_S * unit)) / (2 * TINY_S))
    by_twist = np.transpose(slopes)
    at_once = as_rate(Told(0.0, TWIST, told), POSE, 0.0)[1]
    np.testing.assert_allclose(at_once, by_twist @ told @ by_twist.T, atol=1e-6)
    # Long after, it says no more of this leader than any leader's motion does of another's.
    long_after = as_rate(Told(0.0, TWIST, told), POSE, 1e3)[1]
    apart = told + np.diag(2 * CHANGES**2)
    np.testing.assert_allclose(long_after, by_twist @ apart @ by_twist.T, atol=1e-6)
    before = as_rate(Told(0.0, TWIST, told), POSE, -0.7)[1]
    np.testing.assert_allclose(before, as_rate(Told(0.0, TWIST, told), POSE, 0.7)[1])


def test_what_is_told_and_what_light_shows_are_weighed_by_their_information():
    told, shown = covariances(2)
    six = np.eye(6)
    six[np.ix_([0, 1, 2, 4, 5], [0, 1, 2, 4, 5])] = told
    leader = ToldMotion()
    agreed(leader, 0.5)
    leader.take(1.2, Message(1.0, LINEAR, ANGULAR, six))
    rate, spread = as_rate(Told(1.0, TWIST, told), POSE, 0.3)
    light = rate + np.sqrt(shown.diagonal()) * [1, -1, 1, -1, 1]
    inverse = np.linalg.inv
    mean = inverse(inverse(spread) + inverse(shown)) @ (
        inverse(spread) @ rate + inverse(shown) @ light
    )
    np.testing.assert_allclose(leader.fused(1.3, POSE, light, shown), mean, atol=1e-9)
    # Too old, it does not count; nor where the leader has changed its motion since.
    np.testing.assert_array_equal(leader.fused(1.01 + OLDEST_S, POSE, light, shown), light)
    away = light + 20 * MOST_STDS * np.sqrt((spread + shown).diagonal())
    np.testing.assert_array_equal(leader.fused(1.3, POSE, away, shown), away)


def test_the_law_goes_by_both():
    told, shown = np.diag([0.02**2] * 6), 0.01 * np.eye(5)
    law = FormationController(OPEN)
    agreed(law.leader, 4.5)
    law.leader.take(5.0, Message(5.0, LINEAR, ANGULAR, told))
    law.update(5.0, POSE, 1e-4 * np.eye(5), SHOWN, shown)
    beside = ToldMotion()
    agreed(beside, 4.5)
    beside.take(5.0, Message(5.0, LINEAR, ANGULAR, told))
    by_both = beside.fused(5.0, POSE, SHOWN, shown)  # no command: the rate is the leader's
    assert np.abs(by_both - SHOWN).max() > 0.05
    np.testing.assert_allclose(law.last.leader_rate, by_both)
    law.update(5.1, POSE, 1e-4 * np.eye(5), SHOWN)  # of unknown covariance
    np.testing.assert_allclose(law.last.leader_rate, SHOWN)
    with pytest.raises(ValueError, match="covariance: variances"):
        law.update(5.2, POSE, 1e-4 * np.eye(5), SHOWN, np.zeros((5, 5)))
    assert law.last.stamp_ns == 5_100_000_000


@pytest.mark.parametrize(
    ("stamp_s", "linear", "covariance", "reason"),
    [
        (10 - OLDEST_S - 0.01, LINEAR, MODEM, r"late motion: the leader's motion is 3\.01 s old"),
        (10 + AHEAD_S + 0.01, LINEAR, MODEM, r"stamp ahead: 0\.31 s later"),
        (np.nan, LINEAR, MODEM, "late motion"),
        (9.0, LINEAR, MODEM, r"stamp not later: 9\.000 s came after 9\.000 s"),
        (9.5, [np.nan, 0, 0], MODEM, "motion: .*within"),
        (9.5, [0, 10.1, 0], MODEM, "motion: .*within"),
        (9.5, [0, 0, 0, 0], MODEM, "motion: .*within"),
        (9.5, LINEAR, 0 * MODEM, "covariance: variances .*greater than 0"),
        (9.5, LINEAR, np.nan * MODEM, "covariance"),
        (9.5, LINEAR, 1e12 * MODEM, "covariance: .*give at most"),
        (9.5, LINEAR, MODEM[:5, :5], r"covariance: its shape is \(5, 5\)"),
        (9.5, LINEAR, LINKED, "covariance: .*positive definite"),
        (9.5, [-9.5, 0.1, -0.2], 1e-4 * MODEM, "false motion: the leader changes x by 9.8 m/s"),
    ],
)
def test_a_motion_that_cannot_be_is_refused_and_the_one_before_stays(
    stamp_s, linear, covariance, reason
):
    leader = ToldMotion()
    agreed(leader, 8.5)
    leader.take(9.2, Message(9.0, LINEAR, ANGULAR, MODEM))
    with pytest.raises(ValueError, match=reason):
        leader.take(10.0, Message(stamp_s, linear, ANGULAR, covariance))
    assert leader.told(10.0).stamp_s == 9.0
    leader.take(10.0, Message(9.6, LINEAR, ANGULAR, MODEM))
    assert leader.told(10.0).stamp_s == 9.6


def test_who_is_wrong_in_the_light_is_not_believed_until_three_in_a_row_agree_with_it():
    leader = ToldMotion()
    now_s = agreed(leader)
    assert leader.told(now_s).stamp_s == now_s
    with pytest.raises(ValueError, match="false motion"):
        leader.take(now_s + 0.2, Message(now_s + 0.2, LINEAR + AHEAD, ANGULAR, MODEM))
    for i in range(4, 9):  # without light to agree with
        leader.take(now_s + i, Message(now_s + i, LINEAR, ANGULAR, MODEM))
        assert leader.told(now_s + i) is None
    now_s = agreed(leader, 20.0)
    assert leader.told(now_s).stamp_s == now_s
    with pytest.raises(ValueError, match="false motion"):  # which no light shows so late
        leader.take(40.0, Message(40.0, LINEAR + 9 * AHEAD, ANGULAR, MODEM))
    leader.take(41.0, Message(41.0, LINEAR + AHEAD, ANGULAR, MODEM))
    assert leader.told(41.0).stamp_s == 41.0


def test_it_is_judged_by_the_light_of_its_own_time():
    """A motion is told late: by then the light may show another."""
    leader, late_s = ToldMotion(), 0.8
    for tick in range(60):
        now_s = 0.1 * tick
        turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0 if now_s < 3.0 else 0.35])
        rate, _ = as_rate(Told(0.0, TWIST + turn, np.eye(5)), POSE, 0.0)
        leader.light(now_s, POSE, rate, 1e-6 * np.eye(5))
        if now_s >= late_s:
            then = [0.0, 0.0, 0.0 if now_s - late_s < 3.0 - 1e-6 else 0.35]
            leader.take(now_s, Message(now_s - late_s, LINEAR, ANGULAR + then, 1e-3 * MODEM))


def test_a_clock_that_is_set_back_begins_anew():
    leader = ToldMotion()
    assert leader.told(agreed(leader, 1000.0)) is not None
    assert leader.told(5.0) is None
    leader.take(5.0, Message(4.5, LINEAR, ANGULAR, MODEM))
    assert leader.told(5.0).stamp_s == 4.5


def test_the_lamp_moves_as_a_point_of_its_vehicle():
    rng, place = np.random.default_rng(4), np.array([-0.8, 0.2, 0.3])
    twist = rng.normal(size=6)

    def went(step):  # the lamp's way in a short time, in axes of the middle of it
        turned = Rotation.from_rotvec(step[3:])
        return np.concatenate([step[:3] + turned.apply(place) - place, step[3:]])

    slopes = [(went(TINY_S * unit) - went(-TINY_S * unit)) / (2 * TINY_S) for unit in np.eye(6)]
    by_twist = np.transpose(slopes)
    root = rng.normal(size=(6, 6))
    lamps, spread = twist_of_lamp(place, twist, root @ root.T)
    np.testing.assert_allclose(lamps, by_twist @ twist, atol=1e-8)
    np.testing.assert_allclose(spread, by_twist @ root @ root.T @ by_twist.T, atol=1e-7)


class Heard(Pursuit):
    """A pursuit whose leader, unless it is `silent`, tells of its motion at 1 Hz, 0.5 s late."""

    silent, told_wrong = False, 0.0
    stds = STDS

    def step(self):
        tick = self.tick - round(LATE_S / TICK_S)
        if tick >= 0 and tick % round(PERIOD_S / TICK_S) == 0 and not self.silent:
            speed, turn = self.motions[tick]
            told = (
                speed + np.array([self.told_wrong, 0, 0]),
                [0.0, 0.0, turn],
                np.diag(self.stds**2),
            )
            try:
                self.following.leader_moves(self.now, Message(tick * TICK_S, *told))
            except ValueError as reason:
                self.refusals.append(str(reason).partition(":")[0])
        self.motions.append((self.speed.copy(), self.turn))
        super().step()

    def __init__(self, **changes):
        super().__init__(**changes)
        self.motions, self.refusals = [], []
        spread = np.diag([0.03, 0.03, 0.03, *np.radians([1.0, 1.0])]) ** 2
        self.following.update = partial(self.following.update, rate_covariance=spread)

    def goes_dark(self, lit_s=8.0):
        self.run(lit_s)
        assert self.state == "locked"
        self.light = False
        return self


LONG = SearchSettings(coast_s=8.0)


def test_without_light_it_follows_a_turn_that_is_told():
    told, alone = (Heard(search=LONG).goes_dark() for _ in range(2))
    alone.silent = True
    for pursuit in (told, alone):
        pursuit.run(2.0)
        pursuit.turn = np.radians(10.0)
        pursuit.run(9.0)
        pursuit.turn = 0.0
        pursuit.run(4.0)
    assert told.states == ["waiting", "locked", "coasting"]
    # A turn that begins or ends between two stamps is half a second off at most: 5 deg at 4.5 m.
    assert told.off_station() < np.radians(5.0) * 4.5 + 0.3
    assert alone.off_station() > 2.0


def test_it_passes_where_the_lamp_was_seen_once_the_leader_tells_that_it_left():
    told, alone = (Heard(formation=FormationSettings(), search=LONG).goes_dark() for _ in range(2))
    alone.silent = True
    for pursuit in (told, alone):
        pursuit.run(LONG.coast_s - 1.0)  # 3.5 m, to within the minimum of the last place
        assert pursuit.state == "coasting"
    assert told.off_station() < 0.1
    assert alone.off_station() > 0.5


@pytest.mark.parametrize(("std_m_per_s", "coasts"), [(0.05, True), (5.0, False)])
def test_it_coasts_on_while_what_is_told_says_where_the_lamp_is(std_m_per_s, coasts):
    pursuit = Heard(search=LONG)
    pursuit.stds = np.repeat([std_m_per_s, np.radians(1.0)], 3)
    pursuit.goes_dark().run(2 * LONG.coast_s)
    assert pursuit.state == ("coasting" if coasts else "searching")


def test_it_coasts_for_its_time_after_the_last_word_and_no_longer_than_a_search():
    pursuit = Heard(search=LONG).goes_dark().run(6.0)
    pursuit.silent = True  # the last came half a second after 13 s
    pursuit.until("searching")
    assert pursuit.now == pytest.approx(13.5 + LONG.coast_s, abs=2.5 * TICK_S)
    short = SearchSettings(coast_s=4.0, search_time_s=10.0)
    pursuit = Heard(search=short).goes_dark().until("searching")
    assert pursuit.now == pytest.approx(8.0 + short.search_time_s, abs=2.5 * TICK_S)


def test_a_filter_of_the_leader_weighs_what_it_hears():
    turned = Rotation.from_euler("z", 0.7).as_matrix()
    shown = 0.01 * np.eye(5)
    leader = LeaderMotion(0.0, np.array([-4.5, 0, 0, 0, 0]), shown)
    leader.heading = np.array([0.0, 0.7])
    rates, told = leader.covariance[5:, 5:].copy(), np.diag([4e-3, 1e-3, 9e-3, 1e-3, 2e-3])
    leader.hear(TWIST, told)
    in_water = np.eye(5)
    in_water[:3, :3] = turned
    mean = rates @ np.linalg.inv(rates + in_water @ told @ in_water.T) @ in_water @ TWIST
    np.testing.assert_allclose(turned @ leader.speed, mean[:3], atol=1e-9)
    np.testing.assert_allclose(leader.turn, mean[3:], atol=1e-9)


@pytest.mark.parametrize("wrong", [9.0, -9.0, 1.0])
def test_a_wrong_word_does_as_much_as_none(wrong):
    wronged, alone = Heard(search=LONG), Heard(search=LONG)
    wronged.told_wrong, alone.silent = wrong, True
    for pursuit in (wronged, alone):
        pursuit.goes_dark().run(9.0)
    assert wronged.refusals[:8] == 8 * ["false motion"]  # all that came in the light
    np.testing.assert_array_equal(wronged.own, alone.own)


def test_a_modem_is_late_and_tells_of_the_motion_through_the_water():
    modem, leader = Modem(np.random.default_rng(5)), Vehicle(np.zeros(3), yaw=0.4)
    errors, stamps = [], []
    for tick in range(4001):
        leader.step([0.5, 0.1, 0.0], [0.0, 0.0, 0.05], 0.1)
        message = modem(leader, 0.1 * tick)
        if message is not None:
            stamps.append((message.stamp_s, 0.1 * tick))
            if tick > 100:
                truth = 0.5, 0.1, 0.0, 0.0, 0.0, 0.05
                errors.append(np.concatenate([message.linear, message.angular]) - truth)
    told_s, came_s = np.transpose(stamps)
    np.testing.assert_allclose(came_s - told_s, LATE_S, atol=1e-6)
    np.testing.assert_allclose(np.diff(told_s), PERIOD_S, atol=1e-6)
    shares = np.array(errors) / STDS
    assert abs(shares.mean()) < 5 / np.sqrt(shares.size)
    assert abs((shares**2).mean() - 1) < 5 * np.sqrt(2 / shares.size)
