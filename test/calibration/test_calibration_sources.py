"""What a calibration finds of noise that grows with the reading, of floors, and behind a face."""

import dataclasses

import numpy as np
import pytest
from calibrated_seas import drive, exposed, largest_pull, named, recorded
from scenes import changed

from uuv_optical_array import cramer_rao_bound
from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.estimation.information.linearised import Lineariser
from uuv_optical_array.forward.lamp.lamps import BeaconLamp
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

NOISE, RELATIVE = "sensor_noise.sigma_counts", "sensor_noise.relative"
FEW = {"array": {"detectors_per_side": 3}}


def scene_of(base="reference", **groups):
    return changed(base, **FEW, **{"prior": {"known": "calibrated"}, **groups})


def noisy(sigma, relative):
    return scene_of(effects={"sensor_noise": {"sigma_counts": sigma, "relative": relative}})


def expected_errors(scene, poses, rolls):
    """Standard errors of both parts of Gaussian noise of zero mean, in each reading's variance."""
    light = ForwardModel(scene).light(poses, rolls).ravel()
    sigma, relative = scene.effects["sensor_noise"].values()
    variance = sigma**2 + (relative * light) ** 2 + 1 / 12
    by = np.array([np.full(len(light), 2 * sigma), 2 * relative * light**2]) / variance
    return np.sqrt(np.linalg.inv(0.5 * by @ by.T).diagonal())


@pytest.mark.parametrize(("sigma", "relative"), [(2.0, 0.03), (4.0, 0.01)])
def test_both_parts_of_the_noise_are_found_within_their_errors(sigma, relative):
    truth = noisy(sigma, relative)
    images, poses, rolls = recorded(truth, 300, seed=31)
    found = calibrate(noisy(1.0, 0.0), images, poses, rolls, fit_noise=True)
    assert not found.refusal
    errors = expected_errors(truth, poses, rolls)
    for name, true, error in zip((NOISE, RELATIVE), (sigma, relative), errors, strict=True):
        fitted = named(found)[name]
        assert abs(fitted.value - true) < 4.5 * fitted.std
        assert fitted.std == pytest.approx(error, rel=0.25)
        assert not fitted.note
    assert found.misfit == pytest.approx(1.0, abs=0.01)
    assert largest_pull(found, truth) < 5
    settings = found.scene.effects["sensor_noise"]
    assert list(settings.values()) == [named(found)[name].value for name in (NOISE, RELATIVE)]


def test_readings_that_are_alike_do_not_tell_a_relative_part():
    flat = {"detectors_per_side": 3, "shape": "planar", "radius_m": None, "width_m": 0.05}
    truth = changed(noisy(15.0, 0.0), array=flat, prior={"known": "calibrated"})
    rng = np.random.default_rng(4)
    poses = np.array([-6.0, 0, 0, 0, 0]) + rng.uniform(-0.01, 0.01, (60, 5))
    found = calibrate(truth, exposed(truth, poses, rng), poses, fit_noise=True)
    relative = named(found)[RELATIVE]
    assert (relative.value, relative.note) == (0.0, "not known")
    assert any(note.startswith(f"{RELATIVE} is not known") for note in found.notes)
    sigma = named(found)[NOISE]
    assert abs(sigma.value - 15.0) < 4.5 * sigma.std


def test_a_relative_noise_is_drawn_as_it_is_believed():
    model = ForwardModel(noisy(1.5, 0.04))
    light = np.array([0.0, 50.0, 400.0])
    draws = model.read(np.tile(light, (200_000, 1)), np.random.default_rng(6)) - light
    expected = 1.5**2 + (0.04 * light) ** 2 + 1 / 12
    # Readings at 0 are cut off.
    np.testing.assert_allclose(draws.var(axis=0)[1:], expected[1:], rtol=5 * np.sqrt(2 / 200_000))
    believed, _ = model.variance(light)
    gains = load_scene("reference").prior.spread  # exact
    np.testing.assert_allclose(
        believed - (model.scene.prior.spread * light) ** 2, expected, rtol=1e-9
    )
    assert gains == 0


def test_a_lamp_behind_its_face_is_found_and_its_poses_are_those_of_the_face():
    truth = scene_of(lamp={"behind_m": 0.2})
    prior = {"known": "calibrated", "lamp_behind_std_m": 0.3}
    images, poses, rolls = recorded(truth, 150, seed=7)
    found = calibrate(scene_of(prior=prior), images, poses, rolls)
    behind = named(found)["lamp.behind_m"]
    assert not found.refusal
    assert behind.std < 0.02
    assert abs(behind.value - 0.2) < 4.5 * behind.std
    assert found.scene.lamp.behind_m == pytest.approx(behind.value, rel=1e-8)
    assert found.scene.prior.lamp_behind_std_m == pytest.approx(behind.std, rel=1e-2)
    assert largest_pull(found, truth) < 5
    # What is not known of it is along x, whatever the light tells.
    at = [-5.0, 0.2, 0.1, 0.1, 0.0]
    before, after = (
        cramer_rao_bound(ForwardModel(scene_of(prior={"known": "calibrated", **more})), at)
        for more in ({}, {"lamp_behind_std_m": 0.3})
    )
    grown = np.diag([0.3**2, 0, 0, 0, 0])
    np.testing.assert_allclose(after.covariance - before.covariance, grown, atol=1e-9)


