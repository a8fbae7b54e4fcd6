"""Water and electronics: each effect alone, and that a scene runs what it names and no more."""

from typing import Annotated

import numpy as np
import pytest
from effect_settings import middle_settings
from hypothesis import given
from hypothesis import strategies as st
from scenes import make_scene
from scipy import ndimage, signal, stats

from uuv_optical_array.core.numerics.elementwise import sandwich
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward import effects
from uuv_optical_array.forward.array import ArraySettings, build_array
from uuv_optical_array.forward.effects import EFFECTS, Effect
from uuv_optical_array.forward.effects.forms import Noise
from uuv_optical_array.forward.model import ForwardModel

ARRAY = build_array(ArraySettings("planar", 5))
AHEAD = [-5.0, 0.1, -0.1, 0.05, 0.1]

NOISES = ("sensor_noise", "shot_noise", "photodiode")


def make_model(**chosen):
    return ForwardModel(make_scene(effects=chosen))


def refusal(chosen):
    with pytest.raises(ValueError, match="effects") as caught:
        effects.check_effects(chosen)
    return str(caught.value)


@pytest.mark.parametrize("side", [2, 5, 21, 40])
def test_the_window_of_the_paper_is_scipys_hann_of_11_samples_mirrored_at_the_border(side):
    window = signal.windows.hann(11) / signal.windows.hann(11).sum()
    images = np.random.default_rng(5).uniform(0, 1000, (3, side, side))
    expected = images
    for axis in (1, 2):
        expected = ndimage.convolve1d(expected, window, axis=axis, mode="reflect")
    array = build_array(ArraySettings("planar", side, 0.02 * (side - 1)))
    found = images.reshape(3, side**2).copy()
    sandwich(effects.water.forward_scatter(array, window_m=0.2).matrix, found)
    np.testing.assert_allclose(found.reshape(images.shape), expected, rtol=1e-12)


def test_sensor_noise_has_the_stated_mean_and_variance():
    sigma, number = 3.0, 4000
    model = make_model(sensor_noise={"sigma_counts": sigma})
    poses = np.broadcast_to(AHEAD, (number, 5))
    readings = model.expose(poses, np.random.default_rng(6))
    noise = (readings - model.expected(AHEAD)).ravel()
    n = noise.size
    assert abs(noise.mean()) < stats.norm.isf(1e-6) * sigma / np.sqrt(n)
    low, high = stats.chi2.ppf([1e-6, 1 - 1e-6], n - 1)
    assert low < (n - 1) * noise.var(ddof=1) / sigma**2 < high
    assert stats.kstest(noise / sigma, "norm").pvalue > 1e-4
    correlation = np.corrcoef((readings - model.expected(AHEAD)).reshape(number, -1).T)
    assert np.abs(correlation - np.eye(25)).max() < 6 / np.sqrt(number), "detectors independent"


def test_a_new_effect_is_one_function_and_one_scene_key_and_noise_variances_add(monkeypatch):
    def mains_hum(
        array, *, per_count: Annotated[float, Quantity("variance a count", "counts", 0, 10)]
    ):
        return Noise(0.0, per_count)

    monkeypatch.setitem(EFFECTS, "mains_hum", Effect(mains_hum))
    model = make_model(sensor_noise={"sigma_counts": 2.0}, mains_hum={"per_count": 0.5})
    light = model.light(AHEAD)
    variance, slope = model.variance(light)
    np.testing.assert_allclose(variance, 2.0**2 + 0.5 * light, rtol=1e-14)
    np.testing.assert_array_equal(slope, np.full(light.shape, 0.5))
    number = 20_000
    readings = model.expose(np.broadcast_to(AHEAD, (number, 5)), np.random.default_rng(7))
    low, high = stats.chi2.ppf([1e-7, 1 - 1e-7], number - 1) / (number - 1)
    ratio = readings.var(axis=0, ddof=1) / (4 + 0.5 * light)
    assert low < ratio.min()
    assert ratio.max() < high
    assert "did you mean mains_hum?" in refusal({"mains_hun": {}})
    assert "per_count" in refusal({"mains_hum": {"per_count": 11}})
    monkeypatch.undo()
    assert "mains_hum: unknown key" in refusal({"mains_hum": {"per_count": 0.5}})


def test_a_scene_without_noise_draws_no_random_number_and_needs_no_generator():
    quiet = {name: middle_settings(name) for name in EFFECTS if name not in {*NOISES, "sea"}}
    quiet["ambient"] = {"level_counts": 100.0}  # which does not saturate by itself
    model = make_model(**quiet)
    rng = np.random.default_rng(8)
    before = rng.bit_generator.state
    with_generator = model.expose(AHEAD, rng)
    assert rng.bit_generator.state == before
    np.testing.assert_array_equal(model.expose(AHEAD), with_generator)
    # What is left is the rounding, uniform within a count.
    np.testing.assert_array_equal(model.variance(model.light(AHEAD))[0], np.full((5, 5), 1 / 12))


def test_a_scene_with_noise_asks_for_its_generator():
    with pytest.raises(ValueError, match="rng: missing; this scene has noise"):
        make_model(sensor_noise={"sigma_counts": 1.0}).expose(AHEAD)


@given(names=st.lists(st.sampled_from(list(EFFECTS)), unique=True))
def test_the_named_effects_are_planned_in_physical_order_whatever_that_in_the_scene(names):
    checked = effects.check_effects({name: middle_settings(name) for name in names})
    assert list(checked) == [name for name in EFFECTS if name in names]
    forms = effects.plan(checked, ARRAY)
    alone = [effects.plan({name: values}, ARRAY) for name, values in checked.items()]
    assert [type(form) for form in forms] == [type(form) for forms in alone for form in forms]


def test_no_effects_at_all_is_the_bare_light():
    for nothing in (None, {}):
        assert effects.check_effects(nothing) == {}
    model = make_model()
    np.testing.assert_array_equal(model.expose(AHEAD), model.light(AHEAD))
