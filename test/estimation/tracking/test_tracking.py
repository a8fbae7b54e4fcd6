"""The track: against least squares, exact fractions and chi-square."""

import contextlib
import dataclasses
import math
import warnings
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are
from scipy.stats import chi2
from tracks import (
    CORRELATED,
    NOISE,
    OPEN,
    START_NS,
    STATION,
    STD,
    TENTH_NS,
    assert_same,
    assert_same_state,
    fed,
    motion,
    moved,
    scattered,
    steady,
    whitened,
)

from uuv_optical_array.core.geometry import Y
from uuv_optical_array.estimation.tracking.motion import RATE_STD
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier, StampRefused
from uuv_optical_array.estimation.tracking.tracker import Tracker

pytestmark = pytest.mark.filterwarnings("error")


def least_squares(stamps, poses, noises, options):
    """Return state and covariance at the last frame, from one regression on all frames."""
    size = 10 * len(stamps)
    rows, values = [np.zeros((5, size))], [np.zeros(5)]
    rows[0][:, 5:10] = np.diag(1 / np.array(RATE_STD))
    for k, (pose, noise) in enumerate(zip(poses, noises, strict=True)):
        row = np.zeros((5, size))
        row[:, 10 * k : 10 * k + 5] = np.eye(5)
        rows.append(whitened(noise, row))
        values.append(whitened(noise, pose))
    for k, step_ns in enumerate(np.diff(stamps)):
        transition, noise = motion(step_ns * 1e-9, options)
        row = np.zeros((10, size))
        row[:, 10 * k : 10 * k + 10] = -transition
        row[:, 10 * k + 10 : 10 * k + 20] = np.eye(10)
        rows.append(whitened(noise, row))
        values.append(np.zeros(10))
    q, r = np.linalg.qr(np.vstack(rows))
    covariance = np.linalg.inv(r.T @ r)
    return np.linalg.solve(r, q.T @ np.concatenate(values))[-10:], covariance[-10:, -10:]