def test_without_its_prior_a_lamp_is_at_its_face():
    images, poses, rolls = recorded(scene_of(), 30, seed=8)
    assert "lamp.behind_m" not in named(calibrate(scene_of(), images, poses, rolls))


def modulated(prior, **lamp):
    effects = {"demodulation": {"waveform": "sine", "pedestal_counts": 30.0}, "ambient": None}
    return scene_of("reference", prior=prior, lamp=lamp, effects=effects)


def test_the_floor_of_a_modulated_lamp_is_found():
    truth = modulated({}, floor_counts=25.0)
    start = modulated({"known": "calibrated", "lamp_floor_std_counts": 50.0})
    drives = recorded(truth, 100, seed=9)
    found = calibrate(start, *drives)
    floor = named(found)["lamp.floor_counts"]
    assert abs(floor.value - 25.0) < 4.5 * floor.std < 1
    assert found.scene.lamp.floor_counts == pytest.approx(floor.value, rel=1e-8)
    assert found.scene.prior.lamp_floor_std_counts == pytest.approx(floor.std, rel=1e-2)
    # Taken for none it is no noise.
    assert calibrate(modulated({"known": "calibrated"}), *drives).refusal


def test_each_lamp_has_a_floor_of_its_own():
    start = load_scene("leading_lights")
    floors = [12.0, 0.0, 30.0]
    truth = dataclasses.replace(
        start,
        lamps=tuple(
            dataclasses.replace(lamp, floor_counts=floor)
            for lamp, floor in zip(start.lamps, floors, strict=True)
        ),
    )
    # A floor is on all detectors, and in the image of its lamp alone.
    poses, rolls = drive(np.random.default_rng(2), 3)
    off = ForwardModel(truth).light(poses, rolls) - ForwardModel(start).light(poses, rolls)
    by_lamp = off.reshape(3, 3, -1)
    np.testing.assert_allclose(by_lamp, np.broadcast_to(np.reshape(floors, (3, 1)), by_lamp.shape))
    prior = dataclasses.replace(start.prior, lamps_floor_std_counts=40.0)
    found = calibrate(dataclasses.replace(start, prior=prior), *recorded(truth, 60, 3))
    assert not found.refusal
    for i, (lamp, floor) in enumerate(zip(found.scene.lamps, floors, strict=True)):
        fitted = named(found)[f"lamps.{i}.floor_counts"]
        assert lamp.floor_counts == pytest.approx(fitted.value, abs=1e-6)
        assert abs(fitted.value - floor) < 4.5 * fitted.std < 5
    assert largest_pull(found, truth) < 5.5


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        ({"lamp": {"floor_counts": 3.0}}, "lamp.floor_counts: without demodulation"),
        ({"prior": {"lamp_floor_std_counts": 3.0}}, "give effects.ambient"),
    ],
)
def test_a_floor_needs_a_modulated_lamp(groups, words):
    with pytest.raises(ValueError, match=words):
        changed("reference", **groups)


@pytest.mark.parametrize("key", ["floor_counts", "behind_m"])
def test_several_lamps_have_each_its_own(key):
    with pytest.raises(ValueError, match=f"lamp.{key}: 0.5, but each of the lamps"):
        changed("leading_lights", lamp={key: 0.5})
    with pytest.raises(ValueError, match="each of the lamps has its own; give 0"):
        changed("leading_lights", prior={f"lamp_{key.replace('_', '_std_')}": 0.5})
    assert BeaconLamp().floor_counts == 0


def test_a_linearised_reading_is_as_uncertain_as_its_noise_says():
    """By Fisher's information of a Gaussian whose variance grows with the square of the light."""
    model = ForwardModel(noisy(1.5, 0.04))
    pose = np.array([-5.0, 0.2, 0.1, 0.0, 0.1])
    light = model.light(pose).ravel()
    found = Lineariser(model, ())(light, pose).variances
    variance, slope = 1.5**2 + (0.04 * light) ** 2 + 1 / 12, 2 * 0.04**2 * light
    expected = 1 / (1 / variance + 0.5 * (slope / variance) ** 2)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
