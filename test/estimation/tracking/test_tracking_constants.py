"""Constants and gain errors beside the pose: against one regression, and textbooks' filter."""

import contextlib
import dataclasses
import functools
import math

import numpy as np
import pytest
from tracks import NOISE, OPEN, START_NS, STATION, TENTH_NS, assert_same, motion, whitened

from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import POSE_STD, RATE_STD, Tracker
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.prior import ROLL

pytestmark = pytest.mark.filterwarnings("error")

# Constants in which the light is linear: nothing ends their learning.
NAMES, STDS, GAIN_STD = ("ambient.level_counts", ROLL), (0.1, 0.02), 0.05
HOLD_S = 60.0  # so short that drift shows
DRIFTING = dataclasses.replace(OPEN, constants_hold_s=HOLD_S, reset_after_s=60.0)
STEADY = dataclasses.replace(DRIFTING, constants_hold_s=1e7)
AWAY = np.array([0.5, 0.3, 0.0, 0.0, 0.0])  # m/s: each frame sees another place


def constants(detectors):
    return Constants(NAMES, STDS, GAIN_STD, detectors)


def frames(seed, detectors, count=7, truth=None):
    """Return stamps and readings of light that is linear in pose, constants and gains."""
    rng = np.random.default_rng(seed)
    stamps = START_NS + np.cumsum(rng.integers(500_000_000, 950_000_000, count))
    truth = np.zeros((count, 2 + detectors)) if truth is None else truth
    found = []
    for stamp, biases in zip(stamps, truth, strict=True):
        pose = STATION + (stamp - START_NS) * 1e-9 * AWAY
        off = np.concatenate([0.1 * rng.standard_normal(5), STDS * rng.standard_normal(2)])
        at = np.concatenate([pose, [0, 0]]) + off
        variances = rng.uniform(0.5, 2.0, detectors)
        variances[rng.integers(detectors)] = np.inf
        slopes = rng.standard_normal((detectors, 7)) * [9, 9, 9, 50, 50, 30, 90]
        noise = np.sqrt(np.where(np.isfinite(variances), variances, 1.0))
        light = rng.uniform(5, 30, detectors)
        residuals = slopes @ (np.concatenate([pose, biases[:2]]) - at) + light * biases[2:]
        residuals += noise * rng.standard_normal(detectors)
        found.append(LinearisedReadings(at, residuals, slopes, light, variances))
    return stamps.tolist(), found


def fed(tracker, stamps, readings):
    for stamp, each in zip(stamps, readings, strict=True):
        track = tracker.update(stamp, each.at[:5], NOISE, each)
    return track


def by_state(readings):
    """Return slopes by pose and by biases, what is read of them, and the errors' covariance."""
    says = np.isfinite(readings.variances)
    by_biases = np.hstack([readings.slopes[:, 5:], np.diag(readings.light)])
    read = readings.residuals + readings.slopes @ readings.at
    return readings.slopes[says, :5], by_biases[says], read[says], np.diag(readings.variances[says])


def biases_by_regression(readings, detectors):
    """Return mean and covariance of the biases by all frames at once, the pose of each free."""
    stds = np.array([*STDS, *[GAIN_STD] * detectors])
    size, count = len(stds), len(readings)
    rows, values = [np.hstack([np.diag(1 / stds), np.zeros((size, 5 * count))])], [np.zeros(size)]
    for k, each in enumerate(readings):
        by_pose, by_biases, read, noise = by_state(each)
        row = np.zeros((len(read), size + 5 * count))
        row[:, :size], row[:, size + 5 * k : size + 5 * k + 5] = by_biases, by_pose
        rows.append(whitened(noise, row))
        values.append(whitened(noise, read))
    q, r = np.linalg.qr(np.vstack(rows))
    covariance = np.linalg.inv(r)[:size]
    return np.linalg.solve(r, q.T @ np.concatenate(values))[:size], covariance @ covariance.T


