"""Quaternions and angles against SciPy, for both libraries that may be underneath."""

import importlib.util
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.nodes.shared import attitude

angles = st.floats(-np.pi, np.pi)
steep = np.radians(85.0)  # nearer to 90 deg, roll and yaw are one angle
pitches = st.floats(-steep, steep)


@pytest.fixture(scope="module", params=["transforms3d", "tf_transformations"])
def module(request):
    """Load the module anew, on top of one library."""
    pytest.importorskip(request.param, reason=f"{request.param} is not installed")
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "transforms3d":
            patch.setitem(sys.modules, "tf_transformations", None)  # makes its import fail
        spec = importlib.util.spec_from_file_location("attitude_anew", attitude.__file__)
        loaded = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(loaded)
    assert ("euler2quat" in vars(loaded)) == (request.param == "transforms3d")
    return loaded


def assert_same_turn(quaternion, expected):
    """Compare quaternions, of which q and -q are the same turn."""
    assert abs(np.dot(quaternion, expected)) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)


@given(angles, angles, angles)
def test_the_quaternion_turns_by_yaw_then_pitch_then_roll(module, roll, pitch, yaw):
    quaternion = module.quaternion_xyzw(roll, pitch, yaw)
    assert_same_turn(quaternion, Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat())
    assert {type(value) for value in quaternion} == {float}


@given(angles, pitches, angles, st.sampled_from([1.0, -1.0]))
def test_the_angles_of_a_quaternion_are_those_of_scipy(module, roll, pitch, yaw, sign):
    quaternion = sign * Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    found = module.roll_pitch_yaw(quaternion)
    expected = Rotation.from_quat(quaternion).as_euler("ZYX")[::-1]
    difference = np.subtract(found, expected)
    # -pi and pi are one angle.
    np.testing.assert_allclose((difference + np.pi) % (2 * np.pi) - np.pi, 0.0, atol=1e-9)
    assert {type(value) for value in found} == {float}
