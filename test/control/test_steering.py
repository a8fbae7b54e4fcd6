"""By which velocity a follower goes to a goal that is farther than its limits reach at once."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.darkness import Darkness, SearchSettings
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.steering import Aim, Steering

SETTINGS = FormationSettings((-6.0, 0.0, 0.0))
MOST = np.array([SETTINGS.max_surge_m_per_s, *[SETTINGS.max_sway_m_per_s] * 2])
STEP_S = 0.1


def steady(aim):
    """Return the velocity to which the commands towards a goal settle, ``(3,)``."""
    steering, rate = Steering(SETTINGS), np.zeros(5)
    for _ in range(100):
        rate = steering.rate(aim(), rate, STEP_S)
    return rate[:3]


metres = st.floats(-40.0, 40.0)


@given(st.tuples(metres, metres, metres), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0))
@settings(max_examples=40)
def test_a_straight_way_is_as_fast_as_the_axis_that_limits_it(way, pitch, yaw):
    assume(np.linalg.norm(way) > 1e-3)
    to_body = Rotation.from_euler("ZY", [yaw, pitch]).as_matrix().T
    error = np.array([*way, 0.0, 0.0])
    rate = steady(lambda: Aim(error, np.zeros(5), to_body, [], straight=True))
    wanted = SETTINGS.position_gain_per_s * to_body @ way
    assert np.cross(rate, wanted) == pytest.approx(np.zeros(3), abs=1e-6)
    assert rate @ wanted > 0
    reached = np.max(np.abs(rate) / MOST)
    asked = np.max(np.abs(wanted) / MOST)
    assert reached == pytest.approx(min(asked, 1.0), abs=1e-6)


def test_else_each_axis_is_as_fast_as_it_may():
    error = np.array([20.0, -20.0, 1.0, 0.0, 0.0])
    rate = steady(lambda: Aim(error, np.zeros(5), np.eye(3), []))
    assert rate == pytest.approx([MOST[0], -MOST[1], SETTINGS.position_gain_per_s])


@pytest.mark.parametrize("pitch", [0.3, -0.3])
def test_a_search_goes_a_level_way_with_the_bow_up_or_down(pitch):
    dark = Darkness(SETTINGS, SearchSettings(), 0.0)
    dark.advance(1.0, np.array([0.0, 0.0, 0.0, pitch, 0.0]))
    lamp = np.array([30.0, 0.0, 0.0])
    dark.glimpse(np.concatenate([dark.own[:3] - lamp, dark.own[3:]]), 1e-3 * np.eye(5))
    velocity = steady(lambda: dark.search(1.0))
    ahead, _, up = Rotation.from_euler("y", dark.own[3]).apply(velocity)
    assert ahead > 1.0
    assert abs(up) < 0.01 * ahead
