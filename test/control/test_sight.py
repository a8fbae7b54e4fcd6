"""How bright a lamp would be: closed forms, and images of the demonstration's scene."""

import math

import numpy as np
import pytest

from uuv_optical_array.control.leader.sight import NEAREST_M, WATER, SightSettings

SIGHT = SightSettings(sight_m=15.0, sight_deg=20.0)


def one(off):
    """Return the light at a place in a lamp's axes, m."""
    return float(SIGHT.light(np.array(off, dtype=float), np.zeros((1, 3)), np.zeros((1, 2)))[0])


def test_the_least_that_is_seen_is_at_the_end_of_the_sight_and_at_half_of_it_at_the_edge():
    assert one([-15.0, 0, 0]) == pytest.approx(0.0, abs=1e-12)
    edge = math.radians(20.0)
    for side in ([0, 1.0, 0], [0, 0, -1.0]):
        off = -math.cos(edge) * np.array([1.0, 0, 0]) + math.sin(edge) * np.array(side)
        assert one(7.5 * off) == pytest.approx(0.0, abs=1e-9)


def test_light_falls_with_the_square_of_the_range_and_by_the_water():
    near, far = float(SIGHT.on_axis(3.0)), float(SIGHT.on_axis(6.0))
    assert near - far == pytest.approx(2 * math.log(2.0) + WATER * 3.0 / 15.0)
    assert float(SIGHT.on_axis(0.0)) == float(SIGHT.on_axis(NEAREST_M))


def test_behind_its_back_a_lamp_is_dark_wherever_it_heads():
    assert one([7.0, 0, 0]) < 0
    heading = np.array([[0.2, 1.1]])
    cos_p, sin_p = math.cos(0.2), math.sin(0.2)
    ahead = np.array([cos_p * math.cos(1.1), cos_p * math.sin(1.1), -sin_p])
    place = np.array([[3.0, -2.0, 1.0]])
    astern = SIGHT.light(place[0] - 5.0 * ahead, place, heading)
    assert float(astern[0]) == pytest.approx(float(SIGHT.on_axis(5.0)))
