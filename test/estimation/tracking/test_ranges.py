"""Ranges from elsewhere in a track: against closed forms, and those that are wrong or late."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from tracks import NOISE, OPEN, START_NS, STATION, TENTH_NS, assert_same, moved, steady

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import StampRefused
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import Constants
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import uniform_poses

pytestmark = pytest.mark.filterwarnings("error")

SECOND_NS = 10 * TENTH_NS
RANGE_STD = 0.12
RANGE = float(np.linalg.norm(STATION[:3]))
ALONG = np.array([*STATION[:3], 0, 0]) / RANGE
ONE = Constants(("ambient.level_counts",), (0.1,))  # in which the light is linear
# Between frames 5 s apart the pose may be anywhere: the motion says nothing of it.
FREE = dataclasses.replace(
    OPEN,
    velocity_walk_m_per_s=10.0,
    turn_walk_deg_per_s=500.0,
    reset_after_s=60.0,
    command_timeout_s=60.0,
    buffer_s=10.0,
    constants_hold_s=1e7,
)
GATED = dataclasses.replace(FREE, gate_probability=0.9999)


def fused(mean, covariance, by_state, off, variance):
    """Return mean and covariance after a number, as textbooks have it."""
    gain = covariance @ by_state / (by_state @ covariance @ by_state + variance)
    return mean + gain * off, covariance - np.outer(gain, by_state @ covariance)


def along(track):
    """Return the standard deviation of a track along the line of sight, m."""
    sight = track.pose[:3] / np.linalg.norm(track.pose[:3])
    return math.sqrt(sight @ track.covariance[:3, :3] @ sight)


def test_the_bound_of_one_frame_of_the_default_scene_falls_from_0_283_to_0_107_m():
    """As published for the scene: RMS along x over the volume; informations add up."""
    poses = uniform_poses(4000, np.random.default_rng(4))
    bound = cramer_rao_bound(ForwardModel(load_scene("follow")), poses)
    sight = np.zeros_like(poses)
    sight[:, :3] = poses[:, :3] / np.linalg.norm(poses[:, :3], axis=1, keepdims=True)
    both = np.linalg.inv(bound.information + sight[..., None] * sight[:, None] / RANGE_STD**2)
    assert np.sqrt(bound.covariance[:, 0, 0].mean()) == pytest.approx(0.283, abs=0.01)
    assert np.sqrt(both[:, 0, 0].mean()) == pytest.approx(0.107, abs=0.001)


def test_a_track_reaches_that_with_its_first_range_and_errs_by_no_more(compiled_fit):
    rng = np.random.default_rng(4)
    estimator = Estimator(load_scene("follow")).wait()
    model, constants = ForwardModel(estimator.scene), estimator.constants
    stds, errors, pipeline = [], [], Pipeline(estimator)
    for pose in uniform_poses(200, rng):
        offsets = {
            name: np.array(std * rng.standard_normal())
            for name, std in zip(constants.names, constants.stds, strict=True)
        }
        pipeline.track_with(TrackerSettings())
        image = model.read(model.light(pose, 0.0, offsets), rng)
        estimate = pipeline.estimate(START_NS, image)
        alone, true = pipeline.track(), np.linalg.norm(pose[:3])
        pipeline.range(START_NS, true + RANGE_STD * rng.standard_normal(), RANGE_STD)
        both = pipeline.track()
        # A part of the error of a pose is that of all frames.
        if estimate.readings is None or estimate.bent:
            assert along(both) < along(alone)
            continue
        stds.append((along(alone), along(both)))
        errors.append((np.linalg.norm(both.pose[:3]) - true) / along(both))
    of_image, of_both = np.transpose(stds)
    np.testing.assert_allclose(of_both, (of_image**-2 + RANGE_STD**-2) ** -0.5, rtol=0.05)
    count = len(errors)
    assert count > 100
    assert abs(np.sum(np.square(errors)) - count) < 5 * math.sqrt(2 * count)


def linear_frames(count, rng, truth, gap_ns, step_m=0.0, alike=True):
    """Return stamps and readings of light that is linear in the pose and in one constant.

    Where it is alike, the constant looks as x does, so that images hardly tell the two apart.
    """
    found = []
    for k in range(count):
        pose = moved(0, k * step_m)
        at = np.array([*pose, 0.0]) + 0.05 * rng.standard_normal(6)
        slopes = rng.standard_normal((9, 6)) * [20, 20, 20, 50, 50, 90]
        if alike:
            slopes[:, 5] = 3 * slopes[:, 0] + slopes[:, 5] / 500
        residuals = slopes @ (np.array([*pose, truth]) - at) + rng.standard_normal(9)
        readings = LinearisedReadings(at, residuals, slopes, np.full(9, 10.0), np.ones(9))
        found.append((START_NS + k * gap_ns, readings))
    return found


def fed(tracker, frames):
    for stamp_ns, readings in frames:
        track = tracker.update(stamp_ns, readings.at[:5], NOISE, readings)
    return track


@pytest.mark.parametrize("alike", [False, True])
@pytest.mark.parametrize("count", [1, 3])
def test_pose_and_constants_are_those_of_one_regression_of_frames_and_range(count, alike):
    """The range is of the first frame, and what it teaches of the constant holds for the last."""
    frames = linear_frames(count, np.random.default_rng(count), 0.13, 5 * SECOND_NS, 1.0, alike)
    tracker = Tracker(FREE, ONE)
    tracker.command(START_NS, [0.2, 0, 0, 0, 0])  # each frame is expected at a place of its own
    place = fed(tracker, frames[:1]).pose
    measured = RANGE + 0.1
    tracker.range(START_NS, measured, RANGE_STD)
    track = fed(tracker, frames[1:]) if count > 1 else tracker.track()
    size = 5 * count + 1  # poses, then the constant
    sight = np.zeros(size)
    sight[:3] = place[:3] / np.linalg.norm(place[:3])
    rows = [np.eye(size)[-1] / 0.1, sight / RANGE_STD]
    off = measured - np.linalg.norm(place[:3]) + sight[:3] @ place[:3]
    values = [0.0, off / RANGE_STD]
    for k, (_, readings) in enumerate(frames):
        row = np.zeros((9, size))
        row[:, 5 * k : 5 * k + 5], row[:, -1] = readings.slopes[:, :5], readings.slopes[:, 5]
        rows.extend(row)
        values.extend(readings.residuals + readings.slopes @ readings.at)
    rows, values = np.array(rows), np.array(values)
    spread = np.linalg.inv(rows.T @ rows)
    mean, last = spread @ rows.T @ values, slice(5 * count - 5, 5 * count)
    stds = np.sqrt(spread.diagonal())
    np.testing.assert_allclose((track.pose - mean[last]) / stds[last], 0.0, atol=1e-3)
    np.testing.assert_allclose(np.sqrt(track.covariance.diagonal()), stds[last], rtol=1e-3)
    learnt = track.constants["ambient.level_counts"]
    assert learnt.std == pytest.approx(stds[-1], rel=1e-3)
    assert learnt.mean == pytest.approx(mean[-1], abs=1e-3 * stds[-1])


@pytest.mark.parametrize("ago_ns", [0, 3 * TENTH_NS])
@pytest.mark.parametrize("commanded", [False, True])
def test_a_range_is_of_where_the_follower_was_at_its_stamp(ago_ns, commanded):
    settings = dataclasses.replace(OPEN, common_share=0.2, command_timeout_s=60.0, buffer_s=5.0)
    pair = Tracker(settings), Tracker(settings)
    frames = [(START_NS + 4 * k * TENTH_NS, moved(0, 0.4 * k), NOISE) for k in range(4)]
    stamp_ns = frames[-1][0] - ago_ns
    for tracker in pair:
        if commanded:
            tracker.command(START_NS - TENTH_NS, [0.7, 0, 0, 0, 0])
        for frame in frames[:-1]:
            tracker.update(*frame)
    pair[1].range(stamp_ns, RANGE - 1.5, RANGE_STD)
    before, after = (tracker.update(*frames[-1]) for tracker in pair)
    assert before.own_motion == ("told" if commanded else "not told")
    ago_s = ago_ns * 1e-9
    was = before.pose[:3] - ago_s * before.rate[:3]
    sight = was / np.linalg.norm(was)
    by_state = np.concatenate([sight, [0, 0], -ago_s * sight, [0, 0]])
    state, off = np.concatenate([before.pose, before.rate]), RANGE - 1.5 - np.linalg.norm(was)
    # What all frames share of their errors is no range's to correct, and widens what to expect.
    common = np.zeros((10, 10))
    common[:5, :5] = 0.2 * NOISE
    noise = RANGE_STD**2 + sight @ common[:3, :3] @ sight
    mean, covariance = fused(state, before.joint_covariance - common, by_state, off, noise)
    # The lever arm of the leader's turns is that of where the range has moved the follower to.
    atol = 1e-4 if commanded else 1e-6
    np.testing.assert_allclose(np.concatenate([after.pose, after.rate]), mean, atol=atol)
    np.testing.assert_allclose(after.joint_covariance, covariance + common, atol=atol)
    spread = by_state @ before.joint_covariance @ by_state + RANGE_STD**2
    assert after.range.off_m == pytest.approx(off, abs=1e-9)
    assert after.range.std_m == pytest.approx(math.sqrt(spread), rel=1e-9)


def in_a_steady_sea(ranges, count, gap_ns=SECOND_NS, std_m=RANGE_STD):
    """Return the track after each frame from one place, each with the range of its second."""
    tracker, tracks = Tracker(GATED, ONE), []
    frames = linear_frames(count, np.random.default_rng(6), 0.1, gap_ns)
    for frame, range_m in itertools.zip_longest(frames, ranges):
        fed(tracker, [frame])
        if range_m is not None:
            tracker.range(frame[0], range_m, std_m)
        tracks.append(tracker.track())
    return tracks


@pytest.mark.parametrize("gap_ns", [SECOND_NS // 5, 2 * SECOND_NS])
def test_no_number_of_ranges_knows_more_than_what_they_share_of_their_errors(gap_ns):
    ranged = in_a_steady_sea([RANGE + 0.15] * 120, 120, gap_ns)
    alone = in_a_steady_sea([], 120, gap_ns)
    for before, after in zip(alone, ranged, strict=True):
        assert along(after) > 0.99 * (along(before) ** -2 + 2 * RANGE_STD**-2) ** -0.5


FALSE = [RANGE + 3.0, RANGE - 3.0, 0.0, -RANGE, math.nan, math.inf, 2e4]


@pytest.mark.parametrize("range_m", FALSE)
def test_a_false_range_changes_nothing(range_m):
    pair = Tracker(GATED, ONE), Tracker(GATED, ONE)
    frames = linear_frames(8, np.random.default_rng(2), 0.1, TENTH_NS)
    for k, frame in enumerate(frames):
        tracks = [fed(tracker, [frame]) for tracker in pair]
        for tracker in pair if k % 3 == 0 else ():
            tracker.range(frame[0], RANGE + 0.05, RANGE_STD)
        if k % 3 == 1:
            if range_m in (RANGE + 3.0, RANGE - 3.0):
                pair[1].range(frame[0], range_m, RANGE_STD)
                use = pair[1].track().range
                assert (use.stamp_ns, use.refused) == (frame[0], 1)
                assert use.off_m == pytest.approx(range_m - RANGE, abs=0.5)
            else:
                with pytest.raises(ValueError, match=f"range: {range_m:g} m; give from 0.001 to"):
                    pair[1].range(frame[0], range_m, RANGE_STD)
        tracks = [dataclasses.replace(tracker.track(), range=None) for tracker in pair]
        assert_same(*tracks)


@pytest.mark.parametrize("std_m", [0.0, -0.1, 1e-4, math.nan, math.inf])
def test_a_range_of_no_possible_error_is_refused(std_m):
    tracker = Tracker(FREE, ONE)
    fed(tracker, linear_frames(1, np.random.default_rng(2), 0.1, TENTH_NS))
    with pytest.raises(ValueError, match=r"range std: \S+ m; give from 0.001 to 1000"):
        tracker.range(START_NS, RANGE, std_m)


@pytest.mark.parametrize(
    ("after_s", "reason"),
    [
        (-1.3, "late range: 1.300 s older than the newest frame, more than buffer_s 0.5"),
        (3.0, "range without light: 3.000 s newer than the newest frame, more than reset_after_s"),
        (-0.2, "repeated range"),
    ],
)
def test_a_range_of_another_time_is_refused_and_changes_nothing(after_s, reason):
    pair = Tracker(TrackerSettings()), Tracker(TrackerSettings())
    frames = steady(40)
    for tracker in pair:
        for frame in frames[:20]:
            tracker.update(*frame)
        tracker.range(frames[17][0], RANGE, RANGE_STD)
    with pytest.raises(StampRefused, match=reason):
        pair[1].range(frames[19][0] + round(after_s * 1e9), RANGE - 0.2, RANGE_STD)
    for frame in frames[20:]:
        tracks = [tracker.update(*frame) for tracker in pair]
        assert_same(*tracks)


def test_a_late_range_enters_in_its_place_and_so_does_one_before_a_late_frame():
    frames = [(START_NS + k * TENTH_NS, moved(0, 0.1 * k), NOISE) for k in range(9)]
    stamp_ns = frames[5][0] - TENTH_NS // 3
    measured = stamp_ns, RANGE - 0.7, RANGE_STD
    events = [*frames[:5], measured, *frames[5:]]
    late_range = [*frames[:8], measured, frames[8]]
    late_frame = [*frames[:5], *frames[6:8], measured, frames[5], frames[8]]
    tracks = []
    for order in (events, late_range, late_frame, frames):
        tracker = Tracker(TrackerSettings())
        for event in order:
            (tracker.range if event is measured else tracker.take)(*event)
        tracks.append(tracker.track())
    assert_same(*tracks[:2])
    assert_same(tracks[0], tracks[2])
    assert abs(tracks[0].pose[0] - tracks[3].pose[0]) > 0.01


def test_a_range_alone_neither_starts_a_track_nor_keeps_one():
    tracker = Tracker(TrackerSettings())
    with pytest.raises(NoPose, match="range without light: there is no frame yet"):
        tracker.range(START_NS, RANGE, RANGE_STD)
    with pytest.raises(NoPose, match="no track"):
        tracker.track()
    tracker.update(START_NS, STATION, NOISE)
    for k in range(1, 21):
        tracker.range(START_NS + k * TENTH_NS, RANGE, RANGE_STD)
        assert tracker.track().stamp_ns == START_NS
    assert tracker.update(START_NS + 21 * TENTH_NS, STATION, NOISE).frames == 1


def test_right_ranges_that_a_false_one_made_outliers_are_used_again():
    false = RANGE + 0.7  # which the images alone allow
    tracks = in_a_steady_sea([false, *[RANGE] * 20], 21, std_m=0.05)
    errors = [abs(np.linalg.norm(track.pose[:3]) - RANGE) / along(track) for track in tracks]
    assert tracks[0].range.refused == 0
    assert errors[0] > 4
    assert [track.range.refused for track in tracks[1:7]] == [1, 2, 3, 4, 5, 0]
    assert max(errors[7:]) < 4


def test_what_ranges_taught_is_known_when_they_end():
    ranged, alone = in_a_steady_sea([RANGE] * 3, 60), in_a_steady_sea([], 60)
    assert along(ranged[-1]) < 0.6 * along(alone[-1])


def test_ranges_that_come_at_once_count_as_one():
    frames = linear_frames(1, np.random.default_rng(6), 0.1, SECOND_NS)
    stds = []
    for count in (1, 5):
        tracker = Tracker(GATED, ONE)
        fed(tracker, frames)
        for k in range(count):
            tracker.range(START_NS - 1000 * k, RANGE, RANGE_STD)
        stds.append(along(tracker.track()))
    assert stds[1] == pytest.approx(stds[0], rel=1e-3)


def test_a_first_range_that_is_false_is_the_first_that_is_refused():
    tracks = in_a_steady_sea([RANGE + 3.0] * 3, 3, std_m=0.05)
    assert [track.range.refused for track in tracks] == [1, 2, 3]