@pytest.mark.parametrize(("seed", "share"), [(0, 0.0), (1, 0.0), (2, 0.0), (9, 0.3)])
def test_the_track_is_the_least_squares_solution_and_the_common_share_is_added(seed, share):
    stamps, poses, noises = scattered(seed)
    options = dataclasses.replace(OPEN, common_share=share)
    track = fed(Tracker(options), *zip(stamps, poses, noises, strict=True))
    state, covariance = least_squares(stamps, poses, (1 - share) * noises, options)
    covariance[:5, :5] += share * noises[-1]
    np.testing.assert_allclose([*track.pose, *track.rate], state, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(track.joint_covariance, covariance, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(track.covariance, track.joint_covariance[:5, :5])
    assert (track.stamp_ns, track.frames) == (stamps[-1], 12)


def test_the_distance_is_mahalanobis_from_what_the_frames_before_predict():
    stamps, poses, noises = scattered(4, count=6)
    track = fed(Tracker(OPEN), *zip(stamps, poses, noises, strict=True))
    state, covariance = least_squares(stamps[:-1], poses[:-1], noises[:-1], OPEN)
    transition, noise = motion((stamps[-1] - stamps[-2]) * 1e-9, OPEN)
    off = poses[-1] - (transition @ state)[:5]
    spread = (transition @ covariance @ transition.T + noise)[:5, :5] + noises[-1]
    assert track.distance == pytest.approx(math.sqrt(off @ np.linalg.solve(spread, off)), rel=1e-7)


def test_the_steady_covariance_solves_the_riccati_equation():
    transition, noise = motion(0.1, OPEN)
    sight = np.eye(5, 10)
    prior = solve_discrete_are(transition.T, sight.T, noise, CORRELATED)[:5, :5]
    expected = prior - prior @ np.linalg.solve(prior + CORRELATED, prior)
    frames = ((START_NS + k * TENTH_NS, STATION, CORRELATED) for k in range(400))
    track = fed(Tracker(OPEN), *frames)
    np.testing.assert_allclose(track.covariance, expected, rtol=1e-6, atol=1e-10)
    assert (np.linalg.eigvalsh(CORRELATED - track.covariance) > 0).all()


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_errors_and_innovations_are_as_large_as_the_track_says(share):
    """The truth moves as the filter believes; the poses share one error in the given part."""
    options, runs, count = dataclasses.replace(OPEN, common_share=share), 80, 15
    rng = np.random.default_rng(31)
    transition, noise = motion(0.1, options)
    walk, root = np.linalg.cholesky(noise), np.linalg.cholesky(CORRELATED)
    nees, nis = 0.0, 0.0
    for _ in range(runs):
        state = np.concatenate([STATION, RATE_STD * rng.standard_normal(5)])
        bias = math.sqrt(share) * root @ rng.standard_normal(5)
        tracker = Tracker(options)
        for k in range(count):
            own = math.sqrt(1 - share) * root @ rng.standard_normal(5)
            track = tracker.update(START_NS + k * TENTH_NS, state[:5] + bias + own, CORRELATED)
            nis += track.distance**2  # 0 at the first frame
            off = track.pose - state[:5]
            state = transition @ state + walk @ rng.standard_normal(10)
        nees += off @ np.linalg.solve(track.covariance, off)
    for squares, freedom in ((nees, 5), (nis, 5 * (count - 1))):
        low, high = chi2.ppf([0.0005, 0.9995], freedom * runs)
        assert low < squares < high


FRAMES = st.lists(
    st.tuples(
        st.integers(1_000_000, 150_000_000),  # to the next frame, ns
        st.integers(0, 400_000_000),  # on its way, ns
        st.sampled_from([0.0, 0.0, 0.0, 3.0, 3.0, -4.0]),  # off the truth, m
    ),
    min_size=2,
    max_size=14,
)


@settings(max_examples=30)
@given(FRAMES, st.integers(0, 2**32))
def test_frames_out_of_order_give_exactly_the_track_of_frames_in_order(frames, seed):
    # Outliers, tracks found again and gaps longer than the shortest reset, all within the buffer.
    options = TrackerSettings(reset_after_s=0.1, buffer_s=0.4, reacquire_frames=3)
    rng = np.random.default_rng(seed)
    stamp, stream = START_NS, []
    for step, delay, off in frames:
        stamp += step
        pose = STATION + off + STD * rng.standard_normal(5)
        stream.append((stamp + delay, (stamp, pose, CORRELATED)))
    in_order, as_they_come = Tracker(options), Tracker(options)
    for tracker, arrivals in (
        (in_order, stream),
        (as_they_come, sorted(stream, key=lambda arrival: arrival[0])),
    ):
        for _, frame in arrivals:
            with contextlib.suppress(Outlier):
                tracker.update(*frame)
    assert_same_state(in_order, as_they_come, stamp)


def test_a_late_frame_finds_the_track_that_ended_before_the_buffer():
    frames = steady(6)
    newest = (frames[-1][0] + 1_500_000_000, STATION, NOISE)
    late = (newest[0] - 400_000_000, STATION + 0.1, NOISE)
    # The buffer of 0.5 s holds the newest frame alone; the track to go on from lies before it.
    assert_same(
        fed(Tracker(TrackerSettings()), *frames, newest, late),
        fed(Tracker(TrackerSettings()), *frames, late, newest),
    )


def test_a_late_frame_is_judged_by_itself_and_not_by_the_newest():
    *frames, missing, newest = steady(8)
    stray = moved(Y, 4.0)
    tracker = Tracker(TrackerSettings())
    fed(tracker, *frames, newest)
    with pytest.raises(Outlier):
        tracker.update(missing[0], stray, NOISE)
    tracker = Tracker(TrackerSettings())
    fed(tracker, *frames)
    with pytest.raises(Outlier):
        tracker.update(newest[0], stray, NOISE)
    assert tracker.update(*missing).stamp_ns == missing[0]


def test_frames_older_than_the_buffer_and_repeated_ones_are_refused_and_leave_no_trace():
    frames = steady(10)
    tracker, untouched = Tracker(TrackerSettings(buffer_s=0.5)), Tracker(TrackerSettings())
    fed(tracker, *frames)
    fed(untouched, *frames)
    with pytest.raises(StampRefused, match=r"^late frame: 0\.500 s .* buffer_s 0\.5"):
        tracker.update(frames[-1][0] - 500_000_001, STATION, NOISE)
    # As old as a frame may be without the clock having been set back: 0.5 s + 2 s.
    with pytest.raises(StampRefused, match=r"^late frame"):
        tracker.update(frames[-1][0] - 2_500_000_000, STATION, NOISE)
    for stamp, *_ in frames[-6:]:
        with pytest.raises(StampRefused, match=f"^repeated stamp: {stamp} ns"):
            tracker.update(stamp, STATION + 0.1, NOISE)
    probe = (frames[-1][0] + TENTH_NS, STATION, NOISE)
    assert_same(tracker.update(*probe), untouched.update(*probe))


@pytest.mark.parametrize("turns", [0.5, -0.5, 1.5])
def test_a_turn_through_half_a_circle_is_the_same_as_one_through_zero(turns):
    rng = np.random.default_rng(12)
    through_zero, through_half = Tracker(TrackerSettings()), Tracker(TrackerSettings())
    shift = np.array([0, 0, 0, 0, 2 * math.pi * turns])
    seen = []
    for k in range(60):
        pose = STATION + [0, 0, 0, 0, 0.1 * (0.1 * k - 3)] + 0.1 * STD * rng.standard_normal(5)
        track = through_zero.update(START_NS + k * TENTH_NS, pose, NOISE)
        turned = through_half.update(START_NS + k * TENTH_NS, pose + shift, NOISE)
        np.testing.assert_allclose(turned.covariance, track.covariance, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(turned.rate, track.rate, atol=1e-9)
        off = turned.pose - track.pose - shift
        np.testing.assert_allclose(off[:4], 0.0, atol=1e-9)
        assert abs(math.remainder(off[4], 2 * math.pi)) < 1e-9
        assert abs(turned.pose[4]) <= math.pi
        seen.append(turned.pose[4])
    assert min(seen) < -3 < 3 < max(seen)


def exact(stamps, poses, noises, options):
    """Return the pose's covariance by the textbook filter in rational numbers, without rounding."""

    def rational(matrix):
        return np.vectorize(Fraction, otypes=[object])(np.asarray(matrix, dtype=float))

    def inverse(matrix):
        size = len(matrix)
        rows = np.hstack([matrix, rational(np.eye(size))])
        for i in range(size):
            rows[i] = rows[i] / rows[i, i]
            for j in set(range(size)) - {i}:
                rows[j] = rows[j] - rows[j, i] * rows[i]
        return rows[:, size:]

    walk = np.repeat(
        [options.velocity_walk_m_per_s, math.radians(options.turn_walk_deg_per_s)], [3, 2]
    )
    square, zero, one = rational(np.diag(walk**2)), rational(np.zeros((5, 5))), rational(np.eye(5))
    p = np.block([[rational(noises[0]), zero], [zero, rational(np.diag(np.square(RATE_STD)))]])
    for step_ns, noise in zip(np.diff(stamps).tolist(), noises[1:], strict=True):
        step = Fraction(step_ns, 10**9)
        f = np.block([[one, step * one], [zero, one]])
        q = np.block(
            [[square * step**3 / 3, square * step**2 / 2], [square * step**2 / 2, square * step]]
        )
        p = f @ p @ f.T + q
        p = p - p[:, :5] @ inverse(p[:5, :5] + rational(noise)) @ p[:5]
    return p[:5, :5].astype(float)


def nearly_singular(rng):
    turn, _ = np.linalg.qr(rng.standard_normal((5, 5)))
    covariance = (turn * 0.1 * np.logspace(0, -9, 5)) @ turn.T
    return (covariance + covariance.T) / 2


@pytest.mark.parametrize("same", [True, False], ids=["one_valley", "valleys_across"])
def test_nearly_singular_covariances_lose_nothing_to_rounding(same):
    rng = np.random.default_rng(5)
    stamps = [START_NS + k * TENTH_NS for k in range(4)]
    noises = [nearly_singular(rng)] * 4 if same else [nearly_singular(rng) for _ in stamps]
    assert np.linalg.cond(noises[0]) > 0.9e9
    with warnings.catch_warnings(), np.errstate(all="raise"):
        warnings.simplefilter("error")
        track = fed(
            Tracker(OPEN), *((s, STATION, noise) for s, noise in zip(stamps, noises, strict=True))
        )
    expected = exact(stamps, None, noises, OPEN)
    # In the units of the answer itself, so that its narrowest direction counts like the widest.
    root = np.linalg.cholesky(expected)
    relative = np.linalg.solve(root, np.linalg.solve(root, track.covariance).T)
    np.testing.assert_allclose(relative, np.eye(5), atol=1e-4)


@settings(max_examples=30)
@given(st.integers(0, 2**32))
def test_whatever_is_accepted_gives_a_finite_positive_definite_covariance(seed):
    rng = np.random.default_rng(seed)
    options = TrackerSettings(
        velocity_walk_m_per_s=float(10 ** rng.uniform(-4, 1)),
        turn_walk_deg_per_s=float(10 ** rng.uniform(-3, 2)),
        common_share=float(rng.choice([0.0, 0.99])),
        gate_probability=1.0,
        reset_after_s=60.0,
    )
    tracker, stamp = Tracker(options), START_NS
    with np.errstate(all="raise"):
        for _ in range(12):
            stamp += int(10 ** rng.uniform(0, 10.7))  # from 1 ns to 50 s
            turn, _ = np.linalg.qr(rng.standard_normal((5, 5)))
            spread = 10 ** rng.uniform(-2, 8) * 10 ** -rng.uniform(0, 9.9, 5)
            noise = (turn * spread) @ turn.T
            pose = 1e5 * rng.standard_normal(5)
            track = tracker.update(stamp, pose, (noise + noise.T) / 2)
            assert np.isfinite([*track.pose, *track.rate]).all()
            np.testing.assert_array_equal(track.covariance, track.covariance.T)
            assert np.linalg.eigvalsh(track.covariance)[0] > 0


def test_the_arrays_given_and_returned_are_the_callers_own():
    tracker, untouched = Tracker(TrackerSettings()), Tracker(TrackerSettings())
    late, first, last = steady(3)
    pose, covariance = np.array(STATION), np.array(NOISE)
    track = tracker.update(first[0], pose, covariance)
    untouched.update(*first)
    for array in (pose, covariance, track.pose, track.rate, track.covariance):
        array[...] = 99.0
    # Once from the track, and once from the frames, which the late one has replayed.
    assert_same(tracker.update(*last), untouched.update(*last))
    assert_same(tracker.update(*late), untouched.update(*late))
