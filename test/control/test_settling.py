"""When light that comes back, or that of the start, is believed and steers."""

import numpy as np
import pytest
from pursuit import OPEN, SHORT, STD_M, TICK_S, Pursuit, dark

from uuv_optical_array.control.following import Following


def test_no_pose_steers_before_those_of_the_start_have_settled():
    pursuit = Pursuit()
    while pursuit.state == "waiting":
        pursuit.step()
    assert pursuit.following.state.since_s == pytest.approx(SHORT.settle_s, abs=1e-9)
    assert pursuit.now < SHORT.settle_s + 2 * TICK_S
    # Until then it was left alone.
    assert not pursuit.own[1:].any()
    assert pursuit.own[0] - OPEN.station_m[0] <= OPEN.max_acceleration_m_per_s2 * TICK_S**2


def test_light_where_the_leader_is_sure_to_be_steers_at_once():
    pursuit, _ = dark()
    pursuit.until("coasting").run(1.0)
    pursuit.light, first_s = True, pursuit.now
    pursuit.until("locked")
    assert pursuit.following.state.since_s == pytest.approx(first_s, abs=1e-9)


@pytest.mark.parametrize("name", ["searching", "lost"])
def test_light_that_came_back_steers_once_it_has_settled(name):
    pursuit, _ = dark()
    pursuit.until(name)
    pursuit.speed = np.zeros(3)  # where the follower sees it, not where it was expected
    pursuit.leader = pursuit.own - OPEN.station_m
    pursuit.heading = float(pursuit.attitude[1])
    pursuit.light, first_s = True, pursuit.now
    pursuit.until("locked")
    assert pursuit.following.state.since_s == pytest.approx(first_s + SHORT.settle_s, abs=1e-9)
    assert "light came back after" in pursuit.following.state.reason
    pursuit.run(20)
    assert pursuit.off_station() < 0.05


@pytest.mark.parametrize(("period", "settles"), [(2, True), (3, False)])
def test_poses_of_fewer_than_half_of_the_images_do_not_settle(period, settles):
    """Every other image, or every third: the first and the last of them are poses."""
    pursuit = Pursuit()
    while pursuit.now < 10.0:
        pursuit.light = pursuit.tick % period == 0
        pursuit.step()
    assert (pursuit.state == "locked") == settles


@pytest.mark.parametrize(("refused", "settles"), [(0, True), (2, False)])
def test_images_that_a_busy_estimator_leaves_out_are_not_refused(refused, settles):
    """It takes the newest image, for three ticks, and refuses some between two poses."""
    follower, taken_s, left = Following(OPEN, SHORT), -1.0, 0
    for tick in range(150):
        follower.looked(tick * TICK_S)
        if tick % 3 == 0:
            if taken_s >= 0 and left == 0:
                pose = [*OPEN.station_m, 0, 0]
                follower.update(taken_s, pose, STD_M**2 * np.eye(5), np.zeros(5))
            left = refused if left == 0 else left - 1
            taken_s = tick * TICK_S
        follower.command(tick * TICK_S)
    assert (follower.state.name == "locked") == settles


def test_light_in_glimpses_farther_apart_than_the_timeout_never_settles():
    pursuit, _ = dark()
    pursuit.until("searching")
    pursuit.leader, pursuit.speed = pursuit.own - OPEN.station_m, np.zeros(3)
    while pursuit.state == "searching":
        pursuit.light = pursuit.tick % 7 == 0  # each 1.4 s
        pursuit.step()
    assert pursuit.state == "lost"


def test_strays_of_which_no_two_agree_never_steer():
    pursuit, _ = dark()
    rng = np.random.default_rng(4)
    pursuit.light = True
    for k in range(round((SHORT.search_time_s + 5.0) / TICK_S)):
        pursuit.aside = np.array([9.0, (-1) ** k * rng.uniform(7.5, 15), 0.0])
        pursuit.step()
    assert pursuit.states == ["waiting", "locked", "coasting", "searching", "lost"]
