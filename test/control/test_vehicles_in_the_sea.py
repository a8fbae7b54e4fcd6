"""Vehicles are carried by the water, the kinematic and the dynamic one alike."""

import numpy as np
import pytest

from uuv_optical_array.control.bluerov2 import BlueRov2
from uuv_optical_array.control.sea import STILL_SEA, Sea, WaveSettings
from uuv_optical_array.control.vehicles import Vehicle, start_behind

CURRENT = np.array([0.3, -0.2, 0.1])
WAVES = WaveSettings(wave_height_m=1.0, wave_period_s=6.0, wave_direction_deg=30.0, depth_m=4.0)
KINDS = pytest.mark.parametrize("kind", [Vehicle, BlueRov2])
DT = 0.05


def command(t_s):
    """Return a twist that bends, dives and slips."""
    return np.array([0.4, 0.1 * np.sin(t_s), 0.1]), np.array([0.0, 0.1 * np.cos(t_s), 0.15])


def swim(vehicle, seconds):
    """Return the positions on the way, a row a step."""
    path = [vehicle.position]
    for step in range(round(seconds / DT)):
        vehicle.step(*command(step * DT), DT)
        path.append(vehicle.position)
    return np.array(path)


@KINDS
@pytest.mark.parametrize("sea", [Sea(CURRENT), Sea(CURRENT, WAVES)], ids=["current", "waves"])
def test_velocity_over_ground_is_the_change_of_place(kind, sea):
    vehicle = kind([0.0, 0.0, 0.0], 0.1, 0.7, sea=sea)
    swim(vehicle, 5)
    for _ in range(3):
        before = vehicle.position, vehicle.rotation @ vehicle.linear
        vehicle.step([0.4, 0.1, 0.1], [0.0, 0.0, 0.0], 0.01)
        mean = (before[1] + vehicle.rotation @ vehicle.linear) / 2
        assert vehicle.position - before[0] == pytest.approx(0.01 * mean, abs=1e-5)


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
    for _ in range(round(6.0 / DT)):
        vehicle.step(np.zeros(3), np.zeros(3), DT)
        path.append(vehicle.position)
    wave_number = (2 * np.pi / 6.0) ** 2 / 9.82
    radius = 0.5 * np.exp(-20.0 * wave_number)
    assert np.ptp(path, axis=0) == pytest.approx([2 * radius, 0, 2 * radius], rel=0.02)
    drift = 2 * np.pi * wave_number * radius**2
    assert vehicle.position == pytest.approx([drift, 0, 0], abs=0.05 * drift)


@KINDS
def test_a_follower_starts_as_the_leader_s_like_in_its_sea(kind):
    leader = kind([3.0, 0.0, 0.0], yaw=0.5, sea=Sea(CURRENT))
    follower = start_behind(leader, 6.0)
    assert type(follower) is kind
    assert (follower.sea, follower.limits) == (leader.sea, leader.limits)
    assert start_behind(kind([0.0, 0.0, 0.0]), 6.0).sea is STILL_SEA


def test_a_kinematic_vehicle_in_a_current_moves_as_in_still_water_and_drifts():
    still, carried = (swim(Vehicle(np.zeros(3), sea=sea), 10) for sea in (STILL_SEA, Sea(CURRENT)))
    times = DT * np.arange(len(still))[:, None]
    assert carried - still == pytest.approx(times * CURRENT, abs=1e-9)


def test_an_idle_vehicle_with_inertia_comes_to_move_as_the_water():
    sea = Sea(waves=WAVES)
    vehicle = BlueRov2(np.zeros(3), yaw=0.4, sea=sea)
    missing = []
    for _ in range(400):
        vehicle.step(np.zeros(3), np.zeros(3), DT)
        missing.append(
            vehicle.rotation @ vehicle.linear - sea.velocity(vehicle.position, vehicle.t_s)
        )
    # It displaces 13.4 kg of water and weighs 13.5 kg; at 4 m the water does 0.33 m/s.
    assert np.abs(missing[-120:]).max() < 0.02
