"""Constants and gain errors beside the pose: against the dense filter of textbooks."""

import contextlib
import dataclasses
import functools
import math

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space, orth
from tracks import NOISE, OPEN, START_NS, STATION, TENTH_NS, assert_same, motion

from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking import filter
from uuv_optical_array.estimation.tracking.filter import POSE_STD
from uuv_optical_array.estimation.tracking.motion import RATE_STD
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.prior import ROLL

pytestmark = pytest.mark.filterwarnings("error")

# Constants in which the light is linear: nothing ends their learning.
NAMES, STDS, GAIN_STD = ("ambient.level_counts", ROLL), (0.1, 0.02), 0.05
HOLD_S = 60.0  # so short that drift shows
DRIFTING = dataclasses.replace(OPEN, constants_hold_s=HOLD_S, reset_after_s=60.0)
SHARP = 1e-4 * NOISE  # by which each frame sees another place
AWAY = np.array([0.5, 0.3, 0.0, 0.0, 0.0])  # m/s


def constants(detectors):
    return Constants(NAMES, STDS, GAIN_STD, detectors)


def frames(seed, detectors, count=7, truth=None, apart_s=2.0):
    """Return stamps and readings of light that is linear in pose, constants and gains.

    In two seconds errors of the place become others.
    """
    rng = np.random.default_rng(seed)
    apart_ns = rng.integers(1_000_000_000, 1_450_000_000, count)
    stamps = START_NS + np.cumsum((apart_s * apart_ns).astype(int))
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


def anywhere(readings, at):
    """Return linear readings as of another place."""
    off = readings.slopes @ (at - readings.at)
    return readings._replace(at=at, residuals=readings.residuals - off)


def prior_stds(detectors):
    return np.array([*STDS, *[GAIN_STD] * detectors])


def fed(tracker, stamps, readings, covariance=SHARP):
    for stamp, each in zip(stamps, readings, strict=True):
        track = tracker.update(stamp, each.at[:5], covariance, each)
    return track


def by_state(readings, alike=1.0):
    """Return slopes by pose and by biases, what is read of them, and the errors' covariance.

    Errors of the place, half as large as those of gains, are the same in so many frames.
    """
    says = np.isfinite(readings.variances)
    by_biases = np.hstack([readings.slopes[:, 5:], np.diag(readings.light)])
    read = readings.residuals + readings.slopes @ readings.at
    of_place = np.square(GAIN_STD / 2 * readings.light)
    errors = np.diag((readings.variances + alike * of_place)[says])
    return readings.slopes[says, :5], by_biases[says], read[says], errors


def textbook(stamps, readings, detectors, settings=DRIFTING):
    """Return mean and covariance of pose, rate and biases.

    What does not depend on the pose teaches the biases, where errors of the place are alike for
    two seconds; by the rest the gain of the biases is 0 (Schmidt).
    """
    variances = np.square(prior_stds(detectors))
    mean = np.concatenate([readings[0].at[:5], np.zeros(5 + len(variances))])
    covariance = np.diag([*np.square([*POSE_STD, *RATE_STD]), *variances])
    step_s = math.inf
    for k, each in enumerate(readings):
        if k:
            step_s = (stamps[k] - stamps[k - 1]) * 1e-9
            mean, covariance = moved(mean, covariance, step_s, settings, variances)
        rows = whitened(each, mean, max(1.0, 2.0 / step_s))
        rows = null_space(rows[:, :5].T).T @ rows
        mean, covariance = corrected(mean, covariance, rows, len(mean))
        rows = whitened(each, mean, 1.0)
        rows = orth(rows[:, :5]).T @ rows
        mean, covariance = corrected(mean, covariance, rows, 10)
    return mean, covariance


def whitened(readings, mean, alike):
    """Return slopes and innovations in units of their noise."""
    by_pose, by_biases, read, errors = by_state(readings, alike)
    slopes = np.hstack([by_pose, np.zeros((len(read), 5)), by_biases])
    white = 1 / np.sqrt(errors.diagonal())[:, None]
    return white * np.column_stack([slopes, read - slopes @ mean])


