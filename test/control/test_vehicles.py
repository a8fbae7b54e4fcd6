"""Vehicles of the demonstration: their motion, their limits, and the water that carries them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.vehicles.bluerov2 import BlueRov2, BlueRov2Wu
from uuv_optical_array.control.vehicles.sea import STILL_SEA, Sea, WaveSettings
from uuv_optical_array.control.vehicles.vehicle import Vehicle, VehicleLimits, start_behind
from uuv_optical_array.core.geometry import relative_pose

DT = 0.02


def run(vehicle, linear, angular, steps, dt=DT):
    for _ in range(steps):
        vehicle.step(linear, angular, dt)


def test_general_motion_agrees_with_an_integrator():
    linear, angular = np.array([0.5, 0.1, -0.2]), np.array([0.0, -0.04, 0.15])

    def slope(_, state):
        pitch, yaw = state[3:]
        velocity = Rotation.from_euler("ZYX", [yaw, pitch, 0.0]).apply(linear)
        return np.array([*velocity, angular[1], angular[2] / np.cos(pitch)])

    vehicle = Vehicle(np.zeros(3), pitch=0.5)
    vehicle.limits = VehicleLimits(speed=(10.0,) * 5, acceleration=(1e6,) * 5, pitch=1.5)
    vehicle.step(linear, angular, 1e-5)  # which reaches the commanded velocity
    run(vehicle, linear, angular, round(20 / 0.05), 0.05)
    end = solve_ivp(slope, (0, 20), [0, 0, 0, 0.5, 0], rtol=1e-10, atol=1e-12).y[:, -1]
    assert [*vehicle.position, vehicle.pitch, vehicle.yaw] == pytest.approx(end, abs=2e-4)


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (1, -1), (2, 1), (3, -1), (4, 1)])
def test_velocity_ramps_at_the_limit_of_acceleration_and_stops_at_that_of_speed(axis, sign):
    limits = VehicleLimits(
        speed=(1.0, 0.9, 0.8, 0.3, 0.35), acceleration=(0.25, 0.15, 0.1, 0.05, 0.07), pitch=1.5
    )
    vehicle = Vehicle(np.zeros(3))
    vehicle.limits = limits
    command = np.zeros(6)
    entry = axis if axis < 3 else axis + 1
    command[entry] = sign * 7.0
    seconds = limits.speed[axis] / limits.acceleration[axis]

    def velocity():
        return float(np.concatenate([vehicle.linear, vehicle.angular])[entry])

    run(vehicle, command[:3], command[3:], round(seconds / 2 / DT))
    assert velocity() == pytest.approx(sign * limits.speed[axis] / 2, rel=0.02)
    run(vehicle, command[:3], command[3:], round(seconds / 2 / DT) + 1)
    assert velocity() == sign * limits.speed[axis]


@given(
    commands=st.lists(
        st.tuples(*[st.floats(-1e6, 1e6)] * 6, st.floats(0.0, 0.5)), min_size=1, max_size=30
    )
)
@settings(max_examples=40)
def test_limits_are_obeyed(commands):
    vehicle, limits = Vehicle(np.zeros(3)), VehicleLimits()
    for *command, dt in commands:
        before = np.concatenate([vehicle.linear, vehicle.angular[1:]])
        vehicle.step(command[:3], command[3:], dt)
        after = np.concatenate([vehicle.linear, vehicle.angular[1:]])
        assert (np.abs(after) <= limits.speed).all()
        slowest = np.array(limits.acceleration) * dt + 1e-12
        # At the end of its travel the pitch stops at once.
        stopped = np.array([False] * 3 + [abs(vehicle.pitch) == limits.pitch, False])
        assert ((np.abs(after - before) <= slowest) | stopped).all()
        assert abs(vehicle.pitch) <= limits.pitch
        assert np.isfinite(vehicle.position).all()


def test_pitch_stops_at_its_limit_and_comes_back():
    vehicle = Vehicle(np.zeros(3))
    run(vehicle, np.zeros(3), np.array([0, 1.0, 0]), 1000)
    assert vehicle.pitch == VehicleLimits().pitch
    assert vehicle.angular[1] == 0.0
    vehicle.step(np.zeros(3), np.array([0, -1.0, 0]), DT)
    assert vehicle.pitch < VehicleLimits().pitch


CURRENT = np.array([0.3, -0.2, 0.1])
WAVES = WaveSettings(wave_height_m=1.0, wave_period_s=6.0, wave_direction_deg=30.0, depth_m=4.0)
KINDS = pytest.mark.parametrize("kind", [Vehicle, BlueRov2, BlueRov2Wu])
STEP_S = 0.05


def command(t_s):
    """Return a twist that bends, dives and slips."""
    return np.array([0.4, 0.1 * np.sin(t_s), 0.1]), np.array([0.0, 0.1 * np.cos(t_s), 0.15])


def path_of(vehicle, seconds):
    """Return the positions on the way, a row a step."""
    path = [vehicle.position]
    for step in range(round(seconds / STEP_S)):
        vehicle.step(*command(step * STEP_S), STEP_S)
        path.append(vehicle.position)
    return np.array(path)


@KINDS
@pytest.mark.parametrize("sea", [Sea(CURRENT), Sea(CURRENT, WAVES)], ids=["current", "waves"])
def test_velocities_are_the_change_of_place_and_of_attitude(kind, sea):
    vehicle = kind([0.0, 0.0, 0.0], 0.5, 0.7, sea=sea)
    path_of(vehicle, 5)
    for _ in range(3):
        place, rotation = vehicle.position, vehicle.rotation
        linear, angular = rotation @ vehicle.linear, vehicle.angular
        vehicle.step([0.4, 0.1, 0.1], [0.0, 0.1, 0.2], 0.01)
        mean = (linear + vehicle.rotation @ vehicle.linear) / 2
        assert vehicle.position - place == pytest.approx(0.01 * mean, abs=1e-5)
        turn = Rotation.from_matrix(rotation.T @ vehicle.rotation).as_rotvec()
        assert turn == pytest.approx(0.01 * (angular + vehicle.angular) / 2, abs=1e-6)


@KINDS
@pytest.mark.parametrize(
    ("linear", "angular", "dt", "message"),
    [
        ([np.nan, 0, 0], [0, 0, 0], 0.1, "nan"),
        ([0, 0, 0], [0, 0, np.inf], 0.1, "inf"),
        ([0, 0], [0, 0, 0], 0.1, "triples"),
        ([0, 0, 0], [0, 0, 0], -0.1, "-0.1"),
        ([0, 0, 0], [0, 0, 0], np.nan, "nan"),
    ],
)
def test_bad_steps_are_refused_and_change_nothing(kind, linear, angular, dt, message):
    vehicle = kind([1, 2, 3])
    with pytest.raises(ValueError, match=message):
        vehicle.step(linear, angular, dt)
    assert (vehicle.position == [1, 2, 3]).all()
    assert (vehicle.linear == 0).all()


def test_an_idle_body_goes_round_in_the_orbit_of_the_water():
    # A circle of radius H / 2 exp(-k d), and forward by Stokes' drift, 2 pi k radius^2 a turn.
    waves = WaveSettings(wave_height_m=1.0, wave_period_s=6.0, depth_m=20.0)
    vehicle = Vehicle(np.zeros(3), sea=Sea(waves=waves))
    path = []
    for _ in range(round(6.0 / STEP_S)):
        vehicle.step(np.zeros(3), np.zeros(3), STEP_S)
        path.append(vehicle.position)
    wave_number = (2 * np.pi / 6.0) ** 2 / 9.82
    radius = 0.5 * np.exp(-20.0 * wave_number)
    assert np.ptp(path, axis=0) == pytest.approx([2 * radius, 0, 2 * radius], rel=0.02)
    drift = 2 * np.pi * wave_number * radius**2
    assert vehicle.position == pytest.approx([drift, 0, 0], abs=0.05 * drift)


@KINDS
@pytest.mark.parametrize("offset", [(-0.5, -0.2, 0.0), (0.0, 0.3, -0.1)])
def test_a_follower_of_the_leaders_kind_starts_behind_it_parallel_and_at_rest(kind, offset):
    leader = kind([3.0, -2.0, -5.0], pitch=0.1, yaw=2.0, sea=Sea(waves=WAVES))
    follower = start_behind(leader, (-6.0, 1.0, 0.5), offset)
    pose, roll = relative_pose(
        leader.position, leader.rotation, follower.position, follower.rotation
    )
    assert pose == pytest.approx([offset[0] - 6, offset[1] + 1, offset[2] + 0.5, 0, 0], abs=1e-12)
    assert roll == pytest.approx(0, abs=1e-12)
    assert (type(follower), follower.sea) == (kind, leader.sea)
    # At rest through the water, or over ground.
    still = start_behind(kind([0.0, 0.0, 0.0]), (-6.0, 0.0, 0.0))
    assert still.sea is STILL_SEA
    assert not still.linear.any()


def test_an_idle_vehicle_with_inertia_comes_to_move_as_the_water():
    sea = Sea(waves=WAVES)
    vehicle = BlueRov2(np.zeros(3), yaw=0.4, sea=sea)
    missing = []
    for _ in range(400):
        vehicle.step(np.zeros(3), np.zeros(3), STEP_S)
        missing.append(
            vehicle.rotation @ vehicle.linear - sea.velocity(vehicle.position, vehicle.t_s)
        )
    # It displaces 13.4 kg of water and weighs 13.5 kg; at 4 m the water does 0.33 m/s.
    assert np.abs(missing[-120:]).max() < 0.02
