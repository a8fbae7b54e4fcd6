"""A track through shades, whose errors last for seconds."""

from contextlib import suppress

import numpy as np
import pytest
from scenes import squared_error
from tracks import NOISE, START_NS, STATION, STD, TENTH_NS

from uuv_optical_array.estimation.tracking.correction import UNNAMED_DOUBT
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
        for seed in range(10)
    ]
    assert low < np.mean(found) < high


@pytest.mark.parametrize("share", [0.0, 0.2])
@pytest.mark.parametrize(
    ("shaded", "named", "times"), [(0.0, False, 1), (1.0, True, 1), (1.0, False, UNNAMED_DOUBT)]
)
def test_poses_of_uneven_light_that_has_no_name_count_less(shaded, named, times, share):
    constants = Constants(unclear_lasts_s=LASTS_S, names_shades=named)
    tracker = Tracker(TrackerSettings(common_share=share), constants=constants)
    track = tracker.update(START_NS, STATION, NOISE, shaded=shaded)
    variance = (1 - share) * times + share
    np.testing.assert_allclose(track.covariance, variance * NOISE, 1e-9, 1e-12)


@pytest.mark.parametrize(("shaded", "low", "high"), [(1.0, 0.97, 1.03), (0.0, 3.0, 6.0)])
def test_poses_of_uneven_light_count_by_the_time_in_which_they_come(shaded, low, high):
    constants = Constants(unclear_lasts_s=LASTS_S)
    variances = []
    for step_ns in (TENTH_NS, TENTH_NS // 10):
        tracker = Tracker(TrackerSettings(common_share=0.0), constants=constants)
        for stamp_ns in range(START_NS, START_NS + 100 * TENTH_NS + 1, step_ns):
            track = tracker.update(stamp_ns, STATION, NOISE, shaded=shaded)
        variances.append(track.covariance[0, 0])
    # White noise of a tenth of the density leaves 10^(3/4) = 5.6 times less of a walking rate.
    assert low < variances[0] / variances[1] < high


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
