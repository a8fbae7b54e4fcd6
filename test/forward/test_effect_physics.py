"""Effects against theory: closed forms, published numbers, and simulations of another kind."""

import math

import numpy as np
import pytest
from scenes import make_scene

from uuv_optical_array.forward import effects
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scattering import scattered_light
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

AHEAD = [-5.0, 0.1, -0.1, 0.05, 0.1]
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


def model_with(chosen=None, **effects):
    return ForwardModel(make_scene(effects=chosen or effects))


@pytest.mark.parametrize(
    ("water", "wavelength_nm", "k_per_m"),
    [  # Jerlov (1976), table XXVII, and half way between its wavelengths
        ("coastal_1c", 537.5, 0.125),
        ("eren2016_clear", 532, 0.05),
        ("eren2016_coastal", 501, 0.1),
    ],
)
def test_a_water_type_is_the_number_of_the_table(water, wavelength_nm, k_per_m):
    typed = model_with(attenuation={"water": water, "wavelength_nm": wavelength_nm})
    found = typed.scene.effects["attenuation"]
    assert list(found) == ["k_per_m"], "what reads the scene finds a number"
    assert found["k_per_m"] == pytest.approx(k_per_m, rel=1e-12)
    number = model_with(attenuation=found)
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


def test_an_uncertain_temperature_needs_the_effect_it_acts_through():
    settings = load_scene("reference").settings()
    settings["prior"]["temperature_std_c"] = 3.0
    with pytest.raises(ValueError, match=r"prior.temperature_std_c: the scene has no effects.resp"):
        scene_from_settings(settings, "test")
    settings["effects"]["responsivity"] = {"spread": 0.008, "seed": 1}
    scene = scene_from_settings(settings, "test")
    assert scene.prior.nuisance_std() == {"responsivity.temperature_c": 3.0}


def test_a_rim_halves_the_light_at_the_half_angle_and_cuts_it_off_beyond():
    form = effects.detectors.field_of_view(None, half_angle_deg=40.0, edge_deg=5.0)
    for angle, share, tolerance in ((0, 1, 1e-3), (40, 0.5, 1e-12), (50, 0, 1e-3), (60, 0, 1e-6)):
        found = form.law(5.0, 0.0, math.cos(math.radians(angle)), *form.settings)[0]
        assert found == pytest.approx(share, abs=tolerance)
    # The edge is where 12 % are left, as of a hyperbolic tangent at -1.
    beyond = form.law(5.0, 0.0, math.cos(math.radians(42.5)), *form.settings)[0]
    assert beyond == pytest.approx(0.5 * (1 - math.tanh(1)), abs=0.01)


