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
from uuv_optical_array.estimation.tracking.tracker import (
    LEARN_EVERY_S,
    POSE_STD,
    RATE_STD,
    Tracker,
)
from uuv_optical_array.estimation.unknowns.constants import Constants

pytestmark = pytest.mark.filterwarnings("error")

# Constants in which the light is linear: nothing ends their learning.
NAMES, STDS, GAIN_STD = ("ambient.level_counts", "ambient.to_bottom_counts"), (0.1, 0.02), 0.05
HOLD_S = 60.0  # so short that drift shows
LINEAR = dataclasses.replace(OPEN, constants_hold_s=HOLD_S, reset_after_s=60.0)


def constants(detectors):
    return Constants(NAMES, STDS, GAIN_STD, detectors)


def frames(seed, detectors, count=7, least_ns=50_000_000):
    """Return stamps and readings of light that is linear in pose and constants."""
    rng = np.random.default_rng(seed)
    stamps = START_NS + np.cumsum(rng.integers(least_ns, least_ns + 900_000_000, count))
    found = []
    for _ in stamps:
        at = np.concatenate([STATION + 0.1 * rng.standard_normal(5), STDS * rng.standard_normal(2)])
        variances = rng.uniform(0.5, 2.0, detectors)
        variances[rng.integers(detectors)] = np.inf
        slopes = rng.standard_normal((detectors, 7)) * [9, 9, 9, 50, 50, 30, 90]
        # Of a vehicle that stands still: no manoeuvre explains its frames better.
        noise = np.sqrt(np.where(np.isfinite(variances), variances, 1.0))
        residuals = slopes @ (np.array([*STATION, 0, 0]) - at) + noise * rng.standard_normal(
            detectors
        )
        light = rng.uniform(5, 30, detectors)
        found.append(LinearisedReadings(at, residuals, slopes, light, variances))
    return stamps.tolist(), found


def fed(tracker, stamps, readings):
    for stamp, each in zip(stamps, readings, strict=True):
        track = tracker.update(stamp, each.at[:5], NOISE, each)
    return track


def step(step_s, detectors):
    """Return transition and noise covariance of the whole state, constants and gains included."""
    size = 12 + detectors
    transition, noise = np.zeros((size, size)), np.zeros((size, size))
    transition[:10, :10], noise[:10, :10] = motion(step_s, LINEAR)
    kept = math.exp(-step_s / HOLD_S)
    last = np.square([*STDS, *[GAIN_STD] * detectors])
    transition[10:, 10:] = kept * np.eye(size - 10)
    noise[10:, 10:] = (1 - kept**2) * np.diag(last)
    return transition, noise


def before_all(at, detectors):
    mean = np.concatenate([at[:5], np.zeros(7 + detectors)])
    stds = [*POSE_STD, *RATE_STD, *STDS, *[GAIN_STD] * detectors]
    return mean, np.diag(np.square(stds))


def by_state(readings):
    """Return slopes by the whole state, what is read of it, and the errors' covariance."""
    says = np.isfinite(readings.variances)
    slopes = np.hstack(
        [
            readings.slopes[:, :5],
            np.zeros((len(says), 5)),
            readings.slopes[:, 5:],
            np.diag(readings.light),
        ]
    )
    read = readings.residuals + readings.slopes @ readings.at
    return slopes[says], read[says], np.diag(readings.variances[says])


def regression(stamps, readings, detectors):
    """Return state and covariance at the last frame, from all frames at once."""
    size, count = 12 + detectors, len(stamps)
    mean, covariance = before_all(readings[0].at, detectors)
    first = np.eye(size, size * count)
    rows, values = [whitened(covariance, first)], [whitened(covariance, mean)]
    for k, each in enumerate(readings):
        slopes, read, noise = by_state(each)
        row = np.zeros((len(read), size * count))
        row[:, size * k : size * (k + 1)] = slopes
        rows.append(whitened(noise, row))
        values.append(whitened(noise, read))
    for k, step_ns in enumerate(np.diff(stamps)):
        transition, noise = step(step_ns * 1e-9, detectors)
        row = np.zeros((size, size * count))
        row[:, size * k : size * (k + 1)] = -transition
        row[:, size * (k + 1) : size * (k + 2)] = np.eye(size)
        rows.append(whitened(noise, row))
        values.append(np.zeros(size))
    q, r = np.linalg.qr(np.vstack(rows))
    covariance = np.linalg.inv(r)[-size:]
    return np.linalg.solve(r, q.T @ np.concatenate(values))[-size:], covariance @ covariance.T


