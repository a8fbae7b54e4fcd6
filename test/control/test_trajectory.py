"""Poses by time: interpolation against closed forms, and every instant that has no answer."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from uuv_optical_array.control.trajectory import TooEarly, Trajectory
from uuv_optical_array.core.messages import Refused, checked_quaternion

pytestmark = pytest.mark.filterwarnings("error")

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
START_NS = 1_700_000_000_123_456_789  # a wall clock: float64 seconds would lose 100 ns


def quaternion(axis, angle):
    return np.array([*(np.asarray(axis) * math.sin(angle / 2)), math.cos(angle / 2)])


def record(*samples, max_gap_s=1.0):
    trajectory = Trajectory(max_gap_s)
    for stamp_ns, position, attitude in samples:
        trajectory.add(stamp_ns, np.asarray(position, float), attitude)
    return trajectory


@given(
    st.floats(-3.0, 3.0),
    st.integers(1, 999_999_999),
    st.integers(0, 2**32),
    st.sampled_from([1.0, -1.0]),
)
def test_between_two_poses_position_is_linear_and_attitude_follows_the_great_arc(
    angle, gap_ns, seed, sign
):
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    first, last = rng.uniform(-50, 50, (2, 3))
    attitude = Rotation.from_quat(rng.standard_normal(4))
    turned = Rotation.from_rotvec(angle * axis) * attitude
    # q and -q are one attitude: the arc is the short one either way.
    trajectory = record(
        (START_NS, first, attitude.as_quat()), (START_NS + gap_ns, last, sign * turned.as_quat())
    )
    at_ns = int(rng.integers(0, gap_ns + 1))
    fraction = at_ns / gap_ns
    position, rotation = trajectory.at(START_NS + at_ns)
    np.testing.assert_allclose(position, (1 - fraction) * first + fraction * last, atol=1e-12)
    # Rodrigues' formula for the part of the turn made so far.
    cross = np.cross(np.eye(3), axis)
    part = fraction * angle
    turn = np.eye(3) + math.sin(part) * cross + (1 - math.cos(part)) * cross @ cross
    np.testing.assert_allclose(rotation, turn @ attitude.as_matrix(), atol=1e-12)


def test_a_long_record_agrees_with_one_interpolation_over_all_of_it():
    rng = np.random.default_rng(8)
    stamps = np.cumsum(rng.integers(10_000_000, 100_000_000, 60))
    positions = rng.standard_normal((60, 3))
    attitudes = Rotation.from_rotvec(0.5 * rng.standard_normal((60, 3)))
    trajectory = record(*zip(stamps.tolist(), positions, attitudes.as_quat(), strict=True))
    slerp = Slerp(stamps.astype(float), attitudes)
    for stamp in rng.integers(stamps[0], stamps[-1], 200).tolist():
        position, rotation = trajectory.at(stamp)
        expected = [np.interp(stamp, stamps, positions[:, axis]) for axis in range(3)]
        np.testing.assert_allclose(position, expected, atol=1e-12)
        np.testing.assert_allclose(rotation, slerp(float(stamp)).as_matrix(), atol=1e-9)


def test_a_recorded_instant_gives_the_recorded_pose_exactly():
    quarter = quaternion([0, 0, 1], math.pi / 2)
    trajectory = record(
        (START_NS, [1, 2, 3], LEVEL),
        (START_NS + 1, [4, 5, 6], quarter),
        # Across a gap there is no interpolation, but both its ends are on record.
        (START_NS + 5_000_000_001, [7, 8, 9], LEVEL),
    )
    expected = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    for stamp, place, matrix in [
        (START_NS, [1, 2, 3], np.eye(3)),
        (START_NS + 1, [4, 5, 6], expected),
        (START_NS + 5_000_000_001, [7, 8, 9], np.eye(3)),
    ]:
        position, rotation = trajectory.at(stamp)
        np.testing.assert_array_equal(position, place)
        np.testing.assert_allclose(rotation, matrix, atol=1e-15)


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


def test_a_quaternion_whose_length_is_one_within_a_hundredth_is_normalised():
    direction = quaternion([0.6, 0.0, 0.8], 0.7)
    for length in (0.98, 0.991, 1.009, 1.02):
        message = SimpleNamespace(**dict(zip("xyzw", length * direction, strict=True)))
        if abs(length - 1) < 0.01:
            np.testing.assert_allclose(checked_quaternion(message), direction, rtol=1e-14)
        else:
            with pytest.raises(Refused, match=r"bad attitude: .* has length"):
                checked_quaternion(message)
