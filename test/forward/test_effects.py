"""Effects against closed forms, published numbers and simulations, and how a scene names them."""

import math
from typing import Annotated

import numpy as np
import pytest
from effect_settings import middle_settings
from hypothesis import given
from hypothesis import strategies as st
from scenes import make_scene
from scipy import ndimage, signal, stats
from scipy.integrate import trapezoid

from uuv_optical_array.core.numerics.elementwise import sandwich
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward import effects
from uuv_optical_array.forward.array import ArraySettings, build_array
from uuv_optical_array.forward.effects import EFFECTS, Effect
from uuv_optical_array.forward.effects.forms import Noise
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scattering import scattered_light, weighed

ARRAY = build_array(ArraySettings("planar", 5))
AHEAD = [-5.0, 0.1, -0.1, 0.05, 0.1]


def make_model(chosen=None, **effects):
    return ForwardModel(make_scene(effects=chosen or effects))


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


def test_a_new_effect_is_one_function_and_one_scene_key_and_noises_add(monkeypatch):
    def mains_hum(
        array, *, per_count: Annotated[float, Quantity("variance a count", "counts", 0, 10)]
    ):
        return Noise(0.0, per_count)

    monkeypatch.setitem(EFFECTS, "mains_hum", Effect(mains_hum))
    model = make_model(sensor_noise={"sigma_counts": 2.0}, mains_hum={"per_count": 0.05})
    light = model.light(AHEAD)
    variance, slope = model.variance(light)
    np.testing.assert_allclose(variance, 2.0**2 + 0.05 * light, rtol=1e-14)
    np.testing.assert_array_equal(slope, np.full(light.shape, 0.05))
    number = 20_000
    readings = model.expose(np.broadcast_to(AHEAD, (number, 5)), np.random.default_rng(6))
    noise = ((readings - light) / np.sqrt(4 + 0.05 * light)).reshape(number, 25)
    assert abs(noise.mean()) < stats.norm.isf(1e-6) / np.sqrt(noise.size)
    low, high = stats.chi2.ppf([1e-7, 1 - 1e-7], number - 1) / (number - 1)
    assert low < noise.var(axis=0, ddof=1).min()
    assert noise.var(axis=0, ddof=1).max() < high
    assert stats.kstest(noise.ravel(), "norm").pvalue > 1e-4
    correlation = np.corrcoef(noise.T)
    assert np.abs(correlation - np.eye(25)).max() < 6 / np.sqrt(number), "detectors independent"
    assert "did you mean mains_hum?" in refusal({"mains_hun": {}})
    assert "per_count" in refusal({"mains_hum": {"per_count": 11}})
    monkeypatch.undo()
    assert "mains_hum: unknown key" in refusal({"mains_hum": {"per_count": 0.5}})


def test_a_scene_without_noise_draws_no_random_number_and_needs_no_generator():
    left_out = {"sensor_noise", "shot_noise", "photodiode", "sea", "pedestal"}
    quiet = {name: middle_settings(name) for name in EFFECTS if name not in left_out}
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


Q = 1.602176634e-19  # C: exact by definition of the SI
DIODE = {
    "part": "SM05PD1A",
    "bandwidth_hz": 1000.0,
    "load_ohm": 1e6,
    "amplifier_a_per_rthz": 2e-13,
    "temperature_c": 10.0,
    "amps_per_count": 1e-12,
}
JERLOV = {"water": "coastal_1c", "wavelength_nm": 532}
CLEAR = {"water": "eren2016_clear", "wavelength_nm": 450}