def corrected(mean, covariance, rows, told):
    """Return mean and covariance by slopes and innovations, which tell of as many of the first."""
    if not rows.size:
        return mean, covariance
    by, innovation = rows[:, :-1], rows[:, -1]
    gain = np.linalg.solve(by @ covariance @ by.T + np.eye(len(by)), by @ covariance).T
    gain[told:] = 0.0
    left = np.eye(len(mean)) - gain @ by
    return mean + gain @ innovation, left @ covariance @ left.T + gain @ gain.T


def moved(mean, covariance, step_s, settings, variances):
    """Return mean and covariance after a step of the motion and of the biases' drift."""
    kept, of_motion = math.exp(-step_s / settings.constants_hold_s), motion(step_s, settings)
    drift = kept * np.ones(len(variances)), (1 - kept**2) * variances
    transition, noise = (
        block_diag(one, np.diag(other)) for one, other in zip(of_motion, drift, strict=True)
    )
    return transition @ mean, transition @ covariance @ transition.T + noise


def assert_is(track, mean, covariance):
    near = {"rtol": 1e-4, "atol": 1e-6}
    biases, spread = mean[10:], covariance[10:, 10:]
    np.testing.assert_allclose([*track.pose, *track.rate], mean[:10], **near)
    np.testing.assert_allclose(track.joint_covariance, covariance[:10, :10], **near)
    assert list(track.constants) == list(NAMES)
    found = np.array([*track.constants.values()])
    np.testing.assert_allclose(found[:, 0], biases[:2], **near)
    np.testing.assert_allclose(found[:, 1], np.sqrt(spread.diagonal()[:2]), **near)
    np.testing.assert_allclose(track.gains, biases[2:], **near)
    turn = [*covariance[:5, 11], spread[1, 1]]  # of the roll with the pose
    np.testing.assert_allclose(track.turn, turn, **near)


def of_another_scene(readings):
    """Return readings that agree with the pose, and not with any likely constants and gains."""
    by_pose, _, _, errors = by_state(readings)
    white = 1 / np.sqrt(errors.diagonal())
    away = null_space((white[:, None] * by_pose).T)[:, 0] / white
    residuals = readings.residuals.copy()
    residuals[np.isfinite(readings.variances)] += 1000 * away
    return readings._replace(residuals=residuals)


def assert_alike(track, other):
    """Compare two tracks of which one has another step between its frames."""
    np.testing.assert_allclose(track.pose, other.pose, rtol=1e-9)
    np.testing.assert_allclose(track.joint_covariance, other.joint_covariance, rtol=1e-6)
    np.testing.assert_allclose(track.gains, other.gains, atol=1e-9)
    for name in NAMES:
        np.testing.assert_allclose(track.constants[name], other.constants[name], atol=1e-9)


def test_readings_that_no_constants_explain_teach_nothing(monkeypatch):
    monkeypatch.setattr(filter, "SHARES", {"usual": 1.0})  # of what may happen to the motion
    stamps, readings = frames(5, 25)
    with_it, without = (Tracker(DRIFTING, constants=constants(25)) for _ in range(2))
    fed(without, stamps[:5] + stamps[6:], readings[:5] + readings[6:])
    fed(with_it, stamps[:6], [*readings[:5], of_another_scene(readings[5])])
    assert_alike(fed(with_it, stamps[6:], readings[6:]), without.track())


def test_after_as_many_as_outliers_the_track_begins_anew():
    settings = dataclasses.replace(DRIFTING, reacquire_frames=3)
    stamps, readings = frames(6, 25, 8)
    whole, anew = (Tracker(settings, constants=constants(25)) for _ in range(2))
    false = [of_another_scene(each) for each in readings[2:5]]
    fed(whole, stamps[:5], [*readings[:2], *false])
    fed(anew, stamps[5:], readings[5:])
    track = fed(whole, stamps[5:], readings[5:])
    assert track.frames == 3
    assert_alike(track, anew.track())


def test_only_frames_in_a_row_that_no_constants_explain_begin_the_track_anew():
    settings = dataclasses.replace(DRIFTING, reacquire_frames=3)
    stamps, readings = frames(6, 25, 6)
    for place in (1, 2, 4):
        readings[place] = of_another_scene(readings[place])
    assert fed(Tracker(settings, constants=constants(25)), stamps, readings).frames == 6


