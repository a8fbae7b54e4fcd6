"""What lasts in the residuals of many frames is found and named, and nothing where nothing does."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space

from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.mismatch import Alarm
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import Constants

SIDE, GAIN_STD, STDS = 5, 0.005, np.array([0.1, 5.0])
NAMES = ("lamp.power", "ambient.level_counts")
CONSTANTS = Constants(NAMES, tuple(STDS), GAIN_STD, SIDE**2)


def watched(rng, seconds, beyond=lambda light, time_s: 0.0, constants=CONSTANTS, pause_s=0.0):
    """Return the tests of frames at 10 Hz whose poses are off and whose constants are drawn.

    No frames come for `pause_s` after 30 s.
    """
    found, texts = Alarm(constants), []
    offsets, gains = STDS * rng.standard_normal(2), GAIN_STD * rng.standard_normal(SIDE**2)
    for k in range(round(10 * seconds)):
        light = rng.uniform(100, 900, SIDE**2)
        of_pose = light[:, None] * rng.standard_normal((SIDE**2, 5))
        of_constants = np.column_stack([light, np.ones(SIDE**2)])
        slopes = np.hstack([of_pose, of_constants])
        at = np.concatenate([rng.standard_normal(5), STDS * rng.standard_normal(2)])
        residuals = (
            of_pose @ (0.01 * rng.standard_normal(5))
            + of_constants @ (offsets - at[5:])
            + light * gains
            + beyond(light, k / 10)
            + rng.standard_normal(SIDE**2)
        )
        frame = LinearisedReadings(at, residuals, slopes, light, np.ones(SIDE**2))
        found.add(10**18 + k * 10**8 + round(pause_s * 1e9) * (k > 300), False, frame)
        texts.append(found.said)
    return found, texts


@pytest.mark.parametrize("seed", range(5))
def test_frames_of_the_scene_raise_no_alarm(seed):
    _, texts = watched(np.random.default_rng(seed), 70)
    assert set(texts) == {""}


def one_detector(light, time_s):
    return -0.05 * light * (np.arange(SIDE**2) == 8)


@pytest.mark.parametrize(
    ("beyond", "what", "size"),
    [
        (one_detector, "the detector of row 1, column 3", -0.05),
        (lambda light, time_s: 0.06 * light * np.eye(5)[2].repeat(5), "the row 2", 0.06),
        (lambda light, time_s: 0.06 * light * np.tile(np.eye(5)[4], 5), "the column 4", 0.06),
        (lambda light, time_s: -0.01 * time_s * light, "lamp.power with time", -0.01),
        (lambda light, time_s: np.full(25, 60.0), "ambient.level_counts", 60.0),
    ],
)
def test_what_lasts_is_named_with_its_size(beyond, what, size):
    found, texts = watched(np.random.default_rng(3), 25, beyond)
    assert found.said.startswith(what)
    said = float(found.said.partition("off by ")[2].partition(" (")[0])
    assert said == pytest.approx(size, rel=0.3)
    assert texts[10] == ""  # not of a second alone


@pytest.mark.parametrize("bent", [False, True])
def test_images_that_bend_over_what_each_leaves_of_the_pose_are_not_tested(bent):
    rng, tracker = np.random.default_rng(3), Tracker(TrackerSettings(), CONSTANTS)
    at = np.array([-5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for k in range(50):
        light = rng.uniform(100, 900, SIDE**2)
        slopes = light[:, None] * np.hstack([rng.standard_normal((SIDE**2, 5)), np.zeros((25, 2))])
        residuals = 0.6 * one_detector(light, 0.0) + rng.standard_normal(SIDE**2)
        frame = LinearisedReadings(at, residuals, slopes, light, np.ones(SIDE**2))
        readings = None if bent and k else frame

        def near(place, of=frame):
            return of._replace(at=place, residuals=of.residuals + of.slopes @ (of.at - place))

        track = tracker.update(10**18 + k * 10**8, at[:5], 1e-4 * np.eye(5), readings, near)
    assert track.frames == 50
    what, _, _ = track.mismatch.partition(" is off by ")
    assert what == ("" if bent else "the detector of row 1, column 3")


def test_a_scene_that_names_shades_is_not_tested():
    cloudy = replace(CONSTANTS, unclear_lasts_s=5.0, names_shades=True)
    for constants, tested in ((CONSTANTS, True), (cloudy, False)):
        found, _ = watched(np.random.default_rng(3), 5, one_detector, constants)
        assert (found.said != "") == tested


def test_an_alarm_ends_with_the_first_two_windows_that_have_none():
    def at_first(light, time_s):
        return one_detector(light, time_s) * (time_s < 20)

    _, texts = watched(np.random.default_rng(3), 95, at_first)
    assert texts[200].startswith("the detector of row 1, column 3")
    assert texts[-1] == ""


@pytest.mark.parametrize(("pause_s", "named"), [(0.0, True), (40.0, False)])
def test_a_slow_change_is_named_by_a_window_with_the_one_before_where_that_was_just_then(
    pause_s, named
):
    def fades(light, time_s):
        return -8e-6 * (time_s + pause_s * (time_s > 30)) * light  # 3 standard deviations in 30 s

    _, texts = watched(np.random.default_rng(3), 59, fades, pause_s=pause_s)
    assert set(texts[:300]) == {""}
    what, _, size = texts[-1].partition(" is off by ")
    assert what == ("lamp.power with time, per s," if named else "")
    if named:
        assert float(size.partition(" (")[0]) == pytest.approx(-8e-6, rel=0.4)  # 5 of its stds


def test_of_a_large_array_seven_by_seven_detectors_are_tested():
    rng, constants = np.random.default_rng(3), replace(CONSTANTS, detectors=21**2)
    found = Alarm(constants)
    gains = GAIN_STD * rng.standard_normal(21**2)
    gains[21 * 7 + 13] = -0.05  # in the third row and fifth column of those chosen
    for k in range(25):
        light = rng.uniform(100, 900, 21**2)
        slopes = np.column_stack([light[:, None] * rng.standard_normal((21**2, 5)), light, light])
        residuals = light * gains + rng.standard_normal(21**2)
        frame = LinearisedReadings(np.zeros(7), residuals, slopes, light, np.ones(21**2))
        found.add(10**18 + k * 10**8, False, frame)
    assert found.said.startswith("the detector of row 7, column 13 is off by -0.05")


def test_the_size_is_that_of_least_squares_of_all_readings_together():
    rng, frames = np.random.default_rng(5), 21
    found = Alarm(CONSTANTS)
    size = 2 + SIDE**2
    stds = np.array([*STDS, *[GAIN_STD] * SIDE**2])
    far = np.zeros(size)
    far[1] = 12.0  # of the ambient
    rows, left = [], []
    for k in range(frames):
        light = rng.uniform(100, 900, SIDE**2)
        of_pose = light[:, None] * rng.standard_normal((SIDE**2, 5))
        by_errors = np.hstack([light[:, None], np.ones((SIDE**2, 1)), np.diag(light)])
        residuals = by_errors @ (stds * far) + rng.standard_normal(SIDE**2)
        slopes = np.hstack([of_pose, by_errors[:, :2]])
        frame = LinearisedReadings(np.zeros(7), residuals, slopes, light, np.ones(SIDE**2))
        found.add(10**18 + k * 10**8, False, frame)
        no_pose = null_space(of_pose.T).T
        rows.append(no_pose @ by_errors * stds)
        left.append(no_pose @ residuals)
    rows, left = np.vstack(rows), np.concatenate(left)
    # All readings are Gaussian, of the covariance I + rows rows'; the ambient is off besides.
    weighed = np.linalg.solve(np.eye(len(rows)) + rows @ rows.T, rows[:, 1])
    size = weighed @ left / (weighed @ rows[:, 1])
    assert found.said.startswith(f"ambient.level_counts is off by {STDS[1] * size:+.2g}")


def test_uneven_light_that_stays_is_named_soon_at_the_start_and_later_in_half_a_minute():
    tracker = Tracker(TrackerSettings(), Constants(unclear_lasts_s=5.0, uneven=0.02))

    def said(seconds, shaded):
        stamp_ns = 10**18 + round(seconds * 10**9)
        pose = [-6.0, 0.0, 0.0, 0.0, 0.0]
        return tracker.update(stamp_ns, pose, 0.01 * np.eye(5), shaded=shaded).mismatch

    named = "the evenness of the light is off in most frames of 30 s, or since the first"
    # Two thirds of three seconds.
    assert not any(said(k / 2, 0.9) for k in range(4))
    assert said(2.0, 0.9) == named
    assert not any(said(2.5 + k / 2, 0.1) for k in range(2, 44))
    # After clear frames their share grows as 1 - exp(-t / 30 s), in a young track, too.
    assert not any(said(24.5 + k / 2, 0.9) for k in range(40))
    assert not any(said(44.5 + k / 2, 0.1) for k in range(600))
    assert not any(said(344.5 + k / 2, 0.9) for k in range(65))  # 30 s * log(3)
    assert said(377.5, 0.9) == named
    assert not any(said(379 + k, 0.1 if k % 2 else 0.9) for k in range(1, 60))