@pytest.mark.parametrize(
    ("water", "wavelength_nm", "k_per_m"),
    [  # Jerlov (1976), table XXVII, and half way between its wavelengths
        ("coastal_1c", 537.5, 0.125),
        ("eren2016_clear", 532, 0.05),
        ("eren2016_coastal", 501, 0.1),
    ],
)
def test_a_water_type_is_the_number_of_the_table(water, wavelength_nm, k_per_m):
    typed = make_model(attenuation={"water": water, "wavelength_nm": wavelength_nm})
    found = typed.scene.effects["attenuation"]
    assert list(found) == ["k_per_m"], "what reads the scene finds a number"
    assert found["k_per_m"] == pytest.approx(k_per_m, rel=1e-12)
    number = make_model(attenuation=found)
    assert number.scene.fingerprint == typed.scene.fingerprint
    np.testing.assert_array_equal(number.light(AHEAD), typed.light(AHEAD))


def test_daylight_fades_with_depth_as_jerlov_says():
    surface = {"surface_counts": 5e4, "depth_m": 12.0}
    found = effects.check_effects({"ambient": {**surface, "k_per_m": 0.2}})
    assert found == {"ambient": {"level_counts": pytest.approx(5e4 * math.exp(-2.4))}}
    by_type = effects.check_effects(
        {"ambient": {**surface, "water": "coastal_3c", "wavelength_nm": 525}}
    )
    assert by_type == found


def test_the_signals_shot_noise_is_that_of_its_electrons():
    # In a window of 1 / (2 B) the count of electrons is Poisson: sigma / mean = 1 / sqrt(N).
    current, bandwidth = 2e-12, 10.0
    electrons = np.random.default_rng(4).poisson(current / Q / (2 * bandwidth), 200_000)
    measured = electrons.std() * Q * 2 * bandwidth
    diode = {**DIODE, "bandwidth_hz": bandwidth, "amps_per_count": 1.0}
    shot = effects.electronics.photodiode(None, **diode).slope * current
    assert math.sqrt(shot) == pytest.approx(measured, rel=0.01)


def test_a_rim_halves_the_light_at_the_half_angle_and_cuts_it_off_beyond():
    form = effects.detectors.field_of_view(None, half_angle_deg=40.0, edge_deg=5.0)
    for angle, share, tolerance in ((0, 1, 1e-3), (40, 0.5, 1e-12), (50, 0, 1e-3), (60, 0, 1e-6)):
        found = form.law(5.0, math.cos(math.radians(angle)), *form.settings)[0]
        assert found == pytest.approx(share, abs=tolerance)
    # The edge is where 12 % are left, as of a hyperbolic tangent at -1.
    beyond = form.law(5.0, math.cos(math.radians(42.5)), *form.settings)[0]
    assert beyond == pytest.approx(0.5 * (1 - math.tanh(1)), abs=0.01)


@pytest.mark.parametrize("length", [2.0, 6.0])
@pytest.mark.parametrize("b", [0.037, 0.219, 1.824])
def test_scattering_spreads_the_light_and_loses_what_its_law_says(b, length):
    sigma, eta = math.radians(4), np.linspace(1e-9, math.radians(70), 20_001)
    angle = eta**2 / 2, np.cos(eta), np.sin(eta) / eta
    source = weighed(angle, sigma, b * length, 1.0, 1.0)
    to_lamp = length, 1 / length, angle, 1.0, -np.cos(eta)
    light, of_light = scattered_light(*to_lamp, 1.0, sigma, b, source)
    flux, incidence = light[0], of_light[0]
    # The normal looks back along the ray: what passes a sphere about the lamp.
    power = trapezoid(flux * incidence * eta, eta) * length**2
    kept = math.exp(-0.0562 * b * length) * sigma**2
    # What is tilted passes the sphere aslant.
    assert 0.93 * kept < power < kept
    width = trapezoid(flux * eta**3, eta) / trapezoid(flux * eta, eta) / 2
    by_core_and_halo = sigma**2 + (0.0013 + 0.188 * 0.0754) * b * length / 3
    assert width == pytest.approx(by_core_and_halo, rel=0.05)


def test_a_measured_water_is_its_two_numbers():
    by_name = effects.check_effects({"sea": {"water": "petzold_coastal"}})
    assert by_name == {"sea": {"absorption_per_m": 0.179, "scattering_per_m": 0.219}}


