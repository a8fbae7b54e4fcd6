"""Rotations, relative poses and the 6x6 covariance, against SciPy and finite differences."""

import numpy as np
import pytest
from differences import differentiate
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.core import geometry

PI = np.pi
turn = st.floats(-PI, PI)
level = st.floats(-1.4, 1.4)
metres = st.floats(-20, 20)


def scipy_rotation(pitch, yaw, roll):
    """Yaw about z, then pitch about the turned y, then roll about the turned x."""
    return Rotation.from_euler("ZYX", [yaw, pitch, roll])


def turned_about_beam(angle, pose, roll):
    """Pose and roll after the follower was swung about the beacon's x axis."""
    swing = Rotation.from_euler("x", angle)
    attitude = swing * scipy_rotation(pose[3], pose[4], roll)
    yaw, pitch, new_roll = attitude.as_euler("ZYX")
    return np.array([*swing.apply(pose[:3]), pitch, yaw]), new_roll


def fixed_axis_step(before, after):
    """Small change of position and attitude, the latter about the fixed axes."""
    (pose_a, roll_a), (pose_b, roll_b) = before, after
    attitude_a = scipy_rotation(*pose_a[3:], roll_a)
    attitude_b = scipy_rotation(*pose_b[3:], roll_b)
    change = (attitude_b * attitude_a.inv()).as_rotvec()
    return np.concatenate([pose_b[:3] - pose_a[:3], change])


@given(pitch=turn, yaw=turn, roll=turn)
def test_rotation_matrix_is_yaw_then_pitch_then_roll(pitch, yaw, roll):
    matrix = geometry.rotation_matrix(pitch, yaw, roll)
    np.testing.assert_allclose(matrix, scipy_rotation(pitch, yaw, roll).as_matrix(), atol=1e-14)
    stack = geometry.rotation_matrix(np.array([[pitch], [0.1]]), [yaw, 0.2, 0.3], roll)
    assert stack.shape == (2, 3, 3, 3)
    np.testing.assert_allclose(stack[0, 0], matrix, atol=1e-15)
    np.testing.assert_allclose(stack[1, 2], geometry.rotation_matrix(0.1, 0.3, roll), atol=1e-15)


near_the_gimbal = st.builds(
    lambda side, distance: side * (PI / 2 - distance),
    st.sampled_from([-1, 1]),
    st.just(0.0) | st.floats(1e-16, 1e-3),
)


@given(pitch=level | near_the_gimbal, yaw=turn, roll=turn)
def test_the_angles_of_a_rotation_describe_it_at_the_gimbal_too(pitch, yaw, roll):
    rotation = scipy_rotation(pitch, yaw, roll)
    roll_back, pitch_back, yaw_back = geometry.roll_pitch_yaw(rotation.as_matrix())
    assert abs(pitch_back) <= PI / 2
    assert max(abs(roll_back), abs(yaw_back)) <= PI
    again = scipy_rotation(pitch_back, yaw_back, roll_back)
    assert (again * rotation.inv()).magnitude() < 1e-14


@given(
    beacon=st.tuples(metres, metres, metres, turn, turn, turn),
    pose=st.tuples(metres, metres, metres, level, turn),
    roll=turn,
)
def test_relative_pose_undoes_the_composition_of_beacon_and_follower(beacon, pose, roll):
    beacon_at, beacon_turned = np.array(beacon[:3]), Rotation.from_euler("ZYX", beacon[3:])
    follower_at = beacon_at + beacon_turned.apply(pose[:3])
    follower_turned = beacon_turned * scipy_rotation(pose[3], pose[4], roll)
    found, found_roll = geometry.relative_pose(
        beacon_at, beacon_turned.as_matrix(), follower_at, follower_turned.as_matrix()
    )
    np.testing.assert_allclose(found[:3], pose[:3], atol=1e-12)
    difference = np.array([*found[3:], found_roll]) - [*pose[3:], roll]
    np.testing.assert_allclose(np.sin(difference / 2), 0, atol=1e-13)


