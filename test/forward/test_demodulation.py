"""A modulated lamp, beside synchronous detection sample by sample."""

import designs
import numpy as np
import pytest
from calibrated_seas import largest_pull, recorded
from scenes import changed

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.calibration.likelihood.likelihood import CalibrationLikelihood
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

RATE_HZ, CARRIER_HZ, SAMPLES = 32e3, 1e3, 3200  # 100 ms
TIMES = np.arange(SAMPLES) / RATE_HZ
PHASE = 2 * np.pi * (CARRIER_HZ * TIMES + 0.25 / (RATE_HZ / CARRIER_HZ))
# Waveform and reference.
WAYS = {
    "square": (2.0 * (np.sin(PHASE) > 0), np.pi / 2 * np.sin(PHASE)),
    "sine": (1 + np.sin(PHASE), 2 * np.sin(PHASE)),
    "slots": (2.0 * (np.sin(PHASE) > 0), np.sign(np.sin(PHASE))),
}


def scene_with(waveform="square", ambient=300.0, **changes):
    effects = {
        "ambient": {"level_counts": ambient},
        "sensor_noise": {"sigma_counts": 2.0},
        "shot_noise": {"electrons_per_count": 50.0},
        "saturation": {"level_counts": 2000.0},
        "demodulation": {"waveform": waveform, "pedestal_counts": 30.0},
        **changes,
    }
    return designs.scene_with(effects, "ideal")


@pytest.mark.parametrize("waveform", WAYS)
def test_mean_and_noise_are_those_of_samples_times_the_reference(waveform):
    lamp, reference = WAYS[waveform]
    rng, count, light = np.random.default_rng(3), 4000, 200.0
    model = ForwardModel(scene_with(waveform))
    # Daylight that waves modulate by 30 % at 5 Hz, as a sunlit bottom shows.
    waves = 1 + 0.3 * np.sin(2 * np.pi * 5 * TIMES + rng.uniform(0, 2 * np.pi, (count, 1)))
    readings = np.empty(count)
    for i, wave in enumerate(waves):
        signal = 300.0 * wave + light * lamp
        # A plain mean of all samples has the variances that the scene states.
        variance = SAMPLES * (2.0**2 + signal / 50.0)
        samples = signal + np.sqrt(variance) * rng.standard_normal(SAMPLES)
        readings[i] = 30.0 + np.mean(reference * samples)
    image = np.full((1, 5, 5), light + 30.0)
    expected = float(model.variance(image)[0].max())
    assert readings.mean() == pytest.approx(230.0, abs=4 * np.sqrt(expected / count) + 0.02)
    assert readings.var() == pytest.approx(expected, rel=4 * np.sqrt(2 / count))


def test_darkness_reads_the_pedestal_whatever_the_daylight():
    dark = [-1e6, 0, 0, 0, 0]
    for ambient in (0.0, 300.0):
        model = ForwardModel(scene_with(ambient=ambient))
        np.testing.assert_allclose(model.light(dark), 30.0, rtol=1e-6)
        assert not {name for name in model.nuisances if name.startswith("ambient.")}


def test_lamp_and_daylight_saturate_together_at_the_lamps_peak():
    scene = scene_with()
    # 300 + 2 x 850 is 2,000, the level.
    assert ForwardModel(scene).converted(np.array([1e6])) == [850.0 + 30.0]
    assert scene.full_scale_counts == 880.0
    with pytest.raises(ValueError, match=r"saturation.level_counts: 200: daylight of 300 counts"):
        ForwardModel(scene_with(saturation={"level_counts": 200.0}))


def test_a_pedestal_is_added_behind_gains_and_has_no_shot_noise():
    """The same scene with and without one: light, its variance and readings of other gains."""
    effects = {
        "responsivity": {"spread": 0.1, "seed": 3},
        "shot_noise": {"electrons_per_count": 50.0},
        "adc": {"bits": 12},
    }
    pose = [-5.0, 0.2, -0.1, 0.05, -0.1]
    plain = ForwardModel(designs.scene_with(effects, "ideal"))
    model = ForwardModel(designs.scene_with({**effects, "pedestal": {"level_counts": 70}}, "ideal"))
    assert model.scene.black_counts == 70
    light, raised = plain.light(pose), model.light(pose)
    np.testing.assert_allclose(raised, light + 70, rtol=1e-12)
    np.testing.assert_allclose(model.variance(raised)[0], plain.variance(light)[0], rtol=1e-12)
    gains = 1 + 0.01 * np.arange(25.0).reshape(5, 5)
    np.testing.assert_allclose(model.with_gains(raised, gains), gains * light + 70, rtol=1e-12)
    still = np.zeros((1, 5)), np.zeros(1), None
    calibration = CalibrationLikelihood(model.scene, raised[None], *still)
    np.testing.assert_allclose(calibration.model.light([-1e6, 0, 0, 0, 0]), 0, atol=1e-6)
    seen = calibration.readings[0]
    np.testing.assert_allclose(seen, light.ravel(), rtol=1e-12)
    with pytest.raises(ValueError, match=r"effects.pedestal: demodulation has a pedestal"):
        scene_with(pedestal={"level_counts": 70.0})


def test_a_calibration_finds_lamp_and_gains_above_the_pedestal():
    truth = load_scene("sunlit_modulated")
    start = changed(truth, lamp={"beam_sigma_deg": 9.0, "reference_counts": 400.0})
    found = calibrate(start, *recorded(truth, 150, seed=4))
    assert largest_pull(found, truth) < 5.5
    assert found.scene.effects["ambient"] == truth.effects["ambient"]
