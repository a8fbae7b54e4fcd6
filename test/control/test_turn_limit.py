"""How far a search turns: within its limit, and back by the way that it came."""

import math
from copy import copy

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pursuit import LIT_S, OPEN, Pursuit

from uuv_optical_array.control.darkness import Darkness, SearchSettings, Seen
from uuv_optical_array.control.leader.motion import Glow, LeaderMotion
from uuv_optical_array.core.geometry import YAW

OVER_RAD = math.radians(2.0)  # by which a turn that slows down passes its goal
GLOW_S = 22.0  # until when there is light without a pose


@given(
    st.floats(5.0, 180.0),
    st.tuples(st.floats(0.0, 1.2), st.floats(-0.3, 0.3), st.just(0.0)),
    st.floats(-0.3, 0.3),
    st.sampled_from([None, -1.0, 1.0]),
)
@example(30.0, (0.5, 0.0, 0.0), 0.0, None)
@example(170.0, (0.5, 0.0, 0.0), 0.0, 1.0)
@settings(max_examples=1, deadline=None)
def test_a_search_turns_no_farther_than_its_limit(limit_deg, speed, turn, to_port):
    """From the heading in the last light; light at the edge of the image leads it on meanwhile."""
    search = SearchSettings(coast_s=1.0, search_time_s=52.0, search_turn_deg=limit_deg)
    pursuit = Pursuit(speed, turn, search=search).run(LIT_S)
    pursuit.light, began = False, pursuit.attitude[1]
    pursuit.until("searching")
    most = max(math.radians(limit_deg), abs(pursuit.attitude[1] - began)) + OVER_RAD
    pursuit.images = False
    while pursuit.state == "searching":
        shows = to_port is not None and pursuit.now < GLOW_S
        pursuit.following.looked(pursuit.now, Glow(to_port, 0.0, 50.0) if shows else None)
        pursuit.step()
        assert abs(pursuit.attitude[1] - began) < most
    assert pursuit.state == "lost"


@pytest.mark.parametrize("side", [-1, 1])
def test_what_is_behind_on_the_other_side_is_reached_by_turning_back(side):
    """A follower to port of its leader turned to port, away from it: the shorter way is astern."""
    pose = np.array([-4.0, side * 3.0, 0.0, 0.0, 0.0])
    motion = LeaderMotion(0.0, pose, 1e-4 * np.eye(5))
    seen = Seen(motion, copy(motion), 1e-4 * np.eye(5), 0.1, None)
    dark = Darkness(OPEN, SearchSettings(search_turn_deg=180.0), 0.0, seen)
    turned, step_s = math.radians(170.0), 0.1
    for k in range(1, 31):
        dark.advance(k * step_s, np.array([0, 0, 0, 0, side * turned / (30 * step_s)]))
    dark.begin_search(0.0)
    left = dark.search(3.0).error[YAW]
    assert side * left == pytest.approx(-turned - math.atan2(3.0, 4.0), abs=0.3)