def test_what_is_linear_where_the_track_expects_it_counts_as_if_it_were_so_about_its_fit():
    stamps, readings = frames(1, 9)
    tracker = Tracker(DRIFTING, constants=constants(9))
    fed(tracker, stamps[:1], readings[:1])
    for stamp, each in zip(stamps[1:], readings[1:], strict=True):
        near = functools.partial(anywhere, each)
        track = tracker.update(stamp, each.at[:5], SHARP, relinearise=near)
    assert_is(track, *textbook(stamps, readings, 9))


def test_what_is_not_linear_about_its_fit_begins_a_track_by_its_pose():
    stamps, readings = frames(1, 9, 3)
    by_pose, tracker = (Tracker(DRIFTING, constants=constants(9)) for _ in range(2))
    for stamp, each in zip(stamps[:2], readings[:2], strict=True):
        near = functools.partial(anywhere, each)
        track = tracker.update(stamp, each.at[:5], NOISE, relinearise=near)
        assert_same(track, by_pose.update(stamp, each.at[:5], NOISE))
    assert tracker.update(stamps[2], readings[2].at[:5], NOISE, readings[2]).frames == 1


def test_a_track_begins_with_readings_as_they_are():
    stamps, readings = frames(6, 25)
    tracker = Tracker(DRIFTING, constants=constants(25))
    track = fed(tracker, stamps[:1], [of_another_scene(readings[0])])
    assert (track.covariance.diagonal() < 1.0).all()


def test_readings_of_which_many_tell_of_no_constant_teach_as_others_do():
    """400 detectors have 49 gains; the noise of the others adds up."""
    stamps, readings = frames(7, 400)
    tracker = Tracker(DRIFTING, constants=constants(400))
    begun = fed(tracker, stamps[:1], readings[:1])
    track = fed(tracker, stamps[1:], readings[1:])
    for name in NAMES:
        assert track.constants[name].std < begun.constants[name].std


@pytest.mark.parametrize("apart_s", [2.0, 0.3])
@pytest.mark.parametrize(("seed", "detectors"), [(0, 9), (1, 9), (2, 49)])
def test_pose_rate_constants_and_gains_are_those_of_the_textbooks_filter(seed, detectors, apart_s):
    stamps, readings = frames(seed, detectors, apart_s=apart_s)
    tracker = Tracker(DRIFTING, constants=constants(detectors))
    assert_is(fed(tracker, stamps, readings), *textbook(stamps, readings, detectors))


def test_a_track_begins_with_readings_as_linearised_at_their_best_fit():
    stamps, readings = frames(0, 9, 1)
    elsewhere = readings[0]._replace(residuals=readings[0].residuals + 3.0)
    tracker = Tracker(DRIFTING, constants=constants(9))
    tracker.take(stamps[0], readings[0].at[:5], SHARP, readings[0], lambda at: elsewhere)
    assert_is(tracker.track(), *textbook(stamps, readings, 9))


def test_of_many_detectors_those_of_a_block_have_one_gain_error():
    count, size = 14 * 14, 7 * 7
    _, readings = frames(2, count, 1)
    (each,) = readings
    each = each._replace(variances=np.full(count, 1e-6), light=np.full(count, 20.0))
    rows = np.arange(count).reshape(14, 14)
    block = rows // 14 // 2 * 7 + rows % 14 // 2
    gains = (GAIN_STD / 2 * np.random.default_rng(1).standard_normal(size))[block.ravel()]
    each = each._replace(residuals=each.slopes @ (0.01 * np.ones(7)) + 20.0 * gains)
    track = fed(Tracker(DRIFTING, constants=constants(count)), [START_NS], [each])
    found = track.gains.reshape(7, 2, 7, 2)
    np.testing.assert_array_equal(found, np.broadcast_to(found[:, :1, :, :1], found.shape))
    assert np.corrcoef(track.gains, gains)[0, 1] > 0.9


def test_bare_poses_pass_by_a_track_of_readings():
    stamps, readings = frames(5, 9, apart_s=0.3)
    tracker, other = (Tracker(DRIFTING, constants=constants(9)) for _ in range(2))
    for k, (stamp, frame) in enumerate(zip(stamps, readings, strict=True)):
        if k == 3:
            assert tracker.update(stamp, frame.at[:5], NOISE).frames == 3
        else:
            track = tracker.update(stamp, frame.at[:5], SHARP, frame)
            same = other.update(stamp, frame.at[:5], SHARP, frame)
    near = {"rtol": 1e-6, "atol": 1e-8}
    np.testing.assert_allclose(track.pose, same.pose, **near)
    np.testing.assert_allclose(track.joint_covariance, same.joint_covariance, **near)


