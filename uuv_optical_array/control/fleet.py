"""Several followers of one leader: who follows whom at which station, and how near they may come.

A follower sees the lamp ahead of it and nothing else: the formation law keeps its distance to that
lamp, and no law keeps two followers apart that do not see each other. They stay apart because their
stations are: every pair of stations is `MIN_SEPARATION_M` and `STATION_ERROR_M` for each follower
between them apart. That holds in straight and steady motion, while no follower is farther off its
station than `STATION_ERROR_M`. It does not hold for one that lost its light and stopped.
"""

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Place

MIN_SEPARATION_M = 1.0  # between the centres of two vehicles, each some half a metre long
STATION_ERROR_M = 0.5  # how far a follower may be off its station
ARM_M: Place = (-5.5, 1.0, 0.0)  # from a vehicle to the next one on the port arm of a V
TAIL_M: Place = (-7.5, 0.0, 0.0)  # of a third follower that sees the leader
MAX_WITHOUT_CHAIN = 3


@dataclass(frozen=True)
class Follower:
    """One of a fleet.

    Parameters
    ----------
    number
        From 1.
    station_m
        In the frame of the lamp that it follows.
    ahead
        Number of the follower whose lamp that is; 0 for the leader.
    """

    number: int
    station_m: Place
    ahead: int = 0

    @property
    def namespace(self) -> str:
        """Return the namespace of its nodes."""
        return f"follower_{self.number}"

    @property
    def lamp_odometry(self) -> str:
        """Return the topic of the odometry of the vehicle that it follows, within the fleet's."""
        return f"follower_{self.ahead}/follower/odometry" if self.ahead else "leader/odometry"


def vee(followers: int, chain: bool = True) -> list[Follower]:
    """Return a V behind a leader: odd followers to port, even ones to starboard.

    Parameters
    ----------
    followers
        How many, >= 1.
    chain
        Whether the third and later followers are lit from the follower ahead on their arm. Without,
        all are lit by the leader: up to three, the third in the middle.

    Raises
    ------
    ValueError
        For too few, or more than the leader alone can light.
    """
    if followers < 1:
        raise ValueError(f"followers: {followers} is out of bounds; it must be at least 1")
    if not chain and followers > MAX_WITHOUT_CHAIN:
        raise ValueError(
            f"followers: {followers} without a chain is out of bounds; the leader's lamp lights "
            f"{MAX_WITHOUT_CHAIN}"
        )
    x, y, z = ARM_M
    fleet = [
        Follower(i, (x, y if i % 2 else -y, z), max(i - 2, 0)) for i in range(1, followers + 1)
    ]
    if not chain and followers == MAX_WITHOUT_CHAIN:
        fleet[-1] = Follower(MAX_WITHOUT_CHAIN, TAIL_M)
    check_separation(fleet)
    return fleet


def check_separation(fleet: list[Follower]) -> None:
    """Raise ValueError where two stations of a fleet are too near to each other.

    Parameters
    ----------
    fleet
        Each follower after the one ahead of it.
    """
    chains: dict[int, list[int]] = {0: []}
    places: dict[int, Array] = {0: np.zeros(3)}
    for follower in fleet:
        chains[follower.number] = [*chains[follower.ahead], follower.number]
        places[follower.number] = places[follower.ahead] + follower.station_m
    for one, other in combinations(places, 2):
        # What two have in common moves both alike.
        between = set(chains[one]) ^ set(chains[other])
        needed = MIN_SEPARATION_M + STATION_ERROR_M * len(between)
        distance = math.dist(places[one], places[other])
        if distance < needed:
            raise ValueError(
                f"fleet: the stations of {_name(one)} and {_name(other)} are {distance:.2f} m "
                f"apart; place them at least {needed:g} m apart"
            )


def _name(number: int) -> str:
    return f"follower_{number}" if number else "the leader"
