"""A manoeuvre is no outlier, and an outlier is no manoeuvre."""

import math
from contextlib import suppress

import numpy as np
import pytest
from scenes import squared_error
from tracks import START_NS, STATION

from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = pytest.mark.filterwarnings("error")
STEP_S = 0.1


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


def reversing(seconds, rng):
    """Turn at 30 deg/s, to port and back to starboard from one frame to the next."""
    legs = np.abs((seconds / 1.3 + rng.random()) % 2 - 1)
    return STATION + np.outer(legs - 0.5, [0, 0, 0, 0, math.radians(30 * 1.3)])


def tracked(path, seed, outliers=0.0, end_s=75.0):
    """Return which frames are strays, which are refused, and the errors of the tracks.

    These are in standard deviations, shape ``(n, 5)``, nan where a frame is refused; and squared.
    """
    rng, seconds = np.random.default_rng(seed), np.arange(0, end_s, STEP_S)
    noise = cramer_rao_bound(ForwardModel(load_scene("follow")), STATION).covariance
    root, tracker = np.linalg.cholesky(noise), Tracker(TrackerSettings())
    strays, off, squares = np.zeros(len(seconds), bool), np.full((len(seconds), 5), np.nan), []
    for k, pose in enumerate(path(seconds, rng)):
        strays[k] = k > 20 and rng.random() < outliers
        # From 10 standard deviations on in the directions that an image sees best.
        jump = rng.choice([-1, 1], 5) * [0.2, 0.2, 0.2, 0.1, 0.1] * rng.uniform(1, 5) * strays[k]
        seen = pose + jump + root @ rng.standard_normal(5)
        with suppress(Outlier):
            track = tracker.update(START_NS + round(k * STEP_S * 1e9), seen, noise)
            off[k] = (track.pose - pose) / np.sqrt(track.covariance.diagonal())
            squares.append(squared_error(track, pose))
    return strays, np.isnan(off[:, 0]), off, np.array(squares)


@pytest.mark.parametrize("path", [swaying, zigzag])
def test_honest_frames_of_a_manoeuvre_pass_and_strays_among_them_do_not(path):
    _, refused, _, _ = tracked(path, 21)
    assert refused.mean() <= 0.002
    assert not (refused[1:] & refused[:-1]).any()
    strays, refused, _, _ = tracked(path, 21, outliers=0.05)
    assert (refused & ~strays).mean() <= 0.002
    assert refused[strays].mean() >= 0.98


def test_frames_of_an_abruptly_reversed_turn_are_in_the_track_and_no_sharper_than_they_are():
    _, refused, off, squares = tracked(reversing, 5, end_s=150.0)
    assert refused.mean() <= 0.03
    assert np.nanmax(np.abs(off)) < 6
    assert squares.mean() < 7
