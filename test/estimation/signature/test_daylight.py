"""Whether daylight alone explains an image: beside a dense Gaussian, and by images of both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import changed, ready, seen_in, seen_in_each
from scipy.stats import binom, chi2

from uuv_optical_array.estimation.signature.daylight import ODD_DAYLIGHT, Daylight
from uuv_optical_array.forward.drawn_sea import draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import power_offsets

LEVEL, STD, RISE = 40.0, 8.0, 6.0
U, V = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)))
DAYLIT = changed(
    "reference",
    effects={"sensor_noise": {"sigma_counts": 2.0}, "ambient": {"level_counts": LEVEL}},
    prior={
        "known": "exactly",
        "ambient_std_counts": STD,
        "ambient_gradient_std_counts": RISE,
        "gain_std": 0.02,
    },
)


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 2.0))
def test_it_is_the_square_of_a_gaussian_of_all_readings(seed, stretch):
    model, rng = ForwardModel(DAYLIT), np.random.default_rng(seed)
    spread = STD**2 * np.ones((25, 25)) + RISE**2 * (np.outer(U, U) + np.outer(V, V))
    off = rng.multivariate_normal(np.zeros(25), spread) + rng.normal(0, 3.0 * stretch, 25)
    image = (LEVEL + off).clip(0, 1000)
    noise = model.noise.variance + (0.02 * image.mean()) ** 2
    off = image - LEVEL
    square = off @ np.linalg.solve(noise * np.eye(25) + spread, off)
    most = chi2.isf(ODD_DAYLIGHT, 25)
    if abs(square - most) > 1e-6 * most:
        assert Daylight(model).explains(image.reshape(5, 5)) == (square < most)


@pytest.mark.parametrize(
    "name", ["follow", "coastal", "harbour", "sunlit_modulated", "leading_lights"]
)
def test_of_images_without_a_lamp_so_few_show_light_as_is_said(name):
    model, rng = ForwardModel(ready(name)), np.random.default_rng(7)
    daylight = Daylight(model)
    seas = [draw_sea(model.scene, rng) for _ in range(1000)]
    out = power_offsets([0.0], model.scene.lamp_count)
    images = seen_in_each(model, seas, [-5.0, 0, 0, 0, 0], rng, out)
    lit = sum(not daylight.explains(image) for image in images)
    assert lit <= binom.isf(1e-7, 1000, ODD_DAYLIGHT)


def test_lamps_show_where_they_are_followed_and_also_where_a_pose_tells_little():
    model, rng = ForwardModel(ready("follow")), np.random.default_rng(8)
    daylight = Daylight(model)
    for range_m in np.linspace(2, 10, 80):
        sea = draw_sea(model.scene, rng)
        pose = [-range_m, 0.1 * range_m, 0, 0, 0]
        assert not daylight.explains(seen_in(model, sea, pose, rng))
    dark = model.read(np.zeros((5, 5)), rng)
    assert daylight.explains(dark)
    dark[4, 2] = 30.0  # as from a lamp that is far aside
    assert not daylight.explains(dark)


def test_a_lamp_that_lights_a_plane_evenly_is_brighter_than_daylight_may_be():
    model = ForwardModel(ready("eren2017_tank"))
    assert not Daylight(model).explains(np.full((5, 5), 300.0))
    assert Daylight(model).explains(
        np.rint(model.light([-5, 0, 0, 0, 0], 0.0, power_offsets([0], 1)))
    )