def assert_is(tracker, track, state, covariance):
    near = {"rtol": 1e-6, "atol": 1e-8}
    np.testing.assert_allclose([*track.pose, *track.rate], state[:10], **near)
    np.testing.assert_allclose(track.joint_covariance, covariance[:10, :10], **near)
    mean, found, _ = tracker.expected(track.stamp_ns)
    np.testing.assert_allclose(mean, state[10:12], **near)
    np.testing.assert_allclose(found, covariance[10:12, 10:12], **near)
    assert list(track.constants) == list(NAMES)
    for (offset, std), expected, square in zip(
        track.constants.values(), state[10:12], covariance.diagonal()[10:12], strict=True
    ):
        assert (offset, std) == pytest.approx((expected, math.sqrt(square)), rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_pose_constants_and_gains_are_the_least_squares_solution_over_all_frames(seed):
    stamps, readings = frames(seed, 9, least_ns=round(LEARN_EVERY_S * 1e9))
    tracker = Tracker(LINEAR, constants=constants(9))
    track = fed(tracker, stamps, readings)
    state, covariance = regression(stamps, readings, 9)
    assert_is(tracker, track, state, covariance)
    np.testing.assert_allclose(track.gains, state[12:], rtol=1e-6, atol=1e-8)


def textbook(stamps, frames_, detectors, learnt):
    """Filter with whole covariances by Joseph's form; constants are not learnt of every frame."""
    mean, covariance = before_all(frames_[0].at, detectors)
    last = -math.inf
    for k, frame in enumerate(frames_):
        if k:
            transition, noise = step((stamps[k] - stamps[k - 1]) * 1e-9, detectors)
            mean = transition @ mean
            covariance = transition @ covariance @ transition.T + noise
        if frame is None:
            continue
        due = stamps[k] - last >= LEARN_EVERY_S * 1e9
        (slopes, read, noise), corrected = by_state(frame), learnt if due else 10
        last = stamps[k] if due else last
        spread = slopes @ covariance @ slopes.T + noise
        gain = np.linalg.solve(spread, slopes @ covariance).T
        gain[corrected:] = 0.0
        mean = mean + gain @ (read - slopes @ mean)
        rest = np.eye(len(mean)) - gain @ slopes
        covariance = rest @ covariance @ rest.T + gain @ noise @ gain.T
    return mean, covariance


@pytest.mark.parametrize(("detectors", "learnt"), [(9, 21), (50, 12)])
def test_gains_of_many_detectors_are_not_learnt_and_bare_poses_pass_by_a_track_of_readings(
    detectors, learnt
):
    # Of 50 detectors the gains are not learnt, and yet no average takes them away.
    stamps, stream = frames(5, detectors)
    stream[3] = None
    tracker = Tracker(LINEAR, constants=constants(detectors))
    for stamp, frame in zip(stamps, stream, strict=True):
        if frame is None:
            assert tracker.update(stamp, STATION, NOISE).frames == 3
        else:
            track = tracker.update(stamp, frame.at[:5], NOISE, frame)
    assert_is(tracker, track, *textbook(stamps, stream, detectors, learnt))
    assert track.gains.shape == ((9,) if detectors == 9 else (0,))


def test_bare_poses_alone_become_the_track_and_readings_begin_it_anew():
    stamps, readings = frames(5, 9)
    tracker = Tracker(LINEAR, constants=constants(9))
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


def test_the_distance_is_that_of_a_jump_of_the_pose_and_not_of_all_readings():
    stamps, readings = frames(6, 9)
    tracker = Tracker(LINEAR, constants=constants(9))
    track = fed(tracker, stamps, readings)
    mean, covariance = textbook(stamps[:-1], readings[:-1], 9, 21)
    transition, noise = step((stamps[-1] - stamps[-2]) * 1e-9, 9)
    slopes, read, errors = by_state(readings[-1])
    spread = slopes @ (transition @ covariance @ transition.T + noise) @ slopes.T + errors
    off = read - slopes @ transition @ mean
    # How much a free jump of the pose lowers the squares of the residuals.
    weight = np.linalg.inv(spread)
    jump = np.linalg.lstsq(whitened(spread, slopes[:, :5]), whitened(spread, off), rcond=None)[0]
    left = off - slopes[:, :5] @ jump
    assert track.distance**2 == pytest.approx(off @ weight @ off - left @ weight @ left, rel=1e-6)


def test_what_is_learnt_outlives_the_track_and_fades_to_the_prior():
    stamps, readings = frames(7, 9)
    tracker = Tracker(LINEAR, constants=constants(9))
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
    tracker, untouched = (Tracker(LINEAR, constants=constants(9)) for _ in range(2))
    for each in (tracker, untouched):
        fed(each, stamps[:3], readings[:3])
    with np.errstate(all="raise"), pytest.raises(ValueError, match=message):
        tracker.update(stamps[3], STATION, NOISE, readings[3]._replace(**{part: value}))
    assert_same(
        *(each.update(stamps[3], STATION, NOISE, readings[3]) for each in (tracker, untouched))
    )


def test_readings_that_cannot_be_linearised_on_the_way_are_taken_as_they_are():
    stamps, readings = frames(5, 6, 3)
    plain, asked = Tracker(LINEAR, constants=constants(6)), Tracker(LINEAR, constants=constants(6))
    places = []

    def nowhere(at, of):
        places.append(at)
        return of._replace(residuals=np.full(6, np.nan))

    for stamp, each in zip(stamps, readings, strict=True):
        near = functools.partial(nowhere, of=each)
        track = asked.update(stamp, each.at[:5], NOISE, each, near)
        assert_same(track, plain.update(stamp, each.at[:5], NOISE, each))
    assert places
