"""Water of the demonstration's sea, against the equations that waves on deep water obey."""

from typing import get_args, get_type_hints

import numpy as np
import pytest
from differences import differentiate
from hypothesis import given
from hypothesis import strategies as st

from uuv_optical_array.control.vehicles.sea import GRAVITY_M_PER_S2, Sea, WaveSettings

CURRENT = (0.3, -0.2, 0.0)
WAVES = WaveSettings(wave_height_m=1.2, wave_period_s=6.0, wave_direction_deg=30.0, depth_m=3.0)
places = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-40, 2.9)).map(np.array)
times = st.floats(0, 1e3)
STEP = 1e-4


@given(place=places, t_s=times)
def test_water_is_incompressible_and_does_not_turn(place, t_s):
    slopes = differentiate(lambda at: Sea(CURRENT, WAVES).velocity(at, t_s), place)
    assert np.trace(slopes) == pytest.approx(0, abs=1e-7)
    assert slopes == pytest.approx(slopes.T, abs=1e-7)


@given(place=places, t_s=times)
def test_acceleration_is_that_of_who_drifts_with_the_current(place, t_s):
    sea = Sea(CURRENT, WAVES)
    after, before = (
        sea.velocity(place + sign * STEP * sea.current, t_s + sign * STEP) for sign in (1, -1)
    )
    assert sea.acceleration(place, t_s) == pytest.approx((after - before) / (2 * STEP), abs=1e-6)


def test_the_free_surface_lets_no_water_through_and_bears_no_pressure():
    # To first order in the height: w = d eta / dt, and the pressure under the surface is
    # rho g eta, so the water is pushed down its slope: a = -g grad eta.
    sea, period, length = Sea(waves=WAVES), 6.0, GRAVITY_M_PER_S2 * 6.0**2 / (2 * np.pi)
    along, surface = np.array([np.sqrt(3) / 2, 0.5, 0.0]), np.array([0.0, 0.0, 3.0])
    for way in np.linspace(0, 2 * length, 9):
        for t_s in np.linspace(0, 2 * period, 9):
            phase = 2 * np.pi * (way / length - t_s / period)
            place = surface + way * along
            rise = 0.6 * 2 * np.pi / period * np.sin(phase)
            slope = -0.6 * 2 * np.pi / length * np.sin(phase)
            assert sea.velocity(place, t_s)[2] == pytest.approx(rise, abs=1e-9)
            pushed = -GRAVITY_M_PER_S2 * slope * along
            assert sea.acceleration(place, t_s)[:2] == pytest.approx(pushed[:2], abs=1e-9)


def test_an_orbit_shrinks_by_exp_2_pi_a_wave_length_down():
    sea, length = Sea(CURRENT, WAVES), GRAVITY_M_PER_S2 * 6.0**2 / (2 * np.pi)
    top, bottom = (
        np.linalg.norm(sea.velocity(np.array([0.0, 0.0, 3.0 - depth]), 1.0) - CURRENT)
        for depth in (0.0, length)
    )
    assert top == pytest.approx(np.pi * 1.2 / 6.0)
    assert bottom == pytest.approx(top * np.exp(-2 * np.pi))


def test_above_the_still_surface_the_water_moves_as_at_it():
    sea = Sea(CURRENT, WAVES)
    assert sea.velocity(np.array([1.0, 2.0, 9.0]), 4.0) == pytest.approx(
        sea.velocity(np.array([1.0, 2.0, 3.0]), 4.0)
    )


def test_within_their_bounds_waves_do_not_break():
    hints = get_type_hints(WaveSettings, include_extras=True)
    highest, shortest = (get_args(hints[name])[1] for name in ("wave_height_m", "wave_period_s"))
    assert highest.high / (GRAVITY_M_PER_S2 * shortest.low**2 / (2 * np.pi)) < 0.142
