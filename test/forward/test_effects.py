"""Water and electronics: each effect alone, and that a scene runs what it names and no more."""

from typing import Annotated

import numpy as np
import pytest
from effect_settings import middle_settings
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage, signal, stats

from uuv_optical_array.core.numerics.elementwise import sandwich
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward import effects
from uuv_optical_array.forward.array import ArraySettings, build_array
from uuv_optical_array.forward.effects import EFFECTS, Effect
from uuv_optical_array.forward.effects.forms import Noise
from uuv_optical_array.forward.effects.water import hanning_blur
from uuv_optical_array.forward.light import LampSettings
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import scene_from_settings

ARRAY = build_array(ArraySettings("planar", 5))
AHEAD = [-5.0, 0.1, -0.1, 0.05, 0.1]

# Where the middle of the bounds would drown everything else.
TYPICAL = {
    "attenuation": {"k_per_m": 0.1},
    "lamp_flicker": {"depth": 0.1, "frequency_hz": 100.0},
    "lamp_drift": {"std": 0.05, "time_scale_s": 60.0, "seed": 4},
    "plume": {
        "depth": 1.0,
        "size_m": 0.2,
        "speed_m_per_s": 0.1,
        "distance_m": 3.0,
        "seed": 5,
    },
    "beam_spread": {"scattering_per_m": 0.2, "scattering_angle_deg": 3.0},
    "field_of_view": {"cosine_power": 2.0},
    "ambient": {"level_counts": 15.0},
    "forward_scatter": {"window_m": 0.3},
    "responsivity": {"spread": 0.05, "seed": 3},
    "detector_faults": {"dead": [[0, 1]], "stuck": [[4, 4]], "stuck_counts": 50.0},
    "sensor_noise": {"sigma_counts": 2.0},
    "shot_noise": {"electrons_per_count": 300.0},
    "photodiode": {
        "part": "SM05PD1A",
        "bandwidth_hz": 100.0,
        "load_ohm": 1e6,
        "amps_per_count": 1e-12,
    },
    "saturation": {"level_counts": 700.0},
    "adc": {"bits": 10},
}
EVERY = {name: TYPICAL.get(name) or middle_settings(name) for name in EFFECTS}
NOISES = ("sensor_noise", "shot_noise", "photodiode")
LAMP = LampSettings(8.0, 900.0, 4.0)


def make_model(**chosen):
    values = {
        "lamp": {"beam_sigma_deg": 8.0, "reference_counts": 900.0, "reference_range_m": 4.0},
        "array": {"shape": "curved", "detectors_per_side": 5, "radius_m": 0.32},
        "effects": chosen,
        "table": {key: [0, 0, 1] for key in ("x_m", "y_m", "z_m", "pitch_deg", "yaw_deg")},
    }
    return ForwardModel(scene_from_settings(values, "test"))


def refusal(chosen):
    with pytest.raises(ValueError, match="effects") as caught:
        effects.check_effects(chosen)
    return str(caught.value)


@pytest.mark.parametrize("side", [2, 5, 21, 40])
def test_the_window_of_the_paper_is_scipys_hann_of_11_samples_mirrored_at_the_border(side):
    window = signal.windows.hann(11)
    image = np.random.default_rng(4).uniform(0, 1000, (side, side))
    expected = image
    for axis in (0, 1):
        expected = ndimage.convolve1d(expected, window / window.sum(), axis=axis, mode="reflect")
    blur = hanning_blur(side, 0.02, 0.2)
    np.testing.assert_allclose(blur @ image @ blur.T, expected, rtol=1e-12)


def test_forward_scatter_blurs_both_axes_of_a_stack_of_images():
    array = build_array(ArraySettings("planar", 21))
    window = signal.windows.hann(11) / signal.windows.hann(11).sum()
    images = np.random.default_rng(5).uniform(0, 1000, (3, 21, 21))
    expected = images
    for axis in (1, 2):
        expected = ndimage.convolve1d(expected, window, axis=axis, mode="reflect")
    found = images.reshape(3, 441).copy()
    sandwich(effects.water.forward_scatter(array, window_m=0.2).matrix, found)
    np.testing.assert_allclose(found.reshape(3, 21, 21), expected, rtol=1e-12)


