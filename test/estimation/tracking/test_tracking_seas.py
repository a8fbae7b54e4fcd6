"""The tracker in seas drawn from the prior: what it learns, and whether it knows how well."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from fits import writer_of_fits

from uuv_optical_array.estimation.information.linearised import LinearisedReadings, Lineariser
from uuv_optical_array.estimation.tracking.correction import BROAD_SHARE
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.estimation.unknowns.coordinates import frame_of
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = pytest.mark.filterwarnings("error")

NAMES = ("lamp.power", "lamp.beam_sigma_deg", "sea.absorption_per_m", "ambient.level_counts")
STDS, GAIN_STD = np.array([0.1, 0.3, 0.02, 5.0]), 0.005
FRAMES, STEP_S = 120, 0.25
FOLLOW = load_scene("follow")
MODEL = ForwardModel(
    dataclasses.replace(FOLLOW, effects={**FOLLOW.effects, "ambient": {"level_counts": 0.0}})
)


@functools.cache
def linearise():
    """Make the lineariser, compiled where it can be, when a test runs."""
    return Lineariser(MODEL, NAMES, writer_of_fits())


def sweep(rng):
    """Return poses that go from 8 to 4 m and back, swaying."""
    seconds = STEP_S * np.arange(FRAMES)
    amplitude = np.array([0.4, 0.3, math.radians(8), math.radians(8)])
    waves = np.sin(seconds[:, None] / rng.uniform(2, 4, 4) + rng.uniform(0, 6, 4))
    x = -6 - 2 * np.cos(2 * np.pi * np.arange(FRAMES) / FRAMES)
    return np.column_stack([x, amplitude * waves])


def still(rng):
    """Return one pose again and again."""
    return np.tile([-6.0, 0.1, 0.1, 0.02, 0.03], (2 * FRAMES, 1))


def fitted(image, start, mean, covariance):
    """Return readings linearised at the fit of pose and constants, and the pose's covariance."""
    at, prior = start, np.linalg.inv(covariance)
    for _ in range(3):
        found = linearise()(image, at)
        weights = 1 / (found.variances + np.square(GAIN_STD * found.light))
        precision = found.slopes.T * weights @ found.slopes
        score = found.slopes.T @ (weights * found.residuals)
        precision[5:, 5:] += prior
        score[5:] -= prior @ (at[5:] - mean)
        at = at + np.linalg.solve(precision, score)
    spread = np.linalg.inv(precision)[:5, :5]
    return linearise()(image, at), (spread + spread.T) / 2


def nees(off, covariance):
    return off @ np.linalg.solve(covariance, off)


def followed(tracker, time_s, image, start):
    """Return the track after an image, and the image's readings at its own fit."""
    found, covariance = fitted(image, start, np.zeros(4), np.diag(STDS**2))
    stamp, near = round((10 + time_s) * 1e9), functools.partial(linearise(), image)
    return tracker.update(stamp, found.at[:5], covariance, found, near), found


def tracked(frame, course=sweep, seas=4):
    """Return NEES of pose and constants, errors by std, and of the range, tracked and single."""
    rng = np.random.default_rng(3)
    constants = Constants(NAMES, tuple(STDS), GAIN_STD, 25, frame)
    of_pose, of_constants, by_std, tracks, singles = [], [], [], [], []
    for _ in range(seas):
        truth, gains = STDS * rng.standard_normal(4), 1 + GAIN_STD * rng.standard_normal((5, 5))
        poses, offsets = course(rng), dict(zip(NAMES, truth, strict=True))
        lights = MODEL.with_gains(MODEL.light(poses, 0.0, offsets), gains)
        tracker = Tracker(TrackerSettings(gate_probability=1.0), constants=constants)
        for k, (pose, light) in enumerate(zip(poses, lights, strict=True)):
            place = np.concatenate([pose, truth])
            track, found = followed(tracker, k * STEP_S, MODEL.read(light, rng).ravel(), place)
            of_pose.append(nees(track.pose - pose, track.covariance))
            by_std.append((track.pose - pose) / np.sqrt(track.covariance.diagonal()))
            if k > 0.8 * FRAMES:
                tracks.append(track.pose[0] - pose[0])
                singles.append(found.at[0] - pose[0])
        learnt = np.array([*track.constants.values()])
        of_constants.append(np.sum(np.square((learnt[:, 0] - truth) / learnt[:, 1])))
    return [np.array(part) for part in (of_pose, of_constants, by_std, tracks, singles)]


def rms(errors):
    return math.sqrt(np.mean(np.square(errors)))


def test_the_range_becomes_sharp_and_no_surer_than_it_is():
    of_pose, of_constants, by_std, tracks, singles = tracked(frame_of(MODEL))
    assert 2.5 < of_pose.mean() < 8
    assert np.abs(by_std).max() < 6
    assert of_constants.mean() < 10  # four on average
    assert rms(tracks) < 0.7 * rms(singles)


