"""The track of a follower whose commands are known, wrong or missing."""

import contextlib
import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import squared_error
from scipy.stats import chi2, norm
from tracks import (
    CORRELATED,
    NOISE,
    OPEN,
    START_NS,
    STATION,
    STD,
    TENTH_NS,
    Textbook,
    answer,
    assert_same,
    assert_same_state,
    fed,
    moved,
    scattered,
    steady,
    swung,
    turned,
    van_loan,
)

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Y
from uuv_optical_array.estimation.tracking.motion import RATE_STD
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import Tracker

pytestmark = pytest.mark.filterwarnings("error")

SWERVE = np.array([0.4, -0.1, 0.05, 0.02, -0.06])
WALK = np.diag(
    np.repeat([OPEN.velocity_walk_m_per_s**2, math.radians(OPEN.turn_walk_deg_per_s) ** 2], [3, 2])
)  # covariance of the rate's change in 1 s
FINE = NOISE / 25  # of which a wrong command of 9 m/s is far out


def swerves(stamps, rng, spacing_ns=70_000_000):
    """Return commands from before the first stamp to the last, none of them on a frame."""
    starts = range(stamps[0] - spacing_ns // 2, stamps[-1], spacing_ns)
    return [(start, SWERVE * rng.uniform(-1, 2, 5)) for start in starts]


def told(tracker, commands):
    for command in commands:
        tracker.command(*command)
    return tracker


def predicted(tracker, stamp):
    """Return the track at a frame that says next to nothing."""
    return tracker.update(stamp, STATION, 1e7 * np.eye(5))


@pytest.mark.parametrize("seed", range(3))
def test_commands_give_the_textbook_filters_track(seed):
    rng = np.random.default_rng(100 + seed)
    frames = list(zip(*scattered(seed), strict=True))
    # Until the newest command the buffer holds all: what comes too late is replayed with its own.
    tracker = Tracker(dataclasses.replace(OPEN, buffer_s=10.0))
    commands = swerves([frames[0][0], frames[-1][0] + 5 * TENTH_NS], rng)
    told(tracker, commands)
    textbook = Textbook(frames[0], np.diag(RATE_STD**2), WALK, commands)
    for frame in frames[1:]:
        textbook.take(*frame)
    track = fed(tracker, *frames[:4], *frames[5:], frames[4])
    np.testing.assert_allclose(track.pose, textbook.mean[:5], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(track.rate, textbook.rate(), rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(track.joint_covariance, textbook.covariance, rtol=1e-8, atol=1e-11)
    np.testing.assert_array_equal(track.covariance, track.joint_covariance[:5, :5])
    assert (track.stamp_ns, track.frames) == (textbook.stamp, len(frames))


def test_a_follower_on_station_learns_the_leaders_turn_from_its_own():
    # Abeam at 0.36 m/s and turning by 0.06 rad/s it stays in place, so the leader turns too.
    abeam = np.array([0.0, -0.36, 0.0, 0.0, 0.06])
    tracker = Tracker(dataclasses.replace(OPEN, command_timeout_s=60.0))
    tracker.command(START_NS, abeam)
    at = np.array([-6.0, 0, 0, 0, 0])
    track = fed(tracker, *steady(100, at))
    np.testing.assert_allclose(track.rate, 0.0, atol=1e-4)
    # When it stops, it is left behind at the rate it moved with.
    tracker.command(track.stamp_ns, np.zeros(5))
    ahead = predicted(tracker, track.stamp_ns + TENTH_NS)
    np.testing.assert_allclose(ahead.rate, -abeam, atol=1e-4)
    np.testing.assert_allclose(ahead.pose, at - 0.1 * abeam, atol=1e-4)


def test_errors_are_as_large_as_the_track_says_when_the_follower_moves_by_command():
    rng = np.random.default_rng(77)
    root, squares = np.linalg.cholesky(CORRELATED), []
    for _ in range(50):
        tracker, twist = Tracker(OPEN), np.zeros(5)
        state = np.concatenate([STATION, RATE_STD * rng.standard_normal(5)])
        for k in range(20):
            stamp = START_NS + k * TENTH_NS
            if k:
                before = state
                transition, noise = van_loan(0.1, swung(before, WALK))
                state = transition @ state + np.linalg.cholesky(noise) @ rng.standard_normal(10)
                state[:5] += turned(before[:5], twist) * 0.1
            twist = SWERVE * rng.uniform(-1, 2, 5)
            tracker.command(stamp, twist)
            seen = state[:5] + root @ rng.standard_normal(5)
            track = tracker.update(stamp, seen, CORRELATED)
        rate = state[5:] + turned(state[:5], twist)
        off = np.concatenate([track.pose - state[:5], track.rate - rate])
        squares.append(off @ np.linalg.solve(track.joint_covariance, off))
    low, high = chi2.ppf([0.0005, 0.9995], 10 * len(squares))
    assert low < sum(squares) < high


def test_where_commands_begin_and_end_the_rate_is_as_unknown_as_at_a_start():
    frames = list(zip(*scattered(5), strict=True))
    timeout_ns = round(OPEN.command_timeout_s * 1e9)
    start = np.diag(RATE_STD**2)
    for later_ns, said in ((-1, "not told"), (0, "told"), (timeout_ns, "told")):
        tracker = Tracker(OPEN)
        track = fed(tracker, *frames)
        first_ns = track.stamp_ns + TENTH_NS
        tracker.command(first_ns, SWERVE)
        ahead = predicted(tracker, first_ns + later_ns)
        assert ahead.own_motion == said
        own = turned(ahead.pose, SWERVE) if said == "told" else 0.0
        np.testing.assert_allclose(ahead.rate, track.rate + own, rtol=1e-5)
        walk = swung(track.pose, WALK) if said == "told" else WALK
        grown = track.joint_covariance[5:, 5:] + (TENTH_NS + later_ns) * 1e-9 * walk
        grown = grown + start * (said == "told")
        np.testing.assert_allclose(ahead.joint_covariance[5:, 5:], grown, rtol=1e-5, atol=1e-7)
    # A frame that came while there were commands, and then none for too long.
    step_ns = timeout_ns + 1
    tracker = told(Tracker(OPEN), [(START_NS, SWERVE)])
    track = tracker.update(START_NS, STATION, NOISE)
    ahead = predicted(tracker, START_NS + step_ns)
    assert ahead.own_motion == "not told"
    grown = track.joint_covariance[5:, 5:] + step_ns * 1e-9 * WALK + start
    np.testing.assert_allclose(ahead.joint_covariance[5:, 5:], grown, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(ahead.pose, track.pose, atol=1e-6)


def test_a_follower_that_does_not_obey_is_tracked_nevertheless():
    rng = np.random.default_rng(4)
    spread = np.diag([0.03, 0.02, 0.02, 0.01, 0.01]) ** 2
    tracker, pose, squares = Tracker(TrackerSettings()), STATION.copy(), []
    for k in range(300):
        stamp, seconds = START_NS + k * TENTH_NS, k / 10
        # Its pilot holds it for 4 s; then it gathers speed.
        surge = 0.0 if 10 <= seconds < 14 else min(0.5, 0.3 * max(seconds - 14, 0))
        pose[0] += 0.1 * (surge - 0.02)
        tracker.command(stamp, [0.5 if seconds >= 10 else 0.0, 0.0, 0.0, 0.0, 0.0])
        with contextlib.suppress(Outlier):
            noise = np.linalg.cholesky(spread) @ rng.standard_normal(5)
            squares.append(squared_error(tracker.update(stamp, pose + noise, spread), pose))
    assert len(squares) > 297
    assert max(squares) < chi2.isf(2 * norm.sf(6), 5)


def test_a_follower_whose_commands_are_of_other_units_is_tracked_as_if_there_were_none():
    wrong, stamps = [9.0, 0.0, 0.0, 0.0, 3.0], [stamp for stamp, *_ in steady(20)]
    pace = turned(STATION, [0.4, 0, 0, 0, 0.05])
    frames = [(stamp, STATION + 0.1 * k * pace, FINE) for k, stamp in enumerate(stamps)]
    told, alone = Tracker(TrackerSettings()), Tracker(TrackerSettings())
    said = []
    for stamp, *rest in frames[:15]:
        track, beside = told.update(stamp, *rest), alone.update(stamp, *rest)
        said.append(track.own_motion)
        told.command(stamp, wrong)
    assert said == ["not told"] + ["contradicted"] * 14
    assert_same(dataclasses.replace(track, own_motion="not told"), beside)
    # So it does in a track that starts anew.
    late = stamps[14] + 2_100_000_000
    told.command(late - 1, wrong)
    anew = told.update(late, STATION, FINE)
    assert (anew.frames, anew.own_motion) == (1, "contradicted")
    np.testing.assert_array_equal(anew.rate, np.zeros(5))


def test_a_track_found_elsewhere_is_followed_though_commands_are_of_other_units():
    wrong, tracker, answers = [9.0, 0.0, 0.0, 0.0, 3.0], Tracker(TrackerSettings()), []
    for k, (stamp, *_) in enumerate(steady(20)):
        answers.append(answer(tracker, (stamp, moved(Y, 4.0 * (k >= 10)), FINE)))
        tracker.command(stamp, wrong)
    elsewhere = TrackerSettings().reacquire_frames - 1
    assert [isinstance(each, str) for each in answers[10:]] == [True] * elsewhere + [False] * (
        10 - elsewhere
    )
    assert answers[-1].own_motion == "contradicted"


def test_a_follower_that_obeys_again_is_told_again():
    tracker, at, said = Tracker(TrackerSettings()), STATION.copy(), []
    for k, (stamp, *_) in enumerate(steady(40)):
        said.append(tracker.update(stamp, at, FINE).own_motion)
        tracker.command(stamp, [9.0, 0, 0, 0, 0] if k < 20 else [0.3, 0, 0, 0, 0])
        at = at + (0.1 * turned(at, [0.3, 0, 0, 0, 0]) if k >= 20 else 0.0)
    assert said[1:21] == ["contradicted"] * 20
    assert set(said[25:]) == {"told"}


@settings(max_examples=20)
@given(st.permutations(range(10)), st.integers(0, 2**32))
def test_frames_out_of_order_move_by_the_commands_of_their_own_time(order, seed):
    rng = np.random.default_rng(seed)
    frames = list(zip(*scattered(seed, 10), strict=True))
    options = TrackerSettings(buffer_s=10.0, reset_after_s=1.0, reacquire_frames=2)
    commands = swerves([frames[0][0], frames[-1][0]], rng)
    in_order, as_they_come = Tracker(options), told(Tracker(options), commands)
    # One hears of each command when it is given, the other of all before any frame.
    for frame in frames:
        told(in_order, [command for command in commands if command[0] <= frame[0]])
        with contextlib.suppress(Outlier):
            in_order.update(*frame)
    told(in_order, commands)
    for k in order:
        with contextlib.suppress(Outlier):
            as_they_come.update(*frames[k])
    assert_same_state(in_order, as_they_come, frames[-1][0])


def test_commands_of_long_ago_are_dropped_without_a_trace():
    rng = np.random.default_rng(8)
    options = TrackerSettings(reset_after_s=0.3, buffer_s=0.2)
    short, whole = Tracker(options), Tracker(dataclasses.replace(options, buffer_s=10.0))
    for k in range(50):
        stamp = START_NS + k * TENTH_NS
        for tenth in range(10):
            twist = SWERVE * rng.uniform(-1, 2, 5)
            told(short, [(stamp + tenth * TENTH_NS // 10, twist)])
            told(whole, [(stamp + tenth * TENTH_NS // 10, twist)])
        # A frame each 0.2 s comes 0.05 s late, and every other gap is filled later still.
        if k % 2 == 0:
            frame = stamp - TENTH_NS // 2, STATION, NOISE
            assert_same(short.update(*frame), whole.update(*frame))
        elif k % 4 == 3:
            frame = stamp - 5 * TENTH_NS // 2, STATION, NOISE
            assert_same(short.update(*frame), whole.update(*frame))


def test_a_turn_by_command_across_half_a_circle_is_wrapped():
    tracker, turning = Tracker(OPEN), np.array([0, 0, 0, 0, 0.5])
    tracker.command(START_NS, turning)
    tracker.update(START_NS, [*STATION[:4], math.pi - 0.01], NOISE)
    assert predicted(tracker, START_NS + TENTH_NS).pose[4] == pytest.approx(-math.pi + 0.04)


def test_there_is_no_track_without_a_frame():
    with pytest.raises(NoPose, match=r"^no track: there is no frame yet"):
        Tracker(TrackerSettings()).track()


def test_a_bad_command_is_refused_and_leaves_no_trace():
    tracker, untouched = (told(Tracker(OPEN), [(START_NS, SWERVE)]) for _ in range(2))
    with pytest.raises(ValueError, match=r"^twist: .*nan.*; give three within"):
        tracker.command(START_NS, [np.nan, 0, 0, 0, 0])
    frames = [(stamp, STATION + STD, NOISE) for stamp, *_ in steady(4)]
    assert_same(fed(tracker, *frames), fed(untouched, *frames))