def test_constants_that_drift_are_followed():
    count, detectors, rng = 400, 9, np.random.default_rng(4)
    stds = prior_stds(detectors)
    truth = [stds * rng.standard_normal(2 + detectors)]
    stamps, _ = frames(4, detectors, count)
    for step_s in np.diff(stamps) * 1e-9:
        kept = math.exp(-step_s / HOLD_S)
        new = math.sqrt(1 - kept**2) * stds * rng.standard_normal(2 + detectors)
        truth.append(kept * truth[-1] + new)
    stamps, readings = frames(4, detectors, count, np.array(truth))
    tracker, squares = Tracker(DRIFTING, constants=constants(detectors)), []
    for stamp, each, biases in zip(stamps, readings, truth, strict=True):
        found = np.array([*tracker.update(stamp, each.at[:5], SHARP, each).constants.values()])
        squares.append(np.mean(np.square((found[:, 0] - biases[:2]) / found[:, 1])))
    assert 0.3 < np.mean(squares) < 2


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
    tracker = Tracker(DRIFTING, constants=constants(9))
    fed(tracker, stamps[:-1], readings[:-1])
    track = tracker.update(stamps[-1], readings[-1].at[:5], 1e4 * NOISE, readings[-1])
    mean, covariance = textbook(stamps[:-1], readings[:-1], 9)
    step_s = (stamps[-1] - stamps[-2]) * 1e-9
    mean, covariance = moved(mean, covariance, step_s, DRIFTING, np.square(prior_stds(9)))
    by_pose, by_biases, read, errors = by_state(readings[-1])
    # By least squares, with the biases as they were expected.
    weight = np.linalg.inv(errors)
    information = by_pose.T @ weight @ by_pose
    fit = np.linalg.solve(information, by_pose.T @ weight)
    by_all = np.hstack([by_pose, np.zeros((len(read), 5)), by_biases])
    off = fit @ (read - by_all @ mean)
    apart = fit @ (by_all @ covariance @ by_all.T + errors) @ fit.T
    assert track.distance**2 == pytest.approx(off @ np.linalg.solve(apart, off), rel=1e-3)


def test_what_is_learnt_outlives_the_track_and_fades_to_the_prior():
    stamps, readings = frames(7, 9)
    tracker = Tracker(DRIFTING, constants=constants(9))
    track = fed(tracker, stamps, readings)
    mean, covariance = textbook(stamps, readings, 9)
    last = track.stamp_ns
    # At a frame that says nothing they are what they were, also after a gap or a clock set back.
    blind = readings[0]._replace(variances=np.full(9, np.inf))
    for stamp, readings_then in ((last + 90 * 10**9, blind), (last + 160 * 10**9, None)):
        track = tracker.update(stamp, STATION, NOISE, readings_then)
        assert track.frames == 1
        kept = math.exp(-(stamp - last) * 1e-9 / HOLD_S)
        for i, name in enumerate(NAMES, 10):
            variance = kept**2 * covariance[i, i] + (1 - kept**2) * STDS[i - 10] ** 2
            assert track.constants[name].mean == pytest.approx(kept * mean[i], rel=1e-6)
            assert track.constants[name].std == pytest.approx(math.sqrt(variance), rel=1e-6)
    known = track.constants
    assert tracker.update(START_NS, STATION, NOISE).constants == known


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
    stamps, readings = frames(5, 9, 3)
    plain, asked = (
        Tracker(DRIFTING, constants=constants(9)),
        Tracker(DRIFTING, constants=constants(9)),
    )
    places = []

    def nowhere(at, of):
        places.append(at)
        return of._replace(residuals=np.full(9, np.nan))

    for stamp, each in zip(stamps, readings, strict=True):
        near = functools.partial(nowhere, of=each)
        track = asked.update(stamp, each.at[:5], NOISE, each, near)
        assert_same(track, plain.update(stamp, each.at[:5], NOISE, each))
    assert places
    # Nor are they taken at all where they are linear nowhere else.
    later = stamps[-1] + TENTH_NS, each.at[:5], NOISE
    assert_same(asked.update(*later, relinearise=near), plain.update(*later))
