"""The BlueROV2: thrusters, frames, and an autopilot that turns a twist into a motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.vehicles.bluerov2 import (
    ALLOCATION,
    BlueRov2,
    BlueRov2Wu,
    flu_to_frd,
    saturated,
)
from uuv_optical_array.control.vehicles.sea import Sea, WaveSettings
from uuv_optical_array.control.vehicles.vehicle import Vehicle
from uuv_optical_array.core.geometry import rotation_matrix

DT = 0.1
angles = st.floats(-1.5, 1.5)


def run(vehicle, twist, seconds):
    for _ in range(round(seconds / DT)):
        vehicle.step(twist[:3], twist[3:], DT)


@pytest.mark.parametrize(
    ("axis", "most"),
    [
        (0, 4 * 30.4 * np.sqrt(0.5)),
        (1, 4 * 30.4 * np.sqrt(0.5)),
        (2, 4 * 30.4),
        (5, 4 * 30.4 * (0.156 + 0.111) * np.sqrt(0.5)),
    ],
)
def test_four_level_or_four_upright_thrusters_give_their_published_most(axis, most):
    # Level ones at 45 deg, 0.156 m ahead or astern and 0.111 m aside.
    wrench = most * np.eye(6)[axis]
    assert saturated(0.999 * wrench) == pytest.approx(0.999 * wrench)
    assert saturated(1e6 * wrench)[axis] == pytest.approx(most)


@given(
    force=st.tuples(*[st.floats(-1e4, 1e4)] * 3).map(np.array),
    moment=st.tuples(*[st.floats(-2, 2)] * 3).map(np.array),
)
def test_too_strong_a_force_is_cut_and_never_the_moment(force, moment):
    made = saturated(np.concatenate([force, moment]))
    assert made[3:] == pytest.approx(moment, abs=1e-9)
    thrusts = np.linalg.lstsq(ALLOCATION, made, rcond=None)[0]  # the least that make it
    assert np.abs(thrusts).max() <= 30.4 * (1 + 1e-9)
    size = np.linalg.norm(force)
    assert np.cross(made[:3], force) == pytest.approx(np.zeros(3), abs=1e-6 * (1 + size))
    assert made[:3] @ force >= min(size, 20.0) * size - 1e-6


@given(roll=angles, pitch=angles, yaw=st.floats(-3, 3), place=st.tuples(*[st.floats(-9, 9)] * 3))
def test_frd_is_half_a_turn_about_the_bow(roll, pitch, yaw, place):
    half_turn = Rotation.from_euler("x", np.pi)
    assert flu_to_frd(np.array(place)) == pytest.approx(half_turn.apply(place), abs=1e-9)
    # Pitch and yaw change their sign by it, the roll does not.
    turned = half_turn * Rotation.from_matrix(rotation_matrix(pitch, yaw, roll)) * half_turn.inv()
    assert turned.as_matrix() == pytest.approx(rotation_matrix(-pitch, -yaw, roll), abs=1e-9)


@pytest.mark.parametrize(
    ("axis", "speed", "sign"),
    [(0, 0.5, 1), (1, 0.3, -1), (2, 0.3, 1), (4, 0.05, -1), (5, 0.2, 1), (5, 0.6, -1)],
)
def test_each_axis_reaches_what_is_commanded_and_only_it(axis, speed, sign):
    vehicle = BlueRov2(np.zeros(3))
    run(vehicle, sign * speed * np.eye(6)[axis], 8)
    twist = np.concatenate([vehicle.linear, vehicle.angular])
    assert twist == pytest.approx(sign * speed * np.eye(6)[axis], abs=0.01)
    # Left, up, bow low and bow to port are positive, as of the kinematic vehicle.
    moved = [*vehicle.position, vehicle.roll, vehicle.pitch, vehicle.yaw]
    assert sign * moved[axis] > 0.3
    assert Rotation.from_matrix(vehicle.rotation).as_matrix() == pytest.approx(
        rotation_matrix(vehicle.pitch, vehicle.yaw, vehicle.roll)
    )


def test_a_mixed_command_is_obeyed_in_spite_of_the_couplings():
    # Uncancelled, the added mass alone would pitch it by (Z - X) u w = 0.6 N m.
    vehicle, twist = BlueRov2(np.zeros(3)), np.array([0.5, 0.1, -0.1, 0.0, 0.05, 0.15])
    run(vehicle, twist, 3)
    assert vehicle.linear == pytest.approx(twist[:3], abs=2e-3)
    assert vehicle.angular[1:] == pytest.approx(twist[4:], abs=2e-3)
    assert (vehicle.roll, vehicle.pitch) == pytest.approx((0.0, 0.15), abs=0.02)


@pytest.mark.parametrize(
    ("kind", "linear", "quadratic", "top"),
    # 0.72 m/s was measured, say papers that cite von Benzon et al.
    [(BlueRov2, 13.7, 141.0, 0.73), (BlueRov2Wu, 4.03, 18.18, 2.07)],
)
def test_the_top_speed_is_where_the_greatest_thrust_meets_the_drag(kind, linear, quadratic, top):
    force = 4 * 30.4 * np.sqrt(0.5)
    holds = (-linear + np.sqrt(linear**2 + 4 * quadratic * force)) / (2 * quadratic)
    assert holds == pytest.approx(top, abs=0.005)
    assert kind.limits.speed[0] < top
    for axis, limit in enumerate(kind.limits.speed[:3]):
        needed = kind.body.damping(limit * np.eye(6)[axis])
        assert saturated(needed) == pytest.approx(needed)
    vehicle = kind(np.zeros(3))
    run(vehicle, np.array([5.0, 0, 0, 0, 0, 0]), 6)
    assert vehicle.linear[0] == pytest.approx(kind.limits.speed[0], abs=1e-3)


@pytest.mark.parametrize("kind", [Vehicle, BlueRov2])
def test_the_thrusters_turn_it_at_the_limits_and_leave_most_of_their_moment(kind):
    # Of pitch and yaw: inertia with added mass, drag, and the righting moment of 0.0134 m^3 of
    # water, 0.01 m above the centre of mass; upright thrusters are 0.12 m ahead and astern.
    most = 4 * 30.4 * np.array([0.12, (0.156 + 0.111) * np.sqrt(0.5)])
    turn, turning = kind.limits.speed[3:], kind.limits.acceleration[3:]
    pitch = 0.365 * turning[0] + 0.8 * turn[0] + 0.47 * turn[0] ** 2
    righting = 0.0134 * 1000 * 9.82 * 0.01 * np.sin(kind.limits.pitch)
    yaw = 0.592 * turning[1] + 1.5 * turn[1] ** 2
    assert ([pitch + righting, yaw] < most / 5).all()


@pytest.mark.parametrize(("axis", "most"), [(0, 85.98), (1, 85.98), (2, 121.6)])
def test_it_speeds_up_at_the_limit_until_near_the_top_speed(axis, most):
    mass = np.array([13.5 + 6.36, 13.5 + 7.12, 13.5 + 18.68])[axis]
    linear, quadratic = [13.7, 0.0, 33.0][axis], [141.0, 217.0, 190.0][axis]
    spare = most - mass * Vehicle.limits.acceleration[axis]
    fastest = (-linear + np.sqrt(linear**2 + 4 * quadratic * spare)) / (2 * quadratic)
    assert fastest > 0.9 * BlueRov2.limits.speed[axis]
    vehicle, speed = BlueRov2(np.zeros(3)), min(fastest, BlueRov2.limits.speed[axis])
    seconds = round(0.9 * speed / Vehicle.limits.acceleration[axis] / DT) * DT
    run(vehicle, 5.0 * np.eye(6)[axis], seconds)
    reached = Vehicle.limits.acceleration[axis] * seconds
    assert vehicle.linear[axis] == pytest.approx(reached, rel=0.06)


def test_idle_in_still_water_it_stays_and_rolled_it_rights_itself():
    vehicle = BlueRov2([1.0, 2.0, -3.0], pitch=0.2, yaw=4.0)
    run(vehicle, np.zeros(6), 5)
    assert vehicle.position == pytest.approx([1.0, 2.0, -3.0], abs=1e-9)
    assert (vehicle.pitch, vehicle.yaw) == pytest.approx((0.2, 4.0), abs=1e-9)
    vehicle.roll = 0.5
    run(vehicle, np.zeros(6), 8)
    assert abs(vehicle.roll) < 0.01


def test_waves_do_not_turn_it_little_by_little():
    vehicle = BlueRov2(np.zeros(3), sea=Sea((0.2, 0.3, 0.0), WaveSettings(1.0, 6.0, 60.0, 3.0)))
    run(vehicle, np.array([0.4, 0, 0, 0, 0, 0.1]), 30)
    assert (vehicle.roll, vehicle.pitch) == pytest.approx((0.0, 0.0), abs=0.02)


@given(
    commands=st.lists(
        st.tuples(*[st.floats(-1e6, 1e6)] * 6, st.floats(0.0, 0.3)), min_size=1, max_size=12
    )
)
@settings(max_examples=15)
def test_any_commands_in_a_rough_sea_leave_it_finite_and_slow(commands):
    waves = WaveSettings(wave_height_m=3.0, wave_period_s=6.0, depth_m=2.0)
    vehicle = BlueRov2(np.zeros(3), sea=Sea((0.5, 0.5, -0.2), waves))
    for *command, dt in commands:
        vehicle.step(command[:3], command[3:], dt)
        assert np.isfinite([*vehicle.position, vehicle.pitch, vehicle.yaw, vehicle.roll]).all()
        # No faster than full thrust through the fastest water.
        assert np.linalg.norm(vehicle.linear) < 1.3 + 0.8 + np.pi * 3.0 / 6.0