def motion_by_textbook(stamps, readings, biases, skipped=()):
    """Return pose and rate, filtered with the biases known, and their covariance."""
    mean = np.concatenate([readings[0].at[:5], np.zeros(5)])
    covariance = np.diag(np.square([*POSE_STD, *RATE_STD]))
    for k, each in enumerate(readings):
        if k:
            transition, noise = motion((stamps[k] - stamps[k - 1]) * 1e-9, STEADY)
            mean, covariance = transition @ mean, transition @ covariance @ transition.T + noise
        if k in skipped:
            continue
        by_pose, by_biases, read, noise = by_state(each)
        by_pose = np.hstack([by_pose, np.zeros((len(read), 5))])
        gain = np.linalg.solve(by_pose @ covariance @ by_pose.T + noise, by_pose @ covariance).T
        mean = mean + gain @ (read - by_biases @ biases - by_pose @ mean)
        covariance = (np.eye(10) - gain @ by_pose) @ covariance
    return mean, covariance


def motion_and_slopes(stamps, readings, biases, skipped=()):
    """Return pose and rate with the biases known, their covariance, and slopes by the biases."""
    mean, covariance = motion_by_textbook(stamps, readings, biases, skipped)
    others = [
        motion_by_textbook(stamps, readings, biases + more, skipped)[0]
        for more in np.eye(len(biases))
    ]
    return mean, covariance, (np.array(others) - mean).T


def state_by_both(stamps, readings, detectors, skipped=()):
    """Return pose, rate and biases, the covariance of the first two, the biases' and the turn."""
    learnt_of = [each for k, each in enumerate(readings) if k not in skipped]
    biases, spread = biases_by_regression(learnt_of, detectors)
    mean, covariance, slopes = motion_and_slopes(stamps, readings, biases, skipped)
    covariance = covariance + slopes @ spread @ slopes.T
    turn = [*slopes[:5] @ spread[:, 1], spread[1, 1]]  # of the roll with the pose
    return np.concatenate([mean, biases]), covariance, spread, turn


def assert_is(tracker, track, state, covariance, spread, turn):
    near = {"rtol": 1e-4, "atol": 1e-6}
    np.testing.assert_allclose([*track.pose, *track.rate], state[:10], **near)
    np.testing.assert_allclose(track.joint_covariance, covariance, **near)
    mean, found, _ = tracker.expected(track.stamp_ns)
    np.testing.assert_allclose(mean, state[10:12], **near)
    np.testing.assert_allclose(found, spread[:2, :2], **near)
    assert list(track.constants) == list(NAMES)
    for (offset, std), expected, square in zip(
        track.constants.values(), state[10:12], spread.diagonal()[:2], strict=True
    ):
        assert (offset, std) == pytest.approx((expected, math.sqrt(square)), rel=1e-4, abs=1e-6)
    np.testing.assert_allclose(track.gains, state[12:], **near)
    np.testing.assert_allclose(track.turn, turn, **near)


@pytest.mark.parametrize(("seed", "detectors"), [(0, 9), (1, 9), (2, 50)])
def test_biases_are_the_least_squares_solution_and_the_pose_is_filtered_given_them(seed, detectors):
    stamps, readings = frames(seed, detectors)
    tracker = Tracker(STEADY, constants=constants(detectors))
    track = fed(tracker, stamps, readings)
    assert_is(tracker, track, *state_by_both(stamps, readings, detectors))


def test_bare_poses_pass_by_a_track_of_readings():
    stamps, readings = frames(5, 9)
    tracker = Tracker(STEADY, constants=constants(9))
    for k, (stamp, frame) in enumerate(zip(stamps, readings, strict=True)):
        if k == 3:
            assert tracker.update(stamp, frame.at[:5], NOISE).frames == 3
        else:
            track = tracker.update(stamp, frame.at[:5], NOISE, frame)
    assert_is(tracker, track, *state_by_both(stamps, readings, 9, skipped=[3]))


