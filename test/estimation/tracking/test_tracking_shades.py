"""A track through shades, whose errors last for seconds."""

from contextlib import suppress

import numpy as np
import pytest
from scenes import squared_error
from tracks import NOISE, START_NS, STATION, STD, TENTH_NS

from uuv_optical_array.estimation.tracking.correction import (
    CORRELATED_FRAMES,
    SHADE_SHARE,
    UNNAMED_DOUBT,
)
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.estimation.unknowns.constants import Constants

LASTS_S = 3.0
SHARE = 0.36  # of a pose's variance, that lasts


def tracked(tracker, lasting, rng):
    """Return normalised squared errors of a track by poses whose errors last, after 1 s."""
    squares, kept = [], np.exp(-0.1 / LASTS_S)
    error = rng.standard_normal(5)
    for k in range(150):
        error = kept * error + np.sqrt(1 - kept**2) * rng.standard_normal(5)
        off = STD * (np.sqrt(SHARE) * error + np.sqrt(1 - SHARE) * rng.standard_normal(5))
        with suppress(Outlier):
            track = tracker.update(START_NS + k * TENTH_NS, STATION + off, NOISE, shaded=lasting)
            squares.append((k, squared_error(track, STATION)))
    return np.mean([square for k, square in squares if k > 10])


@pytest.mark.parametrize(("lasting", "low", "high"), [(1.0, 2.5, 6.0), (0.0, 9.0, np.inf)])
def test_a_track_claims_no_more_than_errors_that_last_allow(lasting, low, high):
    settings = TrackerSettings(common_share=0.0)
    constants = Constants(unclear_lasts_s=LASTS_S, names_shades=True)
    found = [
        tracked(Tracker(settings, constants=constants), lasting, np.random.default_rng(seed))
        for seed in range(20)
    ]
    assert low < np.mean(found) < high


@pytest.mark.parametrize("names", [(), ("field_of_view.cosine_power",)])
def test_what_a_shade_does_to_two_frames_is_one_error(names):
    stds = (0.1,) * len(names)
    constants = Constants(names, stds, unclear_lasts_s=1e6, names_shades=True)
    tracker = Tracker(TrackerSettings(common_share=0.0), constants=constants)
    for k in range(2):
        track = tracker.update(START_NS + 1000 * k, STATION, NOISE, shaded=1.0)
    lasts = SHADE_SHARE * NOISE
    new = CORRELATED_FRAMES * (NOISE - lasts) / 2
    np.testing.assert_allclose(track.covariance, lasts + new, 1e-3, 1e-9)


@pytest.mark.parametrize(("named", "doubt"), [(True, 1.0), (False, UNNAMED_DOUBT)])
def test_a_clear_frame_outweighs_a_shaded_one_more_where_no_shade_is_named(named, doubt):
    constants = Constants(unclear_lasts_s=1e6, names_shades=named)
    tracker = Tracker(TrackerSettings(common_share=0.0), constants=constants)
    tracker.update(START_NS, STATION, NOISE, shaded=1.0)
    track = tracker.update(START_NS + 1000, STATION, NOISE)
    lasts = SHADE_SHARE * NOISE
    shaded = doubt**2 * (lasts + CORRELATED_FRAMES * (NOISE - lasts))
    best = np.linalg.inv(np.linalg.inv(shaded) + np.linalg.inv(NOISE))
    np.testing.assert_allclose(track.covariance, best, 1e-3, 1e-9)


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
