"""A track through shades, whose errors last for seconds."""

from contextlib import suppress

import numpy as np
import pytest
from scenes import squared_error
from tracks import NOISE, START_NS, STATION, STD, TENTH_NS

from uuv_optical_array.estimation.tracking.correction import UNEVEN_DOUBT
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import Constants

LASTS_S = 3.0


def tracked(tracker, shaded, rng):
    """Return normalised squared errors of a track by poses whose errors last, after 1 s."""
    squares, kept = [], np.exp(-0.1 / LASTS_S)
    error = rng.standard_normal(5)
    for k in range(150):
        error = kept * error + np.sqrt(1 - kept**2) * rng.standard_normal(5)
        with suppress(Outlier):
            track = tracker.update(
                START_NS + k * TENTH_NS, STATION + STD * error, NOISE, shaded=shaded
            )
            squares.append((k, squared_error(track, STATION)))
    return np.mean([square for k, square in squares if k > 10])


@pytest.mark.parametrize(("shaded", "low", "high"), [(1.0, 1.5, 5.0), (0.0, 9.0, np.inf)])
def test_a_track_claims_no_more_than_errors_that_last_allow(shaded, low, high):
    settings = TrackerSettings(common_share=0.0)
    constants = Constants(unclear_lasts_s=LASTS_S)
    found = [
        tracked(Tracker(settings, constants=constants), shaded, np.random.default_rng(seed))
        for seed in range(20)
    ]
    assert low < np.mean(found) < high


@pytest.mark.parametrize("share", [0.0, 0.2])
@pytest.mark.parametrize(
    ("shaded", "lasts", "times"),
    [(0.0, 100, 1), (1.0, 0, UNEVEN_DOUBT), (1.0, 9, UNEVEN_DOUBT), (1.0, 100, 100)],
)
def test_poses_of_uneven_light_count_less_and_as_one_in_the_time_that_it_lasts(
    shaded, lasts, times, share
):
    step_ns = 1000  # in which nothing moves
    constants = Constants(unclear_lasts_s=lasts * step_ns * 1e-9)
    tracker = Tracker(TrackerSettings(common_share=share), constants=constants)
    tracker.update(START_NS, STATION, NOISE, shaded=shaded)
    track = tracker.update(START_NS + step_ns, STATION, NOISE, shaded=shaded)
    # The mean of two poses, weighed by their variances, and the part that all frames share.
    first = UNEVEN_DOUBT if shaded else 1
    variance = (1 - share) / (1 / first + 1 / times) + share
    np.testing.assert_allclose(track.covariance, variance * NOISE, 1e-3, 1e-9)


def test_uneven_light_is_expected_to_last_and_then_as_often_as_usual():
    tracker = Tracker(TrackerSettings(), constants=Constants(unclear_lasts_s=LASTS_S, uneven=0.02))
    assert tracker.uneven(START_NS) == 0.02
    tracker.update(START_NS, STATION, NOISE, shaded=0.9)
    for seconds in (0.0, 1.5, 100.0):
        expected = 0.02 + (0.9 - 0.02) * np.exp(-seconds / LASTS_S)
        stamp = START_NS + round(seconds * 1e9)
        assert tracker.uneven(stamp) == pytest.approx(expected, rel=1e-12)
    # A clear one after it ends the suspicion.
    tracker.update(START_NS + TENTH_NS, STATION, NOISE)
    assert tracker.uneven(START_NS + TENTH_NS) == 0
    assert Tracker(TrackerSettings()).uneven(START_NS) == 0