def test_constants_that_drift_are_followed():
    count, detectors, rng = 400, 9, np.random.default_rng(4)
    stds = np.array([*STDS, *[GAIN_STD] * detectors])
    truth = [stds * rng.standard_normal(2 + detectors)]
    stamps, _ = frames(4, detectors, count)
    for step_s in np.diff(stamps) * 1e-9:
        kept = math.exp(-step_s / HOLD_S)
        new = math.sqrt(1 - kept**2) * stds * rng.standard_normal(2 + detectors)
        truth.append(kept * truth[-1] + new)
    stamps, readings = frames(4, detectors, count, np.array(truth))
    tracker, squares = Tracker(DRIFTING, constants=constants(detectors)), []
    for stamp, each, biases in zip(stamps, readings, truth, strict=True):
        tracker.update(stamp, each.at[:5], NOISE, each)
        mean, covariance, _ = tracker.expected(stamp)
        off = mean - biases[:2]
        squares.append(off @ np.linalg.solve(covariance, off))
    # Two numbers; the oldest frames count as if what they saw had not moved.
    assert 1 < np.mean(squares) < 4


def test_bare_poses_alone_become_the_track_and_readings_begin_it_anew():
    stamps, readings = frames(5, 9)
    tracker = Tracker(DRIFTING, constants=constants(9))
    tracker.update(stamps[0], readings[0].at[:5], NOISE, readings[0])
    s = 10**9
    for late_s, has, count in (
        (1, False, 1),  # without
        (70, False, 1),  # for longer than reset_after_s: a track of poses
        (71, False, 2),
        (72, True, 1),  # of readings again
        (73, True, 2),
        (74, False, 2),
    ):
        with_it = readings[0] if has else None
        assert tracker.update(stamps[0] + late_s * s, STATION, NOISE, with_it).frames == count


def test_the_distance_is_that_of_the_pose_that_the_readings_show():
    stamps, readings = frames(6, 9)
    tracker = Tracker(STEADY, constants=constants(9))
    fed(tracker, stamps[:-1], readings[:-1])
    track = tracker.update(stamps[-1], readings[-1].at[:5], 1e4 * NOISE, readings[-1])
    biases, spread = biases_by_regression(readings[:-1], 9)
    mean, given, slopes = motion_and_slopes(stamps[:-1], readings[:-1], biases)
    transition, noise = motion((stamps[-1] - stamps[-2]) * 1e-9, STEADY)
    by_pose, by_biases, read, errors = by_state(readings[-1])
    # By least squares, with the biases as they were expected.
    pose = np.linalg.lstsq(
        whitened(errors, by_pose), whitened(errors, read - by_biases @ biases), rcond=None
    )[0]
    weight = np.linalg.inv(errors)
    information = by_pose.T @ weight @ by_pose
    by = -np.linalg.solve(information, by_pose.T @ weight @ by_biases)
    by -= (transition @ slopes)[:5]
    apart = by @ spread @ by.T + np.linalg.inv(information)
    apart += (transition @ given @ transition.T + noise)[:5, :5]
    off = pose - (transition @ mean)[:5]
    assert track.distance**2 == pytest.approx(off @ np.linalg.solve(apart, off), rel=1e-3)


