"""Which lamp a follower takes for its leader's as one goes out, is lit or jumps."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pursuit import LIT_S, SHORT, STD_M, TICK_S, TIMEOUT_S, Pursuit, dark
from scipy.special import chdtri

from uuv_optical_array.control.darkness import DOUBT
from uuv_optical_array.control.leader.lamps import LIT
from uuv_optical_array.control.leader.motion import CHANCE, CHANGE
from uuv_optical_array.estimation.tracking.track import Outlier


@pytest.mark.parametrize(("aside", "words"), [(1.5, "a lamp 1.5"), (8.0, "a lamp 8")])
def test_a_lamp_that_jumps_is_not_followed_while_the_leader_cannot_be_there(aside, words):
    """An equal lamp beside ours, which goes out; the leader would have to go there at once."""
    (pursuit, _), (without, _) = dark(), dark()
    pursuit.light, pursuit.aside = True, np.array([0.0, aside, 0.0])
    for _ in range(round(TIMEOUT_S / TICK_S)):
        pursuit.step()
        without.step()
        assert isinstance(pursuit.refused, Outlier)
        assert words in str(pursuit.refused)
        np.testing.assert_allclose(pursuit.twist, without.twist, atol=1e-12)


def test_an_equal_lamp_is_held_apart_to_the_end_of_the_search_and_ours_is_found_again():
    """Beside ours, which is out for 11 s; it goes along, so that the leader might be there."""
    pursuit, _ = dark()
    pursuit.light, pursuit.aside = True, np.array([0.0, 1.5, 0.0])
    for _ in range(round(11 / TICK_S)):
        pursuit.step()
        assert isinstance(pursuit.refused, Outlier)
        if pursuit.state != "locked":
            assert "not followed" in pursuit.following.state.reason
    assert pursuit.states == ["waiting", "locked", "coasting", "searching", "lost"]
    pursuit.aside = np.zeros(3)
    pursuit.until("locked").run(20)
    assert DOUBT in pursuit.following.state.reason
    assert pursuit.off_station() < 0.1


@pytest.mark.parametrize(
    ("left", "later", "found"), [(0.5, 0.5, False), (1.0, 1.0, True), (0.5, 1.02 * LIT * 0.5, True)]
)
def test_a_lamp_is_held_apart_where_one_went_out_and_until_another_is_lit(left, later, found):
    """Of the light's peak some is left as the lamp jumps; later it is another."""
    pursuit = Pursuit(search=SHORT)
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.aside = 100.0 * left, np.array([0.0, 1.5, 0.0])
    pursuit.until("coasting").run(1.0)
    pursuit.peak = 100.0 * later
    pursuit.run(SHORT.search_time_s)
    assert pursuit.states[-1] == ("locked" if found else "lost")
    if found:
        assert DOUBT in pursuit.following.state.reason


@pytest.mark.parametrize("aside", [1.5, 8.0])
def test_a_search_that_is_told_takes_whatever_lamp_it_finds(aside):
    """Also where it is told at once after a lamp went out, and where the leader cannot be."""
    pursuit = Pursuit(search=SHORT)
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.aside = 10.0, np.array([0.0, aside, 0.0])
    pursuit.until("coasting")
    pursuit.following.search(pursuit.now)
    pursuit.run(SHORT.settle_s + 0.5)
    assert pursuit.state == "locked"
    assert DOUBT in pursuit.following.state.reason


def beside(seconds=6.0, peak=10.0, turn=0.0):
    """Return a pursuit whose lamp went out `seconds` ago, 1.5 m beside another, which is dimmer.

    From then on the leader turns.
    """
    pursuit = Pursuit(search=replace(SHORT, search_time_s=30.0))
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.turn = turn
    pursuit.peak, pursuit.aside = peak, np.array([0.0, 1.5, 0.0])
    return pursuit.run(seconds)


