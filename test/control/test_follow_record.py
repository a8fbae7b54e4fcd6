"""What a run says of itself: its table of errors, and how the leader was lost."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from uuv_optical_array.control.follow_record import FollowRecord
from uuv_optical_array.control.follow_states import SINCE, state_from_status, values_of
from uuv_optical_array.control.following import State
from uuv_optical_array.core.messages import Refused

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


def test_a_run_is_lost_by_the_state_at_its_end_without_poses_and_far_off_its_station(record):
    assert record.lost() == "the follower never told its state"
    record.states[:] = [State("locked", -3.0, "seen"), State("coasting", 0.1, "no light")]
    assert record.lost() == "coasting from 0.1 s to the end: no light"
    record.states.append(State("locked", 0.2, "light came back"))  # a gap is no failure
    off = 4 * math.sqrt(0.1**2 + 0.2**2 + 3.0**2)
    assert record.lost() == f"the follower ended {off:.1f} m off its station"
    record.truth[0.3] = STATION
    assert record.lost() == ""
    for name in ("waiting", "searching", "lost", "disengaged"):
        record.states[2:] = [State(name, 0.25, "so it is")]
        assert record.lost() == f"{name} from 0.2 s to the end: so it is"
    record.estimates.clear()
    assert record.lost() == "not one pose was estimated"
    record.truth.clear()
    assert record.lost() == "it never set off; the log says what it waited for"


def test_the_times_in_each_state_are_those_of_the_run_in_all(record):
    record.truth[10.0] = STATION
    record.states[:] = [
        State("waiting", -9.0, ""),
        State("locked", -2.0, ""),
        State("coasting", 4.0, ""),
        State("searching", 5.5, ""),
        State("locked", 7.25, ""),
    ]
    assert record.spells() == [
        ("locked", 0.0, 4.0),
        ("coasting", 4.0, 5.5),
        ("searching", 5.5, 7.25),
        ("locked", 7.25, 10.0),
    ]
    last = record.summary().splitlines()[-1]
    assert last == "locked 6.8 s, coasting 1.5 s, searching 1.8 s"


def test_a_state_is_read_as_it_is_told_and_what_is_none_is_refused():
    told = State("coasting", 1_700_000_000.25, "the light is gone")
    values = values_of(told, 1_700_000_003.5)
    assert values["for (s)"] == "3.2"

    def status(message="coasting", **changes):
        pairs = [SimpleNamespace(key=k, value=v) for k, v in {**values, **changes}.items()]
        return SimpleNamespace(message=message, values=pairs)

    assert state_from_status(status()) == told
    for wrong in (status("gliding"), status(**{SINCE: "soon"}), status(**{SINCE: "nan"})):
        with pytest.raises(Refused, match="no state: "):
            state_from_status(wrong)