def test_what_is_learnt_outlives_the_track_and_fades_to_the_prior():
    stamps, readings = frames(7, 9)
    tracker = Tracker(DRIFTING, constants=constants(9))
    np.testing.assert_array_equal(tracker.expected(START_NS)[0], 0.0)
    np.testing.assert_allclose(tracker.expected(START_NS)[1], np.diag(np.square(STDS)), rtol=1e-12)
    fed(tracker, stamps, readings)
    mean, covariance, _ = tracker.expected(stamps[-1])
    late = stamps[-1] + 90 * 10**9
    kept = math.exp(-90 / HOLD_S)
    expected = kept**2 * covariance + (1 - kept**2) * np.diag(np.square(STDS))
    np.testing.assert_allclose(tracker.expected(late)[0], kept * mean, rtol=1e-9)
    np.testing.assert_allclose(tracker.expected(late)[1], expected, rtol=1e-9)
    # A new track starts with them: at a frame that says nothing, they are what they were.
    blind = readings[0]._replace(variances=np.full(9, np.inf))
    assert tracker.update(late, STATION, NOISE, blind).frames == 1
    np.testing.assert_allclose(tracker.expected(late)[1], expected, rtol=1e-9)
    # So do those that a gap or a clock that was set back begin.
    gone = math.exp(-61 / HOLD_S) ** 2
    faded = gone * expected + (1 - gone) * np.diag(np.square(STDS))
    for stamp in (late + 61 * 10**9, START_NS):
        assert tracker.update(stamp, STATION, NOISE).frames == 1
        np.testing.assert_allclose(tracker.expected(stamp)[1], faded, rtol=1e-9)


def test_late_frames_with_readings_give_exactly_the_track_of_frames_in_order():
    options = TrackerSettings(buffer_s=30.0, reset_after_s=60.0)
    stamps, readings = frames(8, 9)
    order = [0, 2, 1, 5, 3, 6, 4]
    in_order, late = (Tracker(options, constants=constants(9)) for _ in range(2))
    for tracker, places in ((in_order, range(7)), (late, order)):
        for k in places:
            with contextlib.suppress(Outlier):
                tracker.update(stamps[k], readings[k].at[:5], NOISE, readings[k])
    probe = stamps[-1] + TENTH_NS, STATION, 1e6 * NOISE
    assert_same(in_order.update(*probe), late.update(*probe))


@pytest.mark.parametrize(
    ("part", "value", "message"),
    [
        ("at", np.zeros(5), r"^readings: at has the shape \(5,\); give \(7,\)"),
        ("slopes", np.zeros((9, 5)), r"^readings: slopes .*give \(9, 7\)"),
        ("residuals", np.zeros(8), r"^readings: residuals .*give \(9,\)"),
        ("light", np.full(9, np.inf), r"^readings: light .*not finite"),
        ("residuals", np.full(9, np.nan), r"^readings: residuals .*not finite"),
        ("variances", np.full(9, np.nan), r"^readings: a variance is nan; give .*> 0, inf"),
        ("variances", np.zeros(9), r"^readings: a variance is 0; give .*> 0, inf"),
    ],
)
def test_bad_readings_are_refused_and_leave_no_trace(part, value, message):
    stamps, readings = frames(9, 9, count=4)
    tracker, untouched = (Tracker(DRIFTING, constants=constants(9)) for _ in range(2))
    for each in (tracker, untouched):
        fed(each, stamps[:3], readings[:3])
    with np.errstate(all="raise"), pytest.raises(ValueError, match=message):
        tracker.update(stamps[3], STATION, NOISE, readings[3]._replace(**{part: value}))
    assert_same(
        *(each.update(stamps[3], STATION, NOISE, readings[3]) for each in (tracker, untouched))
    )


def test_readings_that_cannot_be_linearised_on_the_way_are_taken_as_they_are():
    stamps, readings = frames(5, 6, 3)
    plain, asked = (
        Tracker(DRIFTING, constants=constants(6)),
        Tracker(DRIFTING, constants=constants(6)),
    )
    places = []

    def nowhere(at, of):
        places.append(at)
        return of._replace(residuals=np.full(6, np.nan))

    for stamp, each in zip(stamps, readings, strict=True):
        near = functools.partial(nowhere, of=each)
        track = asked.update(stamp, each.at[:5], NOISE, each, near)
        assert_same(track, plain.update(stamp, each.at[:5], NOISE, each))
    assert places