@pytest.mark.parametrize(("after_s", "apart"), [(1.5, True), (2.5, False)])
def test_what_a_lamp_left_is_told_from_the_leader_by_where_that_is_expected(after_s, apart):
    """Poses come again so long after; hard acceleration would have taken the leader there.

    Later the track has taken it up, and it is followed once the leader may be there.
    """
    pursuit = Pursuit()
    pursuit.peak, pursuit.std_m = 100.0, 0.03
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.light, pursuit.aside = 10.0, False, np.array([0.0, 1.5, 0.0])
    pursuit.run(after_s)
    pursuit.light = True
    pursuit.run(SHORT.coast_s + SHORT.settle_s + 1.0)
    assert pursuit.state == ("searching" if apart else "locked")
    assert apart == ("another lamp" in str(pursuit.refused))


def test_light_whose_poses_are_refused_does_not_keep_a_follower_coasting():
    """It is not where the leader may be; that was wrong, and the search finds its leader."""
    pursuit = Pursuit()
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.aside = np.array([0.0, 6.0, 0.0])
    pursuit.run(2 * TIMEOUT_S)
    assert (pursuit.state, "another lamp" in str(pursuit.refused)) == ("coasting", True)
    pursuit.run(SHORT.coast_s + 2 * TIMEOUT_S)
    assert pursuit.states[-2:] == ["searching", "locked"]
    assert DOUBT in pursuit.following.state.reason


def test_a_sharp_pose_after_vague_ones_may_be_as_far_from_these_as_they_err():
    """0.8 m at a standard deviation of 0.3 m, where the leader alone does not get in a tick."""
    pursuit = Pursuit().run(LIT_S)
    pursuit.std_m, pursuit.aside = 0.3, np.array([0.0, 0.8, 0.0])
    pursuit.run(1.0)
    pursuit.std_m, pursuit.aside = STD_M, np.zeros(3)
    for _ in range(round(1 / TICK_S)):
        pursuit.step()
        assert pursuit.refused is None
    assert pursuit.state == "locked"


def test_a_lamp_that_dims_at_once_looks_farther_off_and_is_no_other():
    pursuit = Pursuit()
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.aside = 50.0, np.array([0.5, 0.0, 0.0])
    for _ in range(round(3 / TICK_S)):
        pursuit.step()
        assert pursuit.refused is None
    assert pursuit.state == "locked"


def test_while_the_track_takes_up_what_is_left_it_tells_nothing_of_the_leader():
    """It comes over to the other lamp little by little, as if the leader went there."""
    pursuit = Pursuit()
    pursuit.peak, pursuit.std_m = 100.0, 0.03
    pursuit.run(LIT_S)
    pursuit.peak = 10.0
    while pursuit.aside[1] < 1.5:
        pursuit.aside = pursuit.aside + np.array([0.0, TICK_S, 0.0])
        pursuit.step()
        if pursuit.refused:
            break
    assert "another lamp" in str(pursuit.refused)


def test_without_light_of_its_own_it_goes_on_beside_a_lamp_in_company():
    """That turns with the leader from when its light is gone."""
    pursuit = beside(0.5)
    pursuit.turn = 0.05
    alone, _ = dark()
    alone.turn = 0.05
    pursuit.until("coasting").run(2.5)
    alone.until("coasting").run(2.5)
    assert pursuit.state == alone.state == "coasting"
    assert pursuit.off_station() < alone.off_station() / 2


def test_another_lamp_is_known_again_after_a_time_in_which_nothing_was_seen():
    pursuit = beside(3.0)
    assert "another lamp" in str(pursuit.refused)
    pursuit.light, pursuit.peak = False, None
    pursuit.run(20.0)
    assert pursuit.state == "searching"
    pursuit.light, pursuit.peak = True, 10.0
    pursuit.step()
    assert "another lamp" in str(pursuit.refused)


