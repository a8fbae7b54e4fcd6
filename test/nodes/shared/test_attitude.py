"""Quaternions and angles against SciPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.nodes.shared.attitude import quaternion_xyzw, roll_pitch_yaw

angles = st.floats(-np.pi, np.pi)
steep = np.radians(85.0)  # nearer to 90 deg, roll and yaw are one angle
upright = st.sampled_from([np.pi / 2, -np.pi / 2])


def assert_same_turn(quaternion, expected):
    """Compare quaternions, of which q and -q are the same turn."""
    assert abs(np.dot(quaternion, expected)) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)


@given(angles, angles, angles)
def test_the_quaternion_turns_by_yaw_then_pitch_then_roll(roll, pitch, yaw):
    quaternion = quaternion_xyzw(roll, pitch, yaw)
    assert_same_turn(quaternion, Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat())
    assert {type(value) for value in quaternion} == {float}


@given(angles, st.floats(-steep, steep), angles, st.sampled_from([1.0, -1.0]))
def test_the_angles_of_a_quaternion_are_those_of_scipy(roll, pitch, yaw, sign):
    quaternion = sign * Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    found = roll_pitch_yaw(quaternion)
    expected = Rotation.from_quat(quaternion).as_euler("ZYX")[::-1]
    difference = np.subtract(found, expected)
    # -pi and pi are one angle.
    np.testing.assert_allclose((difference + np.pi) % (2 * np.pi) - np.pi, 0.0, atol=1e-9)
    assert {type(value) for value in found} == {float}


@given(angles, upright, angles)
def test_with_the_bow_straight_up_or_down_the_angles_are_still_that_turn(roll, pitch, yaw):
    quaternion = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    found = Rotation.from_euler("ZYX", roll_pitch_yaw(quaternion)[::-1])
    assert (found.inv() * Rotation.from_quat(quaternion)).magnitude() < 1e-7
