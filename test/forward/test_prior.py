"""What a scene leaves unknown: its names and values, the shades, and gains as noise."""

import numpy as np
import pytest
from scipy.integrate import quad

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import ReadingNoise, reading_variance, variance_slope
from uuv_optical_array.forward.prior import shade_modes
from uuv_optical_array.forward.scene import load_scene, scene_from_settings


def scene(prior, effects=None, name="reference"):
    settings = load_scene(name).settings() | {"prior": prior}
    return scene_from_settings(settings | ({} if effects is None else {"effects": effects}), "sea")


def test_one_line_says_how_well_a_sea_is_known():
    assert scene({}).prior.nuisance_std() == {}
    once = scene({"known": "calibrated"}).prior
    assert once.nuisance_std() == {
        "lamp.power": 0.1,
        "lamp.beam_sigma_deg": 0.3,
        "attenuation.k_per_m": 0.02,
        "field_of_view.cosine_power": 0.1,
        "array.radius_m": 0.02,
        "ambient.level_counts": 5.0,
    }
    assert once.gain_std == 0.005
    bought = scene({"known": "as_bought", "lamp_power_std": 0.01}).prior
    assert bought.nuisance_std()["lamp.power"] == 0.01  # a value beside it counts
    assert bought.gain_std == 0.01


def test_a_set_of_values_leaves_out_what_the_scene_does_not_have():
    assert "attenuation.k_per_m" not in scene({"known": "as_bought"}, {}).prior.nuisance_std()
    sea = {"sea": {"absorption_per_m": 0.2, "scattering_per_m": 0.3}}
    stds = scene({"known": "calibrated"}, sea).prior.nuisance_std()
    assert (stds["sea.absorption_per_m"], stds["sea.scattering_per_m"]) == (0.02, 0.5)
    assert "attenuation.k_per_m" not in stds
    warming = {"responsivity": {"spread": 0.008, "seed": 1}}
    stds = scene({"temperature_std_c": 3.0}, warming).prior.nuisance_std()
    assert stds == {"responsivity.temperature_c": 3.0}


@pytest.mark.parametrize(
    ("name", "effects", "key", "words"),
    [
        ("reference", {}, "k_std_per_m", r"the scene has no effects\.attenuation"),
        ("reference", {}, "scattering_std", r"the scene has no effects\.sea"),
        ("reference", {}, "temperature_std_c", r"the scene has no effects\.responsivity"),
        ("follow", {}, "lamps_power_std", "the scene has no lamps"),
        (
            "reference",
            {"demodulation": {"waveform": "sine"}},
            "ambient_std_counts",
            "demodulation removes daylight; give 0",
        ),
    ],
)
def test_a_value_for_what_the_scene_does_not_have_is_refused(name, effects, key, words):
    with pytest.raises(ValueError, match=rf"prior\.{key}: {words}"):
        scene({key: 0.1}, effects, name)


@pytest.mark.parametrize("side", [3, 5, 21])
def test_shades_are_uneven_smooth_and_of_one_size(side):
    modes = shade_modes(side)
    ones = np.ones(side * side)
    np.testing.assert_allclose(modes @ modes.T / side**2, np.eye(5), atol=1e-12)
    np.testing.assert_allclose(modes @ ones, 0, atol=1e-10)
    # Of second order: third differences along the rows vanish.
    planes = modes.reshape(5, side, side)
    if side > 3:
        np.testing.assert_allclose(np.diff(planes, 3, axis=-1), 0, atol=1e-10)
        np.testing.assert_allclose(np.diff(planes, 3, axis=-2), 0, atol=1e-10)


