"""What a follower does as its leader's light goes and comes back, by exact poses and no images."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pursuit import LIT_S, OPEN, SHORT, TICK_S, TIMEOUT_S, Pursuit, dark
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.darkness import POSED_S, STEADY_RAD, Darkness, SearchSettings, Seen
from uuv_optical_array.control.following import IMAGES_S, MEASURED_S, SURFACE_M_PER_S
from uuv_optical_array.control.formation import RANGE_STDS
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.motion import Glow, LeaderMotion


def test_the_states_come_in_order_each_at_its_time():
    pursuit, last_s = dark()
    begun = [pursuit.now]
    for name in ("coasting", "searching", "lost"):
        pursuit.until(name)
        begun.append(pursuit.following.state.since_s)
        assert pursuit.following.state.reason
    at = last_s + np.array([TIMEOUT_S, SHORT.coast_s, SHORT.search_time_s])
    late = begun[1:] - at
    assert (late > -1e-9).all()
    assert (late < 1.5 * TICK_S).all()
    assert pursuit.states == ["waiting", "locked", "coasting", "searching", "lost"]
    assert pursuit.run(30).state == "lost"


@pytest.mark.parametrize("speed", [(0.5, 0.0, 0.0), (0.9, 0.1, -0.1), (0.0, 0.0, 0.0)])
def test_while_it_coasts_it_keeps_the_station_of_a_leader_that_goes_straight_on(speed):
    pursuit, _ = dark(speed=speed, lit_s=5.0, search=replace(SHORT, coast_s=20.0))
    pursuit.run(TIMEOUT_S + TICK_S)
    before, since = pursuit.off_station(), pursuit.now
    while pursuit.now < 20:
        pursuit.step()
        # What it was off decays by the gain, once the command has settled.
        decays = math.exp(-OPEN.position_gain_per_s * max(pursuit.now - since - 2.0, 0.0))
        assert pursuit.off_station() < before * decays + 0.01
    assert pursuit.state == "coasting"
    assert np.abs(pursuit.twist[:3] - speed).max() < 0.01


def test_a_follower_that_has_lost_its_leader_holds_where_the_search_ended():
    pursuit, _ = dark()
    pursuit.until("lost")
    ended, way = pursuit.own.copy(), TICK_S * np.linalg.norm(pursuit.twist[:3])
    pursuit.run(30)
    assert pursuit.own == pytest.approx(ended, abs=way + 0.05)  # a tick before it was told
    assert np.abs(pursuit.twist[:3]).max() < 0.01


def test_when_lost_it_surfaces_where_it_is_told_to():
    pursuit, _ = dark(search=replace(SHORT, when_lost="surface"))
    pursuit.until("lost")
    ended, way = pursuit.own.copy(), TICK_S * np.linalg.norm(pursuit.twist[:3])
    pursuit.run(20)
    before = pursuit.own.copy()
    pursuit.run(10)
    assert pursuit.own[:2] == pytest.approx(ended[:2], abs=way + 0.05)
    assert pursuit.own[2] - before[2] == pytest.approx(10 * SURFACE_M_PER_S, rel=0.02)


def test_when_lost_it_disengages_where_it_is_told_to():
    pursuit, _ = dark(search=replace(SHORT, when_lost="disengage"))
    pursuit.until("disengaged")
    assert not pursuit.twist.any()
    pursuit.step()
    assert pursuit.commanded is None


@given(
    st.tuples(st.floats(0.0, 1.2), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
    st.floats(-0.12, 0.12),
    st.floats(-6.0, -3.0),
    st.sampled_from([None, Glow(0.0, 0.0, 0.01), Glow(1.0, 0.5, 0.01)]),
)
@example((0.5, 0.0, 0.0), 0.0, -3.0, None)
@example((0.0, 0.0, 0.0), 0.0, -3.0, Glow(0.0, 0.0, 0.01))
@example((1.0, 0.0, 0.0), 0.0, -3.0, None)
@example((1.2, 0.0, 0.0), 0.0, -3.0, Glow(-1.0, -1.0, 0.01))
@settings(max_examples=3)
def test_in_the_dark_it_keeps_off_where_the_lamp_was_and_within_the_limits(speed, turn, x, glow):
    """Also while it goes to light that no single image shows."""
    formation = FormationSettings((x, 0.0, 0.0), min_distance_m=2.0)
    search = SearchSettings(search_distance_m=15.0, search_time_s=35.0)
    pursuit = Pursuit(speed, turn, formation, search, (-1.0, 0.0, 0.0))
    pursuit.std_m = 0.1
    pursuit.run(LIT_S)
    lamp, pursuit.light = pursuit.leader - halfway_back(pursuit), False
    pursuit.run(TIMEOUT_S)
    start = pursuit.own.copy()
    least_m = formation.min_distance_m + RANGE_STDS * pursuit.std_m
    rest_m = formation.max_surge_m_per_s**2 / (2 * formation.max_acceleration_m_per_s2)
    rest_m += formation.max_surge_m_per_s * formation.smoothing_s
    for _ in range(round(38 / TICK_S)):
        if glow is not None:
            pursuit.following.glimmered(pursuit.now, glow)
        pursuit.step()
        assert np.linalg.norm(pursuit.own - lamp) > least_m - 0.05
        assert np.linalg.norm(pursuit.own - start) < search.search_distance_m + rest_m
    assert pursuit.state == "lost"


def halfway_back(pursuit):
    """Return what the leader went since the last pose."""
    middle = Rotation.from_euler("z", pursuit.heading - pursuit.turn * TICK_S / 2)
    return middle.apply(pursuit.speed) * TICK_S


def test_a_follower_that_is_left_to_others_commands_nothing_until_it_is_engaged():
    pursuit, _ = dark()
    pursuit.following.engage(False, pursuit.now)
    pursuit.light = True
    for _ in range(round(3 / TICK_S)):
        pursuit.step()
        assert (pursuit.state, pursuit.commanded) == ("disengaged", None)
    pursuit.following.engage(True, pursuit.now)
    engaged_s = pursuit.now
    assert pursuit.state == "waiting"
    pursuit.until("locked")
    assert pursuit.following.state.since_s == pytest.approx(engaged_s + SHORT.settle_s, abs=1e-9)


@pytest.mark.parametrize("way", ["looked", "glimmered"])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_search_goes_to_light_without_a_pose(side, way):
    """It was a thousand times as bright at the station, so it is of a beam that passes by."""
    pursuit = Pursuit(search=SearchSettings(coast_s=8.0))
    pursuit.peak = 1.0
    pursuit.run(LIT_S)
    pursuit.light, pursuit.peak = False, None
    begun = pursuit.until("searching").own
    for _ in range(round(5 / TICK_S)):
        getattr(pursuit.following, way)(pursuit.now, Glow(float(side), 0.0, 1e-3))
        pursuit.step()
    assert side * (pursuit.own - begun)[1] > 0.5


def test_light_that_no_image_shows_changes_nothing_but_a_search():
    (pursuit, _), (twin, _) = dark(), dark()
    while twin.state != "lost":
        if twin.state == "coasting":
            pursuit.following.glimmered(pursuit.now, Glow(1.0, 0.0, 0.01))
        pursuit.step()
        twin.step()
        np.testing.assert_array_equal(pursuit.own, twin.own)


def test_light_whose_poses_are_refused_guides_no_search():
    (pursuit, _), (twin, _) = dark(), dark()
    for each in (pursuit, twin):
        each.until("searching")
        each.light, each.aside = True, np.array([0.0, 60.0, 0.0])
        each.step()
    assert "another lamp" in str(pursuit.refused)
    for _ in range(round(2 / TICK_S)):
        pursuit.following.glimmered(pursuit.now, Glow(1.0, 0.0, 0.01))
        pursuit.step()
        twin.step()
        np.testing.assert_array_equal(pursuit.own, twin.own)


@pytest.mark.parametrize("way", [-1, 1])
def test_a_bow_is_steady_where_it_points_as_the_mean_of_the_images_before(way):
    """After 10 s it turns by half a radian: of the mean that is 10 / t less, for `BEFORE_S`."""
    pose = np.array([-4.5, 0.0, 0.0, 0.0, way * 3.0])
    motion = LeaderMotion(0.0, pose, 1e-4 * np.eye(5))
    dark = Darkness(OPEN, SearchSettings(), 0.0, Seen(motion, motion, np.eye(5), 0.1, None))
    for now_s in TICK_S * np.arange(1, 20 / TICK_S):
        turns = 0.5 * way / TICK_S if now_s == 10.0 else 0.0
        dark.advance(now_s, np.array([0.0, 0.0, 0.0, 0.0, turns]))
        off = 0.5 * 10.0 / now_s if now_s >= 10.0 else 0.0
        if abs(off - STEADY_RAD) > 0.01:
            assert dark.steady == (off < STEADY_RAD)


@pytest.mark.parametrize("way", ["looked", "glimmered"])
def test_after_a_turn_only_light_that_one_image_shows_guides_a_search(way):
    (pursuit, _), (twin, _) = dark(), dark()
    for each in (pursuit, twin):
        each.until("searching")
    turned_s = pursuit.now + 1.0
    while pursuit.now < turned_s + 2.0:
        turns = 1.0 if pursuit.now < turned_s else 0.0
        for each in (pursuit, twin):
            each.following.moved(each.now, np.zeros(3), [0.0, 0.0, turns])
            each.step()
        if not turns:
            getattr(pursuit.following, way)(pursuit.now, Glow(1.0, 0.0, 0.01))
    assert (pursuit.own == twin.own).all() == (way == "glimmered")


@pytest.mark.parametrize(("to_port", "up"), [(1, 0), (-1, 0), (0, 1)])
def test_on_the_way_to_a_place_light_has_another_one_chosen(to_port, up):
    """The way led to behind a leader that goes straight on; light is of one that turned."""
    pose = np.array([-4.5, 0.0, 0.0, 0.0, 0.0])
    motion = LeaderMotion(0.0, pose, 1e-4 * np.eye(5))
    motion.speed = np.array([0.5, 0.0, 0.0])
    seen = Seen(motion, motion, 1e-4 * np.eye(5), 0.1, (4.5, 1.0))
    search = Darkness(OPEN, SearchSettings(), 0.0, seen)
    for now_s in (4.5, 9.0):
        search.advance(now_s, np.zeros(5))
    search.begin_search(0.0)
    for now_s in np.arange(9.0, 12.0, 0.1):
        search.advance(now_s, np.zeros(5))
        if now_s > 9.5:
            search.face(Glow(float(to_port), float(up), 1e-3))
        ahead, port, top = search.search(now_s).error[:3]
        if now_s < 9.5:
            assert ahead > 5.0
            assert (port, top) == pytest.approx((0.0, 0.0), abs=0.1)
    assert port * to_port + top * up > 2.0


def test_a_glimpsed_pose_says_more_than_the_brightest_place_for_a_while():
    pose = np.array([-4.5, 0.0, 0.0, 0.0, 0.0])
    motion = LeaderMotion(0.0, pose, 1e-4 * np.eye(5))
    search = Darkness(OPEN, SearchSettings(), 0.0, Seen(motion, motion, np.eye(5), 0.1, None))
    search.begin_search(0.0)

    def goal(now_s):
        search.advance(now_s, np.zeros(5))
        return search.search(now_s).error[:3]

    search.glimpse(np.array([-9.0, 3.0, 0.0, 0.0, 0.0]), 1e-4 * np.eye(5))
    for now_s, followed in ((0.0, False), (0.9 * POSED_S, False), (1.1 * POSED_S, True)):
        before = goal(now_s)
        search.face(Glow(1.0, 0.0, 1.0))
        changed = goal(now_s)
        assert (np.linalg.norm(changed - before) > 0.5) == followed


def test_a_search_ends_where_no_images_come():
    pursuit, _ = dark()
    pursuit.until("searching")
    pursuit.images, last_s = False, pursuit.now - TICK_S
    pursuit.until("lost")
    late_s = pursuit.following.state.since_s - last_s - IMAGES_S
    assert -1e-9 < late_s < 1.5 * TICK_S
    assert "no image comes" in pursuit.following.state.reason


@pytest.mark.parametrize("measured", [True, False])
def test_a_measured_velocity_takes_the_place_of_the_commands_in_the_dark(measured):
    """A follower that is held fast knows by it how far the leader has gone on."""
    pursuit, last_s = dark(speed=(0.2, 0.0, 0.0), search=replace(SHORT, coast_s=20.0))
    off = []
    while pursuit.now < last_s + 8.0:
        if measured:
            pursuit.following.moved(pursuit.now, [0, 0, 0], [0, 0, 0])
        pursuit.step()
        off.append(pursuit.twist[0])
    # The station went on at 0.2 m/s since the last pose; the command lags by its smoothing.
    gone_m = 0.2 * (8.0 - OPEN.smoothing_s) * measured
    assert off[-1] == pytest.approx(0.2 + OPEN.position_gain_per_s * gone_m, abs=0.02)
    # Once nothing is measured, its commands count again: no more is missing.
    pursuit.run(MEASURED_S + 1.0)
    later = pursuit.twist[0]
    pursuit.run(2.0)
    assert pursuit.twist[0] < later + 0.01
