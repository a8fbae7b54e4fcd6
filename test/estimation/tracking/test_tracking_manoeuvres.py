"""A manoeuvre is no outlier, and an outlier is no manoeuvre."""

import math

import numpy as np
import pytest
from tracks import START_NS, STATION

from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = pytest.mark.filterwarnings("error")
SECONDS, STEP_S = 150.0, 0.1


def swaying(seconds, rng):
    """Sinusoids in all degrees of freedom, up to 0.1 m/s, 0.3 m/s^2, 8 deg/s and 25 deg/s^2."""
    amplitude = np.array([0.03, 0.03, 0.03, math.radians(2.5), math.radians(2.5)])
    phase = 2 * math.pi * rng.random(5)
    slow = rng.uniform(0.8, 1.2, 5)
    return STATION + amplitude * np.sin(math.pi * slow * seconds[:, None] + phase)


def zigzag(seconds, rng):
    """Straight legs of 3 s at 0.1 m/s and 4 deg/s, turned from one frame to the next."""
    legs = np.abs((seconds / 3.0 + rng.random()) % 2 - 1)
    rate = np.array([0.1, 0.05, 0.03, math.radians(2), math.radians(4)])
    return STATION + np.outer(3.0 * (legs - 0.5), rate)


def counted(path, outliers=0.0):
    """Return shares of honest frames refused, most in a row, and share of outliers refused."""
    rng = np.random.default_rng(21)
    seconds = np.arange(0, SECONDS, STEP_S)
    noise = cramer_rao_bound(ForwardModel(load_scene("follow")), STATION).covariance
    root = np.linalg.cholesky(noise)
    tracker, refused, row, most, caught = Tracker(TrackerSettings()), 0, 0, 0, []
    for k, pose in enumerate(path(seconds, rng)):
        stray = k > 20 and rng.random() < outliers
        # From 10 standard deviations on in the directions that an image sees best.
        jump = rng.choice([-1, 1], 5) * [0.2, 0.2, 0.2, 0.1, 0.1] * rng.uniform(1, 5) * stray
        try:
            seen = pose + jump + root @ rng.standard_normal(5)
            tracker.update(START_NS + round(k * STEP_S * 1e9), seen, noise)
            row, took = 0 if not stray else row, True
        except Outlier:
            took = False
            if not stray:
                refused, row = refused + 1, row + 1
        most = max(most, row)
        if stray:
            caught.append(not took)
    return refused / len(seconds), most, np.mean(caught) if caught else None


@pytest.mark.parametrize("path", [swaying, zigzag])
def test_honest_frames_of_a_manoeuvre_pass_and_strays_among_them_do_not(path):
    share, most, _ = counted(path)
    assert share <= 0.002
    assert most <= 1
    share, _, caught = counted(path, outliers=0.05)
    assert share <= 0.002
    assert caught >= 0.98


def reversing(seconds, rng):
    """Turn at 30 deg/s, to port and back to starboard from one frame to the next."""
    legs = np.abs((seconds / 1.3 + rng.random()) % 2 - 1)
    return STATION + np.outer(legs - 0.5, [0, 0, 0, 0, math.radians(30 * 1.3)])


def test_frames_of_an_abruptly_reversed_turn_are_in_the_track_and_no_sharper_than_they_are():
    rng, squares, refused = np.random.default_rng(5), [], 0
    noise = cramer_rao_bound(ForwardModel(load_scene("follow")), STATION).covariance
    root, tracker = np.linalg.cholesky(noise), Tracker(TrackerSettings())
    seconds = np.arange(0, SECONDS, STEP_S)
    for k, pose in enumerate(reversing(seconds, rng)):
        try:
            seen = pose + root @ rng.standard_normal(5)
            track = tracker.update(START_NS + round(k * STEP_S * 1e9), seen, noise)
        except Outlier:
            refused += 1
            continue
        off = track.pose - pose
        assert np.abs(off / np.sqrt(track.covariance.diagonal())).max() < 6
        squares.append(off @ np.linalg.solve(track.covariance, off))
    assert refused <= 0.03 * len(seconds)
    assert np.mean(squares) < 7
