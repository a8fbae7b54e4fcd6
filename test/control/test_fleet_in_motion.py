"""A V in closed loop: its bounds through the leader's turn, and then a follower in the dark."""

from itertools import combinations

import numpy as np
import pytest
from followers import TrackedLaw, relative

from uuv_optical_array.control.fleet import CHAINED_ERROR_M, MIN_SEPARATION_M, STATION_ERROR_M, vee
from uuv_optical_array.control.formation import FormationSettings
from uuv_optical_array.control.vehicles import Vehicle, leader_twist, start_behind

TICK_S = 0.1
# About the bound on a frame's pose in the scene `formation`, 1 m beside the beam.
STD = np.array([0.2, 0.12, 0.12, *np.radians([2.0, 2.0])])


SETTLED, DARK = round(10 / TICK_S), round(33 / TICK_S)  # on station, and after the turn


def swim(fleet, seconds):
    """Let a fleet swim; the first follower loses its light at the tick `DARK`.

    Returns the positions of all vehicles, ``(1 + n, ticks, 3)``, and how far the followers were off
    their stations, m, ``(n, ticks)``.
    """
    rng, vehicles, laws = np.random.default_rng(1), [Vehicle(np.zeros(3))], []
    for follower in fleet:
        vehicles.append(start_behind(vehicles[follower.ahead], follower.station_m))
        laws.append(TrackedLaw(FormationSettings(station_m=follower.station_m)))
    ticks = round(seconds / TICK_S)
    places, errors = np.empty((len(vehicles), ticks, 3)), np.empty((len(fleet), ticks))
    for tick in range(ticks):
        now = tick * TICK_S
        twists = [leader_twist(now)]
        for i, (follower, law) in enumerate(zip(fleet, laws, strict=True)):
            pose = relative(vehicles[follower.ahead], vehicles[follower.number])
            errors[i, tick] = np.linalg.norm(pose[:3] - follower.station_m)
            if follower.number != 1 or tick < DARK:
                law.update(now, pose + STD * rng.standard_normal(5), np.diag(STD**2))
            twists.append(law.command(now) or (np.zeros(3), np.zeros(3)))
        for vehicle, twist, path in zip(vehicles, twists, places, strict=True):
            path[tick] = vehicle.position
            vehicle.step(*twist, TICK_S)
    return places, errors


@pytest.fixture(scope="module")
def run():
    return swim(vee(3), 46.0)


def test_on_station_a_v_keeps_its_bounds_through_a_turn(run):
    _, errors = run
    most = errors[:, SETTLED:DARK].max(axis=1)
    assert (most < [STATION_ERROR_M, STATION_ERROR_M, CHAINED_ERROR_M]).all()


def test_no_two_vehicles_come_too_near_even_when_one_is_in_the_dark(run):
    places, _ = run
    for one, other in combinations(places, 2):
        assert np.linalg.norm(one - other, axis=1).min() > MIN_SEPARATION_M
    behind_it = np.linalg.norm(places[3] - places[1], axis=1)
    assert behind_it.min() > FormationSettings().min_distance_m


def test_a_follower_in_the_dark_stops_and_so_does_the_one_behind_it(run):
    places, _ = run
    speeds = np.linalg.norm(places[:, -1] - places[:, -11], axis=1) / (10 * TICK_S)
    assert speeds[1] == 0.0
    assert speeds[3] < 0.1
    assert speeds[[0, 2]].min() > 0.4
