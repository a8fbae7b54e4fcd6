"""How deep and how high a follower goes without light: within one limit, in all states."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pursuit import LIT_S, OPEN, TICK_S, Pursuit

from uuv_optical_array.control.darkness import SearchSettings
from uuv_optical_array.control.following import SURFACE_M_PER_S
from uuv_optical_array.control.leader.motion import Glow

UP = [0.0, 0.0, 1.0]


class Upright(Pursuit):
    """A pursuit whose follower measures its motion, and where up is."""

    def step(self):
        linear, turn = self.twist[:3], [0.0, *self.twist[3:]]
        self.following.moved(self.now, linear, turn, self.to_world().inv().apply(UP))
        super().step()


@given(
    st.tuples(st.floats(0.0, 1.2), st.floats(-0.2, 0.2), st.floats(-0.5, 0.5)),
    st.floats(-0.2, 0.2),
    st.floats(-0.6, 0.6),
    st.floats(0.0, 6.0),
    st.floats(2.0, 30.0),
    st.sampled_from(["hold", "surface"]),
    st.booleans(),
    st.sampled_from([0.0, -1.0, 1.0]),
)
@example((0.5, 0.0, 0.4), 0.0, 0.0, 1.0, 20.0, "hold", False, 0.0)
@example((1.2, 0.0, 0.0), 0.1, -0.6, 1.0, 20.0, "hold", True, 0.0)
@example((1.2, 0.0, 0.0), 0.0, 0.3, 0.0, 20.0, "surface", False, 0.0)
@example((1.2, 0.0, 0.0), 0.0, -0.3, 1.0, 20.0, "surface", True, 0.0)
@example((0.5, 0.0, 0.0), 0.0, 0.0, 1.0, 2.0, "hold", False, 1.0)
@example((0.5, 0.0, 0.0), 0.0, 0.1, 1.0, 2.0, "hold", True, -1.0)
@settings(max_examples=2)
def test_without_light_it_leaves_no_depth_whatever_its_leader_did(
    speed, turn, bow, depth_m, coast_s, when_lost, measured, up
):
    """Where up is not measured the leader is level at first.

    Beyond what it went until it knew of the darkness, and the bow turns within one command.

    Light without a pose may seem to be far up or down.

    On the way up that follows a search in vain only the lower depth counts.
    """
    limits = {"search_depth_m": depth_m, "search_time_s": 25.0}
    search = SearchSettings(coast_s=coast_s, when_lost=when_lost, **limits)
    pursuit = (Upright if measured else Pursuit)(speed, turn, search=search)
    for share in np.linspace(float(measured), 1, round(4 / TICK_S)):
        pursuit.bow = bow * share
        pursuit.step()
    pursuit.run(LIT_S)
    pursuit.light, went = False, pursuit.own[2]
    sinks = TICK_S * OPEN.max_surge_m_per_s * OPEN.blind_s  # m, by a pitch rate of 1 rad/s
    lit_m = turns = 0.0
    while pursuit.now < 46.0:
        if up:
            pursuit.following.glimmered(pursuit.now, Glow(0.0, up, 0.01))
        pursuit.step()
        off_m = pursuit.own[2] - went
        if pursuit.state == "locked":
            lit_m = max(lit_m, abs(off_m) + TICK_S * OPEN.max_surge_m_per_s)
        turns = max(turns, abs(pursuit.twist[3]))
        most_m = max(lit_m, depth_m + sinks * turns)
        assert off_m > -most_m
        assert off_m < most_m or (pursuit.state == "lost" and when_lost == "surface")
    assert pursuit.state == "lost"


@pytest.mark.parametrize("kind", [Upright, Pursuit])
def test_a_bow_that_was_down_from_the_start_leads_no_deeper_where_up_is_measured(kind):
    search = SearchSettings(coast_s=10.0, search_depth_m=1.0, search_time_s=12.0)
    pursuit = kind((1.0, 0.0, 0.0), search=search)
    pursuit.bow = 0.3
    pursuit.attitude[0], pursuit.own = pursuit.bow, pursuit.to_leader().inv().apply(pursuit.own)
    pursuit.run(LIT_S)
    pursuit.light, went = False, pursuit.own[2]
    pursuit.run(9.0)
    assert pursuit.state == "coasting"
    sunk_m = went - pursuit.own[2]
    if kind is Upright:
        assert sunk_m == pytest.approx(1.0, abs=0.15)
    else:  # as far as the leader's frame has it level
        assert sunk_m > 2.0


@pytest.mark.parametrize("kind", [Upright, Pursuit])
def test_it_surfaces_the_way_that_is_measured(kind):
    search = SearchSettings(coast_s=2.0, search_time_s=5.0, when_lost="surface")
    pursuit = kind((0.0, 0.0, 0.0), search=search)
    pursuit.bow = pursuit.attitude[0] = 0.3
    pursuit.own = pursuit.to_leader().inv().apply(pursuit.own)
    pursuit.run(LIT_S)
    pursuit.light = False
    pursuit.until("lost").run(10.0)
    before = pursuit.own.copy()
    pursuit.run(4.0)
    way = (pursuit.own - before) / 4.0
    tilt = 0.0 if kind is Upright else pursuit.bow
    up = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    assert way == pytest.approx(SURFACE_M_PER_S * up, abs=0.003)