@given(
    pose=st.tuples(metres, metres, metres, level, level),
    roll=turn,
    roll_std=st.floats(0.01, 0.5),
    seed=st.integers(0, 2**32 - 1),
)
def test_covariance_6x6_is_the_first_order_map_of_small_errors(pose, roll, roll_std, seed):
    pose = np.array(pose)
    root = np.random.default_rng(seed).normal(size=(5, 5))
    covariance = root @ root.T
    here, step = (pose, roll), 1e-6
    jacobian = differentiate(lambda at: fixed_axis_step(here, (at, roll)), pose, step)
    gauge = fixed_axis_step(here, turned_about_beam(step, pose, roll)) / step
    expected = jacobian @ covariance @ jacobian.T + roll_std**2 * np.outer(gauge, gauge)
    found = geometry.covariance_6x6(pose, covariance, roll_std)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    np.testing.assert_array_equal(found, found.T)
    # Of several lamps, which show the roll, it goes with the pose.
    root = np.random.default_rng(seed).normal(size=(6, 6))
    joint, state = root @ root.T, np.append(pose, roll)
    jacobian = differentiate(lambda at: fixed_axis_step(here, (at[:5], at[5])), state, step)
    expected = jacobian @ joint @ jacobian.T
    found = geometry.covariance_6x6(pose, joint[:5, :5], 0.1, joint[5])
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_the_5x5_comes_back_from_the_6x6_with_the_rolls_share_alone():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(5, 5))
    pose, covariance = np.array([-6.0, 0.4, -0.3, 0.2, 0.3]), root @ root.T
    back = geometry.covariance_5x5(pose, geometry.covariance_6x6(pose, covariance, 1e-9))
    np.testing.assert_allclose(back, covariance, rtol=1e-12, atol=1e-12)
    # A turn about the beam by one sigma moves y, z and, with the bow aside, the pitch.
    moved = np.array([0.0, 0.3, 0.4, -np.sin(0.3), 0.0])
    rolled = geometry.covariance_5x5(pose, geometry.covariance_6x6(pose, covariance, 0.1))
    np.testing.assert_allclose(rolled - covariance, 0.01 * np.outer(moved, moved), atol=1e-12)


@pytest.mark.parametrize("turned", ["array", "lamp"])
def test_a_small_turn_of_array_or_lamp_appears_as_another_pose(turned):
    """An array swings about its mount; all that a lamp lights turns back about it."""
    pose, roll, bow, angle = np.array([-5.0, 0.4, -0.3, 0.2, -0.3]), 0.5, [0.4, 0.0, 0.0], 1e-5
    axes = scipy_rotation(*pose[3:], roll)
    if turned == "array":
        slopes = geometry.turned_on_mount(pose, roll, bow[0])
    else:
        slopes = geometry.turned_about_lamp(pose)
    for column, about in enumerate(([0.0, angle, 0.0], [0.0, 0.0, angle])):
        turn = Rotation.from_rotvec(about)
        if turned == "array":
            seen = axes * turn
            place = pose[:3] + axes.apply(bow) - seen.apply(bow)
        else:
            seen, place = turn.inv() * axes, turn.inv().apply(pose[:3])
        yaw, pitch, _ = seen.as_euler("ZYX")
        moved = np.array([*place, pitch, yaw]) - pose
        np.testing.assert_allclose(moved / angle, slopes[:, column], atol=1e-4)


def twist_by_differences(pose, rate, roll, step=1e-4):
    """Return the twist of a body between two instants, by SciPy's rotations."""
    before, after = pose - step * rate, pose + step * rate
    here, earlier, later = (scipy_rotation(*at[3:], roll) for at in (pose, before, after))
    linear = here.inv().apply((after - before)[:3])
    angular = here.inv().apply((later * earlier.inv()).as_rotvec())
    return np.array([*linear, *angular]) / (2 * step)


def test_a_twist_turns_and_moves_the_body_as_the_rate_changes_the_pose():
    pose, rate = np.array([-5.0, 0.4, -0.3, 0.3, -0.4]), np.array([0.3, -0.2, 0.1, 0.05, -0.08])
    roll, state = 0.6, np.concatenate([pose, rate])
    root = np.random.default_rng(5).normal(size=(10, 10)) * np.repeat([0.2, 0.05], 5)
    joint = root @ root.T
    twist, covariance = geometry.body_twist(pose, rate, joint, roll)
    np.testing.assert_allclose(twist, twist_by_differences(pose, rate, roll), atol=1e-8)
    np.testing.assert_allclose(geometry.pose_rate(pose, twist, roll), rate, atol=1e-14)
    # Its errors are those of pose and rate by the slopes of that twist.
    slopes = differentiate(lambda at: twist_by_differences(at[:5], at[5:], roll), state, 1e-4)
    expected = slopes @ joint @ slopes.T
    expected[3, 3] += max(joint[8, 8], joint[9, 9])
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-6)
    np.linalg.cholesky(covariance)
