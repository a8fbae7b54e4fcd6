"""By how much the clocks of images and poses differ."""

import functools
from typing import NamedTuple

import numpy as np
import pytest
from scenes import changed

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.calibration.clock import synchronised
from uuv_optical_array.calibration.likelihood.parameters import Layout
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.recording.clocks import rates_of
from uuv_optical_array.recording.images import Recording

STD = np.array([0.02, 0.02, 0.02, *np.radians([0.5, 0.5])])
SECONDS = np.arange(10.2, 33.8, 0.2)  # known far enough on either side


def course(t):
    """Return poses and rolls of a follower that runs from 3 to 7 m and weaves; nan before 10 s."""
    pose = np.column_stack(
        [
            -5 + 2 * np.cos(2 * np.pi * t / 24),
            0.5 * np.sin(0.9 * t),
            0.45 * np.cos(1.1 * t),
            0.2 * np.sin(1.3 * t),
            0.2 * np.cos(0.8 * t),
        ]
    )
    roll = 0.05 * np.sin(0.5 * t)
    unknown = (t < 10) | (t > 34)
    return np.where(unknown[:, None], np.nan, pose), np.where(unknown, np.nan, roll)


def drive(offset_s, std=None, seed=1):
    """Return a recording whose images are of their stamps and an offset, with erring poses."""
    rng = np.random.default_rng(seed)
    true, rolls = course(SECONDS + offset_s)
    images = ForwardModel(load_scene("follow")).expose(true, rng, rolls)
    errors = 0 if std is None else std * rng.standard_normal(true.shape)
    stamps = np.rint(SECONDS * 1e9).astype(np.int64)

    def poses_at(at):
        poses, rolls = course(at * 1e-9)
        return poses + errors, rolls

    return Recording(images, *poses_at(stamps), stamps, poses_at=poses_at)


def fit_with(std):
    def fit(recording):
        return calibrate(
            load_scene("follow"),
            recording.images,
            recording.poses,
            recording.rolls,
            pose_std=std,
            rates=recording.rates,
        )

    return fit


def scattering(result):
    return next(p for p in result.parameters if p.name == "sea.scattering_per_m")


@functools.cache
def of_exact_poses(offset_s):
    """Return what `synchronised` does, and the misfit of each of its fits."""
    misfits = []

    def fit(recording):
        result = fit_with(None)(recording)
        misfits.append(result.misfit)
        return result

    return *synchronised(drive(offset_s), fit), misfits


@pytest.mark.parametrize("offset_s", [0.01, -0.05])
def test_an_offset_is_found_and_taken_into_account(offset_s):
    moved, result, clock, misfits = of_exact_poses(offset_s)
    assert clock.applied
    assert abs(clock.offset_s - offset_s) < 5 * clock.std_s
    assert clock.std_s < 2e-4
    side = "early" if offset_s > 0 else "late"
    assert f"ms {side}, which was taken into account" in clock.text()
    b = scattering(result)
    assert abs(b.value - 0.09) < 4 * b.std
    # Without it the fit is off by more than its errors say.
    assert result.misfit < 1.1
    assert misfits[0] > 1.5
    true, _ = course(moved.seconds + offset_s)
    np.testing.assert_allclose(moved.poses, true, atol=5 * clock.std_s)


