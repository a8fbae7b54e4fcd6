"""What a run says of itself: its table of errors, and how the leader was lost."""

import math

import numpy as np
import pytest

from uuv_optical_array.control.follow_record import FollowRecord

STATION = np.array([-6.0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture
def record():
    """Return a run that is off its station by 3 and 4 times the same, in turn, and has two poses.

    So the RMS is that times sqrt(12.5), and that of the estimates is theirs.
    """
    record = FollowRecord((-6.0, 0.0, 0.0))
    off, error = np.array([0.1, 0.2, -3.0, 0.05, -0.1]), np.array([0.01, 0.02, 12.0, 0.1, -0.3])
    for stamp, times in enumerate((3, 4, 3, 4)):
        record.truth[0.1 * stamp] = STATION + times * off
    for stamp, sign in ((0.0, 1), (0.1, -1)):
        record.estimates[stamp] = record.truth[stamp] + sign * error
    return record


def test_the_table_has_the_rms_of_each_degree_of_freedom_apart(record):
    record.estimates[-0.1] = STATION  # of an image whose truth came before the start
    head, estimate, station, counts = record.summary().splitlines()
    assert head.split() == ["x", "y", "z", "pitch", "yaw"]
    units = ["m", "m", "m", "deg", "deg"]
    scale = np.array([1, 1, 1, *np.degrees([1, 1])])
    for line, name, rms in (
        (estimate, "estimate", [0.01, 0.02, 12.0, 0.1, 0.3]),
        (station, "station", math.sqrt(12.5) * np.array([0.1, 0.2, 3.0, 0.05, 0.1])),
    ):
        words = line.split()
        assert words[:2] == [name, "RMS"]
        assert words[3::2] == units
        assert np.array(words[2::2], float) == pytest.approx(rms * scale, abs=0.005)
        # A title stands above its figure.
        assert len(head) == len(line.rstrip())
    assert counts == "2 poses from 4 images; longest time without one 0.20 s"


def test_a_run_is_lost_without_poses_in_the_dark_and_far_off_its_station(record):
    assert record.lost(0.15) == "no pose for 0.2 s, more than 0.15 s"
    off = 4 * math.sqrt(0.1**2 + 0.2**2 + 3.0**2)
    assert record.lost(1.0) == f"the follower ended {off:.1f} m off its station"
    record.truth[0.3] = STATION
    assert record.lost(1.0) == ""
    record.estimates.clear()
    assert record.lost(1.0) == "not one pose was estimated"