@pytest.mark.parametrize("length", [2.0, 6.0])
@pytest.mark.parametrize("b", [0.037, 0.219, 1.824])
def test_scattering_spreads_the_light_and_loses_what_its_law_says(b, length):
    sigma, eta = math.radians(4), np.linspace(1e-9, math.radians(70), 20_001)
    angle = eta**2 / 2, np.cos(eta), np.sin(eta) / eta
    light, of_light = scattered_light(length, angle, 1.0, -np.cos(eta), 1.0, sigma, b)
    flux, incidence = light[0], of_light[0]
    # The normal looks back along the ray: what passes a sphere about the lamp.
    power = np.trapezoid(flux * incidence * eta, eta) * length**2
    kept = math.exp(-0.0562 * b * length) * sigma**2
    # What is tilted passes the sphere aslant.
    assert 0.93 * kept < power < kept
    width = np.trapezoid(flux * eta**3, eta) / np.trapezoid(flux * eta, eta) / 2
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
    ("responsivity", {"gains": [[1.0] * 5] * 4}, "no square grid"),
    ("responsivity", {"gains": [[1.0] * 4 + [-1.0]] * 5}, "gains[0][4]: -1.0 is out of bounds"),
    ("responsivity", {"gains": [[1.0]], "seed": 1, "spread": 0.1}, "gains: given beside spread"),
    ("responsivity", {"spread": 0.1}, "seed: missing; give spread and seed, or else gains"),
    ("attenuation", {}, "attenuation.k_per_m: missing", "or else water and wavelength_nm"),
    ("attenuation", {"k_per_m": 0.1, **JERLOV}, "attenuation.water: given beside k_per_m"),
    ("attenuation", {**JERLOV, "water": "coastal_2c"}, "water: 'coastal_2c' is unknown", "3c"),
    ("attenuation", {**JERLOV, "wavelength_nm": 390}, "wavelength_nm: 390 is out", "to 700 nm"),
    ("attenuation", CLEAR, "wavelength_nm: 450, but eren2016_clear is known from 500 to 550"),
    ("ambient", {"level_counts": 5, "k_per_m": 0.1}, "ambient.k_per_m: belongs to surface"),
    ("ambient", {"surface_counts": 1e9, "depth_m": 1, "k_per_m": 0}, "at most 1e6"),
    ("photodiode", {**DIODE, "watts_per_m2_per_count": 1.0}, "m2_per_count: given beside amps"),
    ("detector_faults", {"dead": [[5, 0]]}, "no detector [5, 0]", "from 0 to 4"),
    ("detector_faults", {"dead": [[1]]}, "dead[0]: [1] is no place", "[row, column]"),
]


@pytest.mark.parametrize("case", IMPOSSIBLE, ids=lambda case: f"{case[0]}: {case[2]}")
def test_what_is_impossible_is_refused_in_one_line(case):
    name, values, *words = case
    with pytest.raises(ValueError, match="effects") as caught:
        model_with({name: values})
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message
    with pytest.raises(ValueError, match=r"effects: \['adc'\] is not a mapping"):
        model_with(["adc"])


FLICKER = {"lamp_flicker": {"depth": 0.2, "frequency_hz": 100.0}}
DRIFT = {"lamp_drift": {"std": 0.1, "time_scale_s": 20.0, "seed": 1}}
CLOUDS = {"depth": 1.5, "size_m": 0.15, "speed_m_per_s": 0.2, "distance_m": 2.5, "seed": 3}
PLUME = {"plume": CLOUDS}


@pytest.mark.parametrize("chosen", [FLICKER, DRIFT, PLUME], ids=["flicker", "drift", "plume"])
def test_without_a_moment_there_is_the_mean_sea_which_estimators_believe(chosen):
    still, moving = model_with(), model_with(**chosen)
    np.testing.assert_array_equal(moving.expose(AHEAD), still.light(AHEAD))
    for found, expected in zip(moving.linearised(AHEAD), still.linearised(AHEAD), strict=True):
        np.testing.assert_array_equal(found, expected)
    moments = np.linspace(3.003, 50.0, 40)
    seen = moving.expose(np.broadcast_to(AHEAD, (40, 5)), time_s=moments)
    assert not np.allclose(seen, still.light(AHEAD), rtol=1e-2)


LAMPS = 200


def test_the_drift_has_the_stated_spread_and_correlation():
    # Over many lamps, as one record of 16 waves is not long enough.
    now, later = [], []
    still = model_with().light(AHEAD).max()
    for seed in range(LAMPS):
        model = model_with(lamp_drift={"std": 0.1, "time_scale_s": 20.0, "seed": seed})
        both = np.log(model.expose([AHEAD, AHEAD], time_s=[100.0, 120.0]).max(axis=(1, 2)) / still)
        now.append(both[0])
        later.append(both[1])
    assert np.std(now) == pytest.approx(0.1, rel=4 / math.sqrt(2 * LAMPS))
    assert abs(np.mean(now)) < 5 * 0.1 / math.sqrt(LAMPS)
    assert np.corrcoef(now, later)[0, 1] == pytest.approx(
        math.exp(-0.5), abs=4 * (1 - math.exp(-1)) / math.sqrt(LAMPS)
    )