# An effect, its settings, and what the line must say.
IMPOSSIBLE = [
    ("fog", {}, "effects.fog: unknown key", "attenuation, sea, lamp_flicker, lamp_drift"),
    ("adc", None, "effects.adc: empty; give its settings, or {} for defaults"),
    ("adc", {"bits": 10.0}, "effects.adc.bits: 10.0 is not a whole number", "1 to 16"),
    ("responsivity", {"gains": [[1.0] * 3] * 3}, "3 x 3 gains, but the array has 5 x 5"),
    ("responsivity", {"gains": [[1.0] * 5] * 4}, "not a square grid"),
    ("responsivity", {"gains": [[1.0] * 4 + [-1.0]] * 5}, "gains[0][4]: -1.0 is out of bounds"),
    (
        "responsivity",
        {"gains": [[1.0]], "seed": 1, "spread": 0.1},
        "gains: given together",
    ),
    ("responsivity", {"spread": 0.1}, "seed: missing; give spread and seed, or else gains"),
    ("attenuation", {}, "attenuation.k_per_m: missing", "or else water and wavelength_nm"),
    ("attenuation", {"k_per_m": 0.1, **JERLOV}, "attenuation.water: given together with k_per_m"),
    ("attenuation", {**JERLOV, "water": "coastal_2c"}, "water: 'coastal_2c' is unknown", "3c"),
    ("attenuation", {**JERLOV, "wavelength_nm": 390}, "wavelength_nm: 390 is out", "to 700 nm"),
    ("attenuation", CLEAR, "wavelength_nm: 450, but eren2016_clear is known from 500 to 550"),
    ("ambient", {"level_counts": 5, "k_per_m": 0.1}, "ambient.k_per_m: belongs to surface"),
    ("ambient", {"surface_counts": 1e9, "depth_m": 1, "k_per_m": 0}, "at most 1e6"),
    (
        "photodiode",
        {**DIODE, "watts_per_m2_per_count": 1.0},
        "given together with amps",
    ),
    ("detector_faults", {"dead": [[5, 0]]}, "no detector [5, 0]", "from 0 to 4"),
    ("detector_faults", {"dead": [[1]]}, "dead[0]: [1] is not a place", "[row, column]"),
]


@pytest.mark.parametrize("case", IMPOSSIBLE, ids=lambda case: f"{case[0]}: {case[2]}")
def test_what_is_impossible_is_refused_in_one_line(case):
    name, values, *words = case
    with pytest.raises(ValueError, match="effects") as caught:
        make_model({name: values})
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message
    with pytest.raises(ValueError, match=r"effects: \['adc'\] is not a mapping"):
        make_model(["adc"])


def test_readings_have_the_light_of_their_moment():
    model = make_model(lamp_flicker={"depth": 0.2, "frequency_hz": 100.0})
    poses, moments = np.broadcast_to(AHEAD, (40, 5)), np.linspace(3.003, 50.0, 40)
    light = model.light(poses, time_s=moments)
    assert np.ptp(light, axis=0).min() > 0.1 * light.min()
    np.testing.assert_array_equal(model.expose(poses, time_s=moments), light)


def test_the_drift_has_the_stated_spread_and_correlation():
    # Over many lamps, as one record of 16 waves is not long enough.
    lamps, times_s = 2000, np.array([100.0, 120.0])
    given = {"std": 0.1, "time_scale_s": 20.0}
    forms = [effects.moving.lamp_drift(ARRAY, **given, seed=seed) for seed in range(lamps)]
    now, later = np.log([form.factor(times_s, None, None) for form in forms]).T
    assert np.std(now) == pytest.approx(0.1, rel=4 / math.sqrt(2 * lamps))
    assert abs(np.mean(now)) < 5 * 0.1 / math.sqrt(lamps)
    assert np.corrcoef(now, later)[0, 1] == pytest.approx(
        math.exp(-0.5), abs=4 * (1 - math.exp(-1)) / math.sqrt(lamps)
    )
