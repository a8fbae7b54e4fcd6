"""What the track does with gaps, strays and jumps, and what it refuses."""

import math

import numpy as np
import pytest
from tracks import (
    GATE,
    NOISE,
    START_NS,
    STATION,
    STD,
    TENTH_NS,
    assert_same,
    fed,
    motion,
    moved,
    steady,
)

from uuv_optical_array.core.geometry import X, Y, Z
from uuv_optical_array.estimation.tracking.filter import MANOEUVRE_STD
from uuv_optical_array.estimation.tracking.motion import RATE_STD
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import Tracker

pytestmark = pytest.mark.filterwarnings("error")


def assert_anew(track, pose):
    assert (track.frames, track.distance) == (1, 0.0)
    np.testing.assert_array_equal(track.pose, pose)
    np.testing.assert_array_equal(track.rate, 0.0)
    np.testing.assert_allclose(track.covariance, NOISE, rtol=1e-12, atol=1e-15)


def test_after_a_gap_the_track_starts_anew_and_up_to_it_goes_on():
    frames = steady(5)
    elsewhere = STATION + 3.0
    for gap_ns in (1, 2_000_000_000):
        track = fed(Tracker(TrackerSettings()), *frames, (frames[-1][0] + gap_ns, STATION, NOISE))
        assert track.frames == 6
    late = (frames[-1][0] + 2_000_000_001, elsewhere, NOISE)
    assert_anew(fed(Tracker(TrackerSettings()), *frames, late), elsewhere)


def test_a_clock_that_was_set_back_starts_anew():
    tracker = Tracker(TrackerSettings())
    frames = steady(5)
    fed(tracker, *frames)
    elsewhere = STATION + 3.0
    again = frames[-1][0] - 2_500_000_001
    assert_anew(tracker.update(again, elsewhere, NOISE), elsewhere)
    # Nothing of the former time is left to be in its way.
    assert fed(tracker, *steady(40, elsewhere, again + TENTH_NS)).frames == 41


def test_a_stray_stamp_from_the_future_costs_no_more_than_the_track():
    tracker = Tracker(TrackerSettings())
    fed(tracker, *steady(5))
    tracker.update(START_NS + 10**18, STATION, NOISE)
    assert fed(tracker, *steady(5, start_ns=START_NS + 5 * TENTH_NS)).frames == 5


def test_an_outlier_is_refused_with_its_distance_and_the_track_goes_on_without_it():
    tracker, without = Tracker(TrackerSettings()), Tracker(TrackerSettings())
    *frames, stray, after = steady(12)
    fed(tracker, *frames)
    fed(without, *frames)
    with pytest.raises(Outlier) as refused:
        tracker.update(stray[0], moved(Z, 3.0), NOISE)
    kind, _, figures = str(refused.value).partition(": ")
    distance, bound = (float(word) for word in figures.split() if word[0].isdigit())
    assert kind == "outlier"
    assert bound == pytest.approx(GATE, rel=1e-2)
    assert 3.0 / (1.5 * STD[2]) < distance < 3.0 / STD[2]
    track = tracker.update(*after)
    assert track.frames == 11
    assert_same(track, without.update(*after))


def test_the_gate_lets_pass_what_lies_within_and_refuses_what_lies_beyond():
    # The first frame's rate is uncertain; both spreads are diagonal, so x alone sets the distance.
    options = TrackerSettings(common_share=0.0)
    _, noise = motion(0.1, options)
    rate = np.hypot(RATE_STD[0], MANOEUVRE_STD[0])
    spread = 2 * STD[0] ** 2 + (rate * 0.1) ** 2 + noise[0, 0]
    edge = GATE * math.sqrt(spread)
    for off, refused in ((0.999 * edge, False), (1.001 * edge, True)):
        tracker = Tracker(options)
        tracker.update(START_NS, STATION, NOISE)
        second = START_NS + TENTH_NS, moved(X, off), NOISE
        if refused:
            with pytest.raises(Outlier):
                tracker.update(*second)
        else:
            assert tracker.update(*second).frames == 2


@pytest.mark.parametrize("frames", [2, 5])
def test_a_jump_that_persists_is_the_track_at_the_frame_that_was_promised(frames):
    tracker = Tracker(TrackerSettings(reacquire_frames=frames))
    fed(tracker, *steady(10))
    there = moved(Y, 4.0)
    *first, last = steady(frames, there, START_NS + 10 * TENTH_NS)
    for frame in first:
        with pytest.raises(Outlier):
            tracker.update(*frame)
    track = tracker.update(*last)
    # That is one of its own, which knows nothing of the one before.
    assert_same(track, fed(Tracker(TrackerSettings()), last))


def test_outliers_that_do_not_last_are_never_the_track():
    tracker = Tracker(TrackerSettings(reacquire_frames=3))
    fed(tracker, *steady(10))
    offs = [4, -4, 0, 4, 4, 0, -4, 0, 4, 4, 0]  # never three in a row
    for k, off in enumerate(offs):
        frame = START_NS + (10 + k) * TENTH_NS, moved(Y, off), NOISE
        if off:
            with pytest.raises(Outlier):
                tracker.update(*frame)
        else:
            np.testing.assert_allclose(tracker.update(*frame).pose, STATION, atol=1e-9)


def with_entry(matrix, value, *places):
    changed = np.array(matrix, dtype=float)
    for place in places:
        changed[place] = value
    return changed


@pytest.mark.parametrize(
    ("pose", "covariance", "message"),
    [
        (STATION[:4], NOISE, r"^pose: .*five numbers"),
        (with_entry(STATION, np.nan, 4), NOISE, r"^pose: .*nan.*within \+-1e\+06"),
        (with_entry(STATION, -np.inf, 0), NOISE, r"^pose: .*-inf"),
        (with_entry(STATION, 1.1e6, 1), NOISE, r"^pose: .*1100000\.0.*within \+-1e\+06"),
        (STATION, NOISE[:4, :4], r"^covariance: .*give 5 x 5"),
        (STATION, np.eye(6), r"^covariance: .*give 5 x 5"),
        (STATION, 1.0, r"^covariance: 1\.0; give 5 x 5"),
        (STATION, with_entry(NOISE, np.nan, (1, 4), (4, 1)), r"^covariance: .*nan.*finite"),
        (STATION, with_entry(NOISE, np.inf, (2, 2)), r"^covariance: .*inf.*finite"),
        (STATION, with_entry(NOISE, 0.01, (1, 4)), r"^covariance: .*not symmetric; give \(C"),
        (STATION, np.zeros((5, 5)), r"eigenvalues are 0 to 0; give a positive definite"),
        (STATION, with_entry(NOISE, -1.0, (3, 3)), r"eigenvalues are -1 to .*positive definite"),
        (STATION, with_entry(NOISE, 0.5, (0, 1), (1, 0)), r"eigenvalues are -0\.4"),
        (STATION, np.diag([1, 1, 1, 1, 1e-11]), r"1e-11 to 1; .* ratio of 1e\+10"),
        (STATION, 1e9 * np.eye(5), r"from 1e-12 to 1e\+08"),
    ],
)
def test_a_bad_measurement_is_refused_with_value_bound_and_cure_and_leaves_no_trace(
    pose, covariance, message
):
    tracker, untouched = Tracker(TrackerSettings()), Tracker(TrackerSettings())
    *frames, probe = steady(6)
    fed(tracker, *frames)
    fed(untouched, *frames)
    with np.errstate(all="raise"), pytest.raises(ValueError, match=message):
        tracker.update(probe[0], pose, covariance)
    assert_same(tracker.update(*probe), untouched.update(*probe))
