"""Formations: a V whose stations keep apart, and the numbers of followers that make one."""

import math
from itertools import combinations

import numpy as np
import pytest
from followers import TrackedLaw, relative

from uuv_optical_array.control.fleet import MIN_SEPARATION_M, vee
from uuv_optical_array.control.follow_record import least_distance
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.vehicles.leader_path import leader_twist
from uuv_optical_array.control.vehicles.vehicle import Vehicle, start_behind
from uuv_optical_array.core.geometry import rotation_matrix
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.others import Other, sight
from uuv_optical_array.forward.scene import load_scene

# How far a follower may be off its station: one that sees the leader, and one that sees another.
STATION_ERROR_M, CHAINED_ERROR_M = 0.5, 1.0


def places(fleet):
    """Return where leader and followers are when each is on its station."""
    found = [np.zeros(3)]
    for follower in fleet:
        found.append(found[follower.ahead] + follower.station_m)
    return found


def test_a_v_opens_astern_and_its_arms_mirror_each_other():
    leader, *found = places(vee(4))
    port, starboard = np.array(found[::2]), np.array(found[1::2])
    assert port == pytest.approx(starboard * [1, -1, 1])
    assert (np.diff([leader, *port], axis=0) @ np.diag([-1, 1, 0]) >= 0).all()
    assert (port[:, 1] > 0).all()
    for count in (1, 2, 3):
        assert vee(count) == vee(4)[:count]


def test_each_is_told_of_all_vehicles_but_itself_and_the_one_it_follows():
    fleet = vee(3)
    first, _, third = fleet
    assert first.others(fleet) == ["follower_2/follower/odometry", "follower_3/follower/odometry"]
    assert third.others(fleet) == ["leader/odometry", "follower_2/follower/odometry"]
    assert vee(1)[0].others(vee(1)) == []


def test_topics_of_a_chain_are_those_of_the_follower_ahead():
    first, _, third = vee(3)
    assert (first.namespace, first.lamp_odometry) == ("follower_1", "leader/odometry")
    assert third.lamp_odometry == "follower_1/follower/odometry"
    assert (first.lamp_frame, third.lamp_frame) == (
        "leader/base_link",
        "follower_1/follower/base_link",
    )
    assert {follower.lamp_odometry for follower in vee(3, chain=False)} == {"leader/odometry"}


@pytest.mark.parametrize(("count", "chain"), [(2, True), (3, True), (4, True), (3, False)])
def test_followers_within_the_error_of_their_stations_keep_the_distance(count, chain):
    fleet = vee(count, chain)
    found, between = places(fleet), [set()]  # the followers between each and the leader
    for follower in fleet:
        between.append({*between[follower.ahead], follower.number})
    for one, other in combinations(range(count + 1), 2):
        # What two have in common moves both alike; at worst the others err towards each other.
        apart = between[one] ^ between[other]
        errors = [CHAINED_ERROR_M if fleet[n - 1].ahead else STATION_ERROR_M for n in apart]
        assert math.dist(found[one], found[other]) >= MIN_SEPARATION_M + sum(errors)


@pytest.mark.parametrize(("count", "chain"), [(4, True), (3, False)])
def test_near_its_station_each_sees_its_own_lamp_whole_and_no_other(count, chain):
    rng, model = np.random.default_rng(4), ForwardModel(load_scene("formation"))
    fleet = vee(count, chain)
    for _ in range(40):
        off = rng.uniform(-1, 1, (count + 1, 3)) * STATION_ERROR_M / math.sqrt(3)
        turned = rng.uniform(-0.15, 0.15, (count + 1, 2))
        vehicles = [
            Other(place + error, rotation_matrix(*turn), code=code)
            for code, (place, error, turn) in enumerate(
                zip(places(fleet), off, turned, strict=True)
            )
        ]
        for follower in fleet:
            me, lamp = vehicles[follower.number], vehicles[follower.ahead]
            others = [each for each in vehicles if each is not me and each is not lamp]
            at = me.position, me.rotation
            seen, alone = sight(model, at, lamp, others), sight(model, at, lamp)
            np.testing.assert_allclose(seen.light, alone.light, rtol=1e-12)
            assert seen.light.max() > 20 + 5  # counts: more than darkness and `min_peak_counts`
            assert 2 * (seen.light - 20 + seen.beside).max() < 16383  # the peaks of all lamps


@pytest.mark.parametrize(("count", "chain"), [(0, True), (-1, False), (5, True), (4, False)])
def test_a_number_that_makes_no_v_is_refused(count, chain):
    bounds = "4 in a chain" if chain else "3 without a chain"
    with pytest.raises(ValueError, match=f"followers: {count} is out of .*from 1 to {bounds}$"):
        vee(count, chain)


def test_the_least_distance_is_that_of_paths_at_one_time():
    # They cross each other's path, one second after the other, and are nearest at 1.5 s.
    one = {t: np.array([t, 0.0, 0.0]) for t in (0.0, 1.0, 1.5, 2.0, 3.0)}
    other = {t: np.array([2.0, t - 1.0, 0.0]) for t in (0.5, 2.5, 3.5)}
    assert least_distance([one, other, {}]) == pytest.approx(math.sqrt(0.5))
    assert least_distance([one]) == math.inf


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
