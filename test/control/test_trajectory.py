"""Poses by time: interpolation against closed forms, and every instant that has no answer."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.vehicles.trajectory import TooEarly, Trajectory

pytestmark = pytest.mark.filterwarnings("error")

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
START_NS = 1_700_000_000_123_456_789  # a wall clock: float64 seconds would lose 100 ns


def record(*samples, max_gap_s=1.0):
    trajectory = Trajectory(max_gap_s)
    for stamp_ns, position, attitude in samples:
        trajectory.add(stamp_ns, np.asarray(position, float), attitude)
    return trajectory


@given(
    st.lists(st.integers(1, 999_999_999), min_size=1, max_size=40), st.floats(0, 1), st.integers(0)
)
@settings(max_examples=40)
def test_between_two_poses_position_is_linear_and_attitude_follows_the_great_arc(gaps, share, seed):
    rng = np.random.default_rng(seed)
    axes, angles = rng.standard_normal((len(gaps), 3)), rng.uniform(-3, 3, len(gaps))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    attitudes = [Rotation.from_quat(rng.standard_normal(4))]
    for axis, angle in zip(axes, angles, strict=True):
        attitudes.append(Rotation.from_rotvec(angle * axis) * attitudes[-1])
    positions = rng.uniform(-50, 50, (len(attitudes), 3))
    # q and -q are one attitude: the arc is the short one either way.
    quaternions = [rng.choice([-1, 1]) * attitude.as_quat() for attitude in attitudes]
    stamps = (START_NS + np.cumsum([0, *gaps])).tolist()
    trajectory = record(*zip(stamps, positions, quaternions, strict=True))
    i = int(rng.integers(len(gaps)))
    at_ns = round(share * gaps[i])
    fraction = at_ns / gaps[i]
    position, rotation = trajectory.at(stamps[i] + at_ns)
    expected = (1 - fraction) * positions[i] + fraction * positions[i + 1]
    np.testing.assert_allclose(position, expected, atol=1e-12)
    # Rodrigues' formula for the part of the turn made so far.
    cross, part = np.cross(np.eye(3), axes[i]), fraction * angles[i]
    turn = np.eye(3) + math.sin(part) * cross + (1 - math.cos(part)) * cross @ cross
    np.testing.assert_allclose(rotation, turn @ attitudes[i].as_matrix(), atol=1e-12)


def test_an_instant_after_the_last_pose_is_too_early_and_answers_later():
    trajectory = record()
    with pytest.raises(TooEarly):
        trajectory.at(0)
    trajectory.add(0, np.zeros(3), LEVEL)
    with pytest.raises(TooEarly):
        trajectory.at(5)
    trajectory.add(10, np.ones(3), LEVEL)
    np.testing.assert_allclose(trajectory.at(5)[0], [0.5] * 3)
    # A caller that waits for TooEarly must not take it for a refusal.
    assert not issubclass(TooEarly, LookupError)


def test_of_two_poses_of_one_instant_the_later_counts():
    trajectory = record((0, np.zeros(3), LEVEL), (10, np.ones(3), LEVEL))
    trajectory.add(10, np.full(3, 4.0), LEVEL)
    np.testing.assert_allclose(trajectory.at(10)[0], [4.0] * 3)
    np.testing.assert_allclose(trajectory.at(5)[0], [2.0] * 3)


def test_an_instant_before_the_first_pose_is_refused_also_when_that_was_dropped():
    trajectory = Trajectory(max_gap_s=1.0, length=3)
    for stamp in range(0, 50, 10):
        trajectory.add(stamp, np.full(3, float(stamp)), LEVEL)
    for stamp in (-1, 5, 19):
        with pytest.raises(LookupError, match="older than every pose"):
            trajectory.at(stamp)
    np.testing.assert_allclose(trajectory.at(25)[0], [25.0] * 3)


def test_an_instant_inside_a_gap_is_refused_and_the_limit_itself_is_not():
    trajectory = record(
        (0, [0, 0, 0], LEVEL),
        (200_000_000, [1, 0, 0], LEVEL),
        (400_000_001, [2, 0, 0], LEVEL),
        max_gap_s=0.2,
    )
    assert trajectory.at(100_000_000)[0][0] == pytest.approx(0.5)
    with pytest.raises(LookupError, match=r"gap of 0\.2 s, more than 0\.2"):
        trajectory.at(300_000_000)
    # Both ends of the gap are on record.
    assert [trajectory.at(end)[0][0] for end in (200_000_000, 400_000_001)] == [1, 2]


def test_a_stamp_that_goes_back_starts_the_record_anew():
    trajectory = record(
        (100, [1, 0, 0], LEVEL),
        (200, [2, 0, 0], LEVEL),
        (200, [2, 0, 0], LEVEL),  # a repeated message loses nothing
        (50, [5, 0, 0], LEVEL),
        (60, [6, 0, 0], LEVEL),
    )
    assert trajectory.at(55)[0][0] == pytest.approx(5.5)
    with pytest.raises(TooEarly):
        trajectory.at(100)
    with pytest.raises(LookupError):
        trajectory.at(40)