def test_a_shaded_frame_is_a_weaker_lamp_and_five_modes():
    prior = scene({"lamp_power_std": 0.3, "shade_probability": 0.1, "shade_depth": 0.4}).prior
    clear, *shaded = prior.lights(1023)
    assert (clear.share, clear.depth, clear.daylight_counts) == (0.9, 0, 0)
    assert [(light.share, light.depth) for light in shaded] == [(0.05, 0.4), (0.05, 0.1)]
    stds = prior.std_in(shaded[0])
    assert stds["lamp.power"] == pytest.approx(0.5)
    # An order of the polynomials is a quarter of the one before.
    uneven = [std for name, std in stds.items() if name.startswith("shade.")]
    np.testing.assert_allclose(uneven, [0.1, 0.1, 0.025, 0.025, 0.025])
    assert prior.gain_std_in(shaded[0]) == pytest.approx(0.025)
    assert prior.nuisance_std() == prior.std_in(clear) == {"lamp.power": 0.3}


def test_a_frame_that_is_lit_unevenly_has_five_modes_and_daylight_and_a_weaker_lamp():
    known = {"lamp_power_std": 0.15, "uneven_probability": 0.1, "ambient_gradient_std_counts": 15.0}
    prior = scene(known).prior
    clear, small, large, *larger = prior.lights(1000)
    np.testing.assert_allclose([clear.share, small.share, large.share], [0.9, 0.2 / 3, 0.028])
    np.testing.assert_allclose([light.share for light in larger], [0.004, 0.1 / 75])
    for times, light in zip((2, 3), larger, strict=True):
        assert (light.depth, light.daylight_counts) == pytest.approx((times * 0.2, times * 20))
    # By several lamps there are none beyond a shade of a fifth.
    assert [light.size for light in prior.lights(1000, 3)] == [0.0, 0.25, 1.0]
    assert prior.std_in(clear) == prior.nuisance_std()
    stds = prior.std_in(large)
    assert stds.pop("lamp.power") == 0.25  # a shade of a fifth dims, too
    # The scene's own gradient and that of daylight, 2 % of full scale, are independent.
    assert {stds.pop(f"ambient.to_{side}_counts") for side in ("starboard", "bottom")} == {25.0}
    shade = [0.05, 0.05, 0.0125, 0.0125, 0.0125]
    np.testing.assert_allclose(list(stds.values()), shade)
    modes = {name: std for name, std in prior.std_in(small).items() if name.startswith("shade")}
    np.testing.assert_allclose(list(modes.values()), np.array(shade) / 4)
    # Where clouds are named, they are what shades.
    assert len(scene({**known, "shade_probability": 0.2}).prior.lights(1000)) == 3


def test_an_unknown_gain_is_a_noise_that_grows_with_the_light():
    rng = np.random.default_rng(5)
    model = ForwardModel(scene({"gain_std": 0.05}))
    light = np.array([10.0, 100.0, 800.0])
    # Readings are drawn without the gains that only the prior knows.
    draws = model.read(light * (1 + 0.05 * rng.standard_normal((200_000, 3))), rng)
    variance, slope = model.variance(light)
    np.testing.assert_allclose(draws.var(axis=0), variance, rtol=0.02)
    # The slope integrates to the variance.
    noise = ReadingNoise(1.0, 0.3, 0.0, 1023.0, 0.0025)
    grown = quad(lambda value: float(variance_slope(value, noise)), 0, 50)[0]
    assert grown == pytest.approx(float(reading_variance(50.0, noise)) - 1.0)
    assert (slope > 0).all()


def test_the_shape_of_the_beam_spreads_readings_as_gains_do():
    """A set knows one Gaussian exactly, and several as far as it says."""
    several = {"beam_widths": [0.6, 1.0, 1.6], "beam_weights": [-0.2, 0.9, 0.3]}
    settings = load_scene("follow").settings()

    def known(lamp, **prior):
        told = scene_from_settings(
            {**settings, "lamp": {**settings["lamp"], **lamp}, "prior": prior}, "sea"
        )
        return told.prior.beam_shape_std, ForwardModel(told).noise.square

    for name, gains, shape in (("calibrated", 0.005, 0.005), ("as_bought", 0.01, 0.01)):
        assert known({}, known=name) == (0.0, gains**2)
        expected = pytest.approx((shape, gains**2 + shape**2), rel=1e-12)
        assert known(several, known=name) == expected
        expected = pytest.approx((0.03, gains**2 + 0.03**2), rel=1e-12)
        assert known({}, known=name, beam_shape_std=0.03) == expected
