"""Formations: a V whose stations keep apart, and the numbers of followers that make one."""

import math
from itertools import combinations

import numpy as np
import pytest

from uuv_optical_array.control.fleet import (
    CHAINED_ERROR_M,
    MIN_SEPARATION_M,
    STATION_ERROR_M,
    vee,
)
from uuv_optical_array.control.follow_record import least_distance


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


@pytest.mark.parametrize(("count", "chain"), [(0, True), (-1, False), (5, True), (4, False)])
def test_a_number_that_makes_no_v_is_refused(count, chain):
    with pytest.raises(ValueError, match=rf"followers: {count} .*is out of bounds"):
        vee(count, chain)


def test_the_least_distance_is_that_of_paths_at_one_time():
    # They cross each other's path, one second after the other, and are nearest at 1.5 s.
    one = {t: np.array([t, 0.0, 0.0]) for t in (0.0, 1.0, 1.5, 2.0, 3.0)}
    other = {t: np.array([2.0, t - 1.0, 0.0]) for t in (0.5, 2.5, 3.5)}
    assert least_distance([one, other, {}]) == pytest.approx(math.sqrt(0.5))
    assert least_distance([one]) == math.inf