@given(side=st.integers(2, 40), spacing=st.floats(0.01, 1), window=st.floats(0.001, 10))
def test_every_row_of_the_blur_sums_to_one_and_its_columns_too(side, spacing, window):
    blur = hanning_blur(side, spacing, window)
    assert (blur >= 0).all()
    np.testing.assert_allclose(blur.sum(axis=1), 1, rtol=1e-12)
    # Mirrored borders keep all light on the array.
    np.testing.assert_allclose(blur.sum(axis=0), 1, rtol=1e-12)


@given(side=st.integers(2, 40), spacing=st.floats(0.01, 1), share=st.floats(0.001, 1))
def test_a_window_no_wider_than_two_spacings_changes_nothing(side, spacing, share):
    blur = hanning_blur(side, spacing, 2 * spacing * share)
    np.testing.assert_array_equal(blur, np.eye(side))


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


def test_saturation_clips_at_its_level_and_leaves_the_rest():
    step = make_model(saturation={"level_counts": 700.0}).converted
    readings = np.array([-3.2, 0.0, 699.999, 700.0, 700.001, 1e9])
    np.testing.assert_array_equal(step(readings), [-3.2, 0.0, 699.999, 700.0, 700.0, 700.0])


@given(bits=st.integers(1, 16))
def test_the_converter_reads_whole_counts_from_zero_to_its_last_code(bits):
    step = make_model(adc={"bits": bits}).converted
    last = sum(2**bit for bit in range(bits))
    readings = np.random.default_rng(bits).uniform(-2, last + 3, 500)
    expected = [min(max(int(np.floor(value + 0.5)), 0), last) for value in readings]
    np.testing.assert_array_equal(step(readings), expected)
    np.testing.assert_array_equal(step(np.array([-0.51, last + 0.51])), [0, last])


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
    quiet = {name: EVERY[name] for name in EVERY if name not in NOISES}
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


@given(names=st.lists(st.sampled_from(list(EVERY)), unique=True))
def test_the_named_effects_are_planned_in_physical_order_whatever_that_in_the_scene(names):
    checked = effects.check_effects({name: EVERY[name] for name in names})
    assert list(checked) == [name for name in EFFECTS if name in names]
    forms = effects.plan(checked, ARRAY, LAMP)
    alone = [effects.plan({name: values}, ARRAY, LAMP) for name, values in checked.items()]
    assert [type(form) for form in forms] == [type(form) for forms in alone for form in forms]


def test_no_effects_at_all_is_the_bare_light():
    for nothing in (None, {}):
        assert effects.check_effects(nothing) == {}
    model = make_model()
    np.testing.assert_array_equal(model.expose(AHEAD), model.light(AHEAD))


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ({"attenuatoin": {"k_per_m": 0.1}}, ["effects.attenuatoin", "did you mean attenuation?"]),
        ({"fog": {}}, ["effects.fog: unknown key", "attenuation, lamp_flicker, lamp_drift, plume"]),
        ({"adc": {"bit": 10}}, ["effects.adc.bit", "did you mean bits?"]),
        ({"adc": None}, ["effects.adc: empty; give its settings, or {} for defaults"]),
        ({"adc": {"bits": 10.0}}, ["effects.adc.bits: 10.0 is not a whole number", "1 to 16"]),
        ({"adc": {"bits": 17}}, ["effects.adc.bits: 17 is out of bounds", "from 1 to 16"]),
        ({"attenuation": {"k_per_m": "0.1/m"}}, ["k_per_m: '0.1/m' is not a number", "unit"]),
        ({"forward_scatter": {"window_m": 0}}, ["window_m: 0 is out of bounds", "0.001 to 10 m"]),
        ({"saturation": {"level_counts": float("nan")}}, ["level_counts: nan is out of bounds"]),
        (["adc"], ["effects: ['adc'] is not a mapping"]),
    ],
)
def test_a_wrong_effect_is_refused_by_its_dotted_name(chosen, words):
    message = refusal(chosen)
    for word in words:
        assert word in message