def share_of_other(pursuit, other, sigma_rad=0.18):
    """Return the share of an equal lamp, at a place in the leader's frame, m, in the light."""
    lights = []
    for lamp in (np.zeros(3), other):
        x, y, z = pursuit.place() - lamp
        off = math.atan2(math.hypot(y, z), -x)
        lights.append(math.exp(-((off / sigma_rad) ** 2) / 2) / (x * x + y * y + z * z))
    return lights[1] / sum(lights)


@pytest.mark.parametrize("turn", [0.0, 0.06])
def test_beside_a_second_lamp_that_is_lit_it_steers_by_what_is_nearly_our_light(turn):
    """A pose is of a place between the two. A leader that turned is not where it is expected."""
    other = np.array([0.0, 1.5, 0.0])
    pursuit = beside(seconds=8.0, turn=turn)
    assert pursuit.state == "searching"
    pursuit.peak, begun = 100.0, pursuit.now
    while pursuit.state != "locked":
        share = share_of_other(pursuit, other)
        pursuit.aside = share * other
        pursuit.step()
        assert pursuit.now < begun + 10
        if pursuit.state == "coasting":
            assert "a second lamp was lit" in pursuit.following.state.reason
    assert pursuit.states[-2:] == ["coasting", "locked"]
    assert share < 0.3
    pursuit.aside = np.zeros(3)
    pursuit.run(10)
    assert pursuit.off_station() < 0.1
    assert DOUBT in pursuit.following.state.reason


def test_a_second_lamp_engages_nobody_whose_search_has_ended():
    pursuit = Pursuit(search=replace(SHORT, search_time_s=2.0, when_lost="disengage"))
    pursuit.peak = 100.0
    pursuit.run(LIT_S)
    pursuit.peak, pursuit.aside = 10.0, np.array([0.0, 1.5, 0.0])
    pursuit.until("disengaged")
    pursuit.peak = 100.0
    assert pursuit.run(1.0).state == "disengaged"


def test_a_leader_that_backs_up_hard_in_the_light_is_followed_all_the_way():
    """Brakes from 0.5 m/s and goes astern at 1 m/s within a second: no jump, and no other lamp."""
    pursuit = Pursuit().run(LIT_S)
    farthest = 0.0
    for tick in range(round(12 / TICK_S)):
        pursuit.speed = np.array([max(0.5 - 1.5 * tick * TICK_S, -1.0), 0.0, 0.0])
        pursuit.step()
        farthest = max(farthest, pursuit.off_station())
        assert pursuit.refused is None
        assert pursuit.state == "locked"
    assert farthest < 1.5  # of 4.5 m
    assert pursuit.off_station() < 0.2


@pytest.mark.parametrize(("share", "taken"), [(0.5, True), (2.5, False)])
def test_a_lamp_where_the_leader_cannot_be_by_now_is_another_one(share, taken):
    """Aside of a leader that goes straight on, and may have turned or sped up since."""
    pursuit, last_s = dark()
    pursuit.run(3.0)
    assert pursuit.state == "coasting"
    since = pursuit.now - last_s
    may_be_off = CHANGE[1] ** 2 * since**3 / 3
    aside = share * math.sqrt(chdtri(3, CHANCE) * may_be_off)
    pursuit.light, pursuit.aside = True, np.array([0.0, aside, 0.0])
    pursuit.step()
    assert taken == (pursuit.refused is None)
    if not taken:
        assert isinstance(pursuit.refused, Outlier)
        assert "another lamp" in str(pursuit.refused)


@pytest.mark.parametrize(("share", "doubted"), [(0.8, False), (0.6, True)])
def test_light_that_falls_at_once_may_be_that_of_another_lamp_also_where_it_goes_on(share, doubted):
    pursuit = Pursuit()
    pursuit.peak = 200.0
    pursuit.run(LIT_S)
    since_s = pursuit.following.state.since_s
    pursuit.peak *= share
    pursuit.run(1.0)
    assert pursuit.state == "locked"
    assert pursuit.following.state.since_s == since_s
    assert doubted == ("it may be another lamp" in pursuit.following.state.reason)