def test_standing_still_teaches_nothing_false():
    of_pose, of_constants, by_std, _, _ = tracked(frame_of(MODEL), still, 3)
    # The error of a vehicle that stands is the sea's: three numbers of chi-square(5), at 1e-3.
    assert of_pose.mean() < 37.7 / 3
    assert np.abs(by_std).max() < 6
    assert of_constants.mean() < 10  # four on average


def behind(range_m, constants):
    """Return a pose on the beam's axis."""
    return np.array([-range_m - constants.frame.centre_x, 0, 0, 0, 0])


@pytest.mark.parametrize("range_m", [4.0, 8.0])
def test_a_lamp_that_proves_brighter_was_farther_off(range_m):
    constants = Constants((NAMES[0],), (0.1,), frame=frame_of(MODEL))
    tracker = Tracker(TrackerSettings(reset_after_s=60.0), constants=constants)
    pose, brighter = behind(range_m, constants), 0.01
    # On the axis light goes with P exp(-K r) / r^2.
    by_power = range_m / (2 + 0.1 * range_m)
    at, zeros, ones = np.array([*pose, 0.0]), np.zeros(10), np.ones(10)
    seen = np.eye(10, 6)
    seen[0, 5] = by_power  # where the lamp is brighter, the same image is seen from farther off
    variances = np.array([0.25, 1, 1, 1, 1, *[np.inf] * 5])
    image = LinearisedReadings(at, zeros, seen, ones, variances)
    tracker.update(1, pose, np.diag(variances[:5]), image)
    # Half a metre nearer by its commands, the last reading tells the power.
    tracker.command(1, [0.5, 0.0, 0.0, 0.0, 0.0])
    slopes, residuals, blind = np.zeros((10, 6)), np.zeros(10), np.full(10, np.inf)
    slopes[9, 5], residuals[9], blind[9] = 1.0, brighter, 1e-9
    told = LinearisedReadings(at, residuals, slopes, ones, blind)
    track = tracker.update(1 + 10**9, pose + 0.5 * np.eye(5)[0], 0.04 * np.eye(5), told)
    assert track.constants[NAMES[0]].mean == pytest.approx(brighter, rel=1e-3)
    farther = brighter * by_power
    assert track.pose[0] == pytest.approx(pose[0] + 0.5 - farther, abs=0.1 * farther)


@pytest.mark.parametrize("range_m", [4.0, 8.0])
def test_what_makes_poses_without_readings_broad_is_one_error_of_all_poses(range_m):
    std, count = 0.1, 100
    constants = Constants((NAMES[0],), (std,), frame=frame_of(MODEL))
    tracker = Tracker(TrackerSettings(common_share=0.0), constants=constants)
    pose, noise = behind(range_m, constants), np.diag([0.25, 1, 1, 1, 1])
    for k in range(count):
        track = tracker.update(1 + 1000 * k, pose, noise)
    # Most of it is one error of all poses, as the constants and the shape of a posterior make it.
    along = 0.25 * ((1 - BROAD_SHARE) / count + BROAD_SHARE)
    assert track.covariance[0, 0] == pytest.approx(along, rel=1e-3)
    assert track.covariance[1, 1] == pytest.approx(4 * along, rel=1e-3)
    learnt = track.constants[NAMES[0]]
    assert (learnt.mean, learnt.std) == pytest.approx((0, std))


@pytest.mark.parametrize("step_s", [0.1, 2.0])
@pytest.mark.parametrize(("share", "teaches"), [(0.0, True), (0.02, False)])
def test_light_that_the_biases_do_not_explain_teaches_nothing_at_any_rate(step_s, share, teaches):
    """It is too bright and too dim by a share from detector to detector, as beside another lamp."""
    rng = np.random.default_rng(7)
    constants = Constants(NAMES, tuple(STDS), GAIN_STD, 25, frame_of(MODEL))
    tracker = Tracker(TrackerSettings(gate_probability=1.0), constants=constants)
    checks = 1 - 2 * (np.indices((5, 5)).sum(axis=0) % 2)
    lights = MODEL.light(poses := sweep(rng)[:40])
    lights[-1] *= 1 + share * checks
    gains = []
    for k, (pose, light) in enumerate(zip(poses, lights, strict=True)):
        place, image = np.concatenate([pose, np.zeros(4)]), MODEL.read(light, rng).ravel()
        gains.append(followed(tracker, k * step_s, image, place)[0].gains)
    changes = np.abs(gains[-1] - gains[-2]) / GAIN_STD
    assert (changes.max() > 1e-3) == teaches