@pytest.mark.parametrize("power_known", [True, False])
def test_the_error_of_the_offset_is_that_of_its_information(power_known):
    """Of exact poses: the inverse of the sum of slopes squared over the variance, by differences.

    The slopes are those by time, and by the power, which a follower that moves away confuses with
    the time.
    """
    scene, step = changed("follow", prior={"known": "exactly"}), 1e-4
    recording = drive(0.0).only(SECONDS < 12.0, "")
    model = ForwardModel(scene)
    before, still, after = (
        model.light(*course(recording.seconds + sign * step)) for sign in (-1, 0, 1)
    )
    variance, _ = model.variance(still)
    margin = 3 * np.sqrt(variance)
    inside = (still > margin) & (still < 1023 - margin)
    slopes = np.array([(after - before) / (2 * step), still])
    joint = np.einsum("imrc,jmrc->ij", slopes * inside / variance, slopes)
    if power_known:
        joint = joint[:1, :1]
    least = np.sqrt(np.linalg.inv(joint)[0, 0])
    result = calibrate(
        scene,
        recording.images,
        recording.poses,
        recording.rolls,
        hold=[*Layout(scene).names[not power_known :], "gains"],
        rates=rates_of(recording).rates,
    )
    assert result.misfit < 1.2
    assert result.clock[1] == pytest.approx(least * max(1, result.misfit) ** 0.5, rel=0.05)


def test_rates_are_those_of_the_course_at_its_ends_too():
    """Of a straight one, whose poses before its first image and after its last are not known."""
    stamps = np.rint(1e9 * np.arange(1.0, 2.0, 0.1)).astype(np.int64)
    rate = np.array([0.4, -0.2, 0.1, 0.05, 0.3, -0.1])

    def poses_at(at):
        way = (at * 1e-9)[:, None] * rate + np.array([-6.0, 0, 0, 0, np.pi - 0.4, 0])
        way[:, 4] = (way[:, 4] + np.pi) % (2 * np.pi) - np.pi  # it turns past astern
        way[(at < stamps[0]) | (at > stamps[-1])] = np.nan
        return way[:, :5], way[:, 5]

    recording = Recording(np.zeros((10, 5, 5)), *poses_at(stamps), stamps, poses_at=poses_at)
    np.testing.assert_allclose(rates_of(recording).rates, np.tile(rate, (10, 1)), rtol=1e-6)


def test_it_is_fitted_anew_until_a_step_is_a_tenth_of_its_standard_error():
    """By a stand-in for a fit, each of whose steps leaves a tenth of what the offset is off."""

    class Found(NamedTuple):
        clock: tuple[float, float]

    recording, fits, true_s = drive(0.0), [], 0.05

    def fit(moved):
        fits.append(Found((0.9 * (true_s - moved.offset_s), 0.004)))
        return fits[-1]

    _, found, clock = synchronised(recording, fit)
    np.testing.assert_allclose([f.clock[0] for f in fits], [0.045, 4.5e-3, 4.5e-4, 4.5e-5])
    assert found is fits[-1]
    assert clock.offset_s == pytest.approx(0.04995)
    assert clock.applied


def test_clocks_that_agree_leave_a_calibration_as_it_is():
    recording = drive(0.0)
    moved, result, clock = synchronised(recording, fit_with(None))
    assert not clock.applied
    assert "images and poses agree within" in clock.text()
    assert moved is recording
    plain = fit_with(None)(recording)
    assert [p.value for p in result.parameters] == [p.value for p in plain.parameters]


def test_errors_of_the_poses_widen_that_of_the_offset():
    _, _, exact, _ = of_exact_poses(-0.05)
    _, _, erring = synchronised(drive(0.05, STD), fit_with(STD))
    assert erring.std_s > 10 * exact.std_s
    assert abs(erring.offset_s - 0.05) < 5 * erring.std_s


def test_a_vehicle_at_rest_tells_no_offset():
    recording = drive(0.0)
    still = np.tile([-5.0, 0.1, 0.0, 0.05, 0.0], (len(recording.images), 1))
    images = ForwardModel(load_scene("follow")).expose(still, np.random.default_rng(3))
    zero = np.zeros(len(still))
    result = calibrate(
        load_scene("follow"),
        images,
        still,
        zero,
        hold=["lamp.beam_sigma_deg", "sea.absorption_per_m", "sea.scattering_per_m", "gains"],
        rates=np.zeros((len(still), 6)),
    )
    assert result.clock == (0.0, np.inf)
