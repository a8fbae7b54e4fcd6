"""What lasts in the residuals of many frames is found and named, and nothing where nothing does."""

from dataclasses import replace

import numpy as np
import pytest

from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.tracking.belief import BiasSpace, Learnt
from uuv_optical_array.estimation.tracking.mismatch import LastingResiduals
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
    found, texts = LastingResiduals(constants), []
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
        found.add(10**18 + k * 10**8 + round(pause_s * 1e9) * (k > 300), frame)
        texts.append(found.mismatch)
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
        (lambda light, time_s: -0.01 * time_s * light, "lamp.power with time", -0.01),
        (lambda light, time_s: np.full(25, 60.0), "ambient.level_counts", 60.0),
    ],
)
def test_what_lasts_is_named_with_its_size(beyond, what, size):
    found, texts = watched(np.random.default_rng(3), 25, beyond)
    assert found.mismatch.startswith(what)
    said = float(found.mismatch.partition("off by ")[2].partition(" (")[0])
    assert said == pytest.approx(size, rel=0.3)
    assert texts[10] == ""  # not of a second alone


def test_a_scene_that_names_shades_is_not_tested():
    cloudy = replace(CONSTANTS, unclear_lasts_s=5.0, names_shades=True)
    for constants, tested in ((CONSTANTS, True), (cloudy, False)):
        found, _ = watched(np.random.default_rng(3), 25, one_detector, constants)
        space = BiasSpace(constants, 43_200.0)
        learnt = Learnt(np.full(space.learnt, 9.0), 0.5 * np.eye(space.learnt))
        assert (found.mismatch != "") == (found.beyond_prior(learnt, space) != "") == tested


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


@pytest.mark.parametrize(("far", "named"), [(4.0, ""), (7.0, "ambient.level_counts is off by +23")])
def test_what_is_learnt_beyond_the_prior_is_named(far, named):
    space = BiasSpace(CONSTANTS, 43_200.0)
    count = space.learnt
    # Nothing is known of the power, little of gains, and of the ambient about half of its prior.
    # Means spread by the root of what is learnt: this one is `far` of its standard deviations off.
    variances = np.array([1.0, 0.55, *[0.9] * (count - 2)])
    mean = np.zeros(count)
    mean[1] = far * np.sqrt(1 - variances[1])
    found = LastingResiduals(CONSTANTS).beyond_prior(Learnt(mean, np.diag(variances)), space)
    assert found.startswith(named) if named else not found


@pytest.mark.parametrize(
    ("counts", "named"), [(10.0, ""), (60.0, "ambient.level_counts is off by")]
)
def test_a_track_that_learns_what_the_prior_hardly_allows_says_so(counts, named):
    rng, pose = np.random.default_rng(4), np.array([-6.0, 0.0, 0.0, 0.0, 0.0])
    slopes = np.column_stack([100 * rng.standard_normal((SIDE**2, 5)), np.ones(SIDE**2)])
    residuals = counts + rng.standard_normal(SIDE**2)
    frame = LinearisedReadings(
        np.append(pose, 0.0), residuals, slopes, np.full(SIDE**2, 500.0), np.ones(SIDE**2)
    )
    constants = Constants(("ambient.level_counts",), (5.0,), 0.0, SIDE**2)
    track = Tracker(TrackerSettings(), constants).update(1, pose, 0.01 * np.eye(5), frame)
    assert track.mismatch.startswith(named) if named else not track.mismatch


@pytest.mark.parametrize("seed", range(3))
def test_what_the_prior_lets_expect_is_learnt_without_alarm(seed):
    rng, space, tests = np.random.default_rng(seed), BiasSpace(CONSTANTS, 43_200.0), []
    residuals = LastingResiduals(CONSTANTS)
    for _ in range(200):
        truth = rng.standard_normal(space.learnt)
        slopes = rng.standard_normal((30, space.learnt)) * rng.uniform(0.01, 3, space.learnt)
        covariance = np.linalg.inv(np.eye(space.learnt) + slopes.T @ slopes)
        mean = covariance @ slopes.T @ (slopes @ truth + rng.standard_normal(30))
        tests.append(residuals.beyond_prior(Learnt(mean, covariance), space))
    assert set(tests) == {""}


def test_uneven_light_that_stays_is_named_soon_at_the_start_and_later_in_half_a_minute():
    tracker = Tracker(TrackerSettings(), Constants(unclear_lasts_s=5.0, uneven=0.02))

    def said(seconds, shaded):
        stamp_ns = 10**18 + round(seconds * 10**9)
        pose = [-6.0, 0.0, 0.0, 0.0, 0.0]
        return tracker.update(stamp_ns, pose, 0.01 * np.eye(5), shaded=shaded).mismatch

    named = "the evenness of the light is off in most frames of 30 s, or since the first"
    # Three quarters of three seconds.
    assert not any(said(k / 2, 0.9) for k in range(5))
    assert said(2.5, 0.9) == named
    assert not any(said(2.5 + k / 2, 0.1) for k in range(2, 44))
    # After clear frames their share grows as 1 - exp(-t / 30 s), in a young track, too.
    assert not any(said(24.5 + k / 2, 0.9) for k in range(40))
    assert not any(said(44.5 + k / 2, 0.1) for k in range(600))
    assert not any(said(344.5 + k / 2, 0.9) for k in range(54))
    assert said(372.5, 0.9) == named
    assert not any(said(374 + k, 0.1 if k % 2 else 0.9) for k in range(1, 60))
