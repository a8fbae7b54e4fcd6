"""A lamp that is not the leader's, kept apart from it while it is seen.

Two equal lamps look alike. Only their paths and a sudden fall of the light, when one goes out,
separate them. What is left then is another one if it is not where the leader is expected; without a
fall, if the leader cannot have got there since its light was seen, however hard it speeds up,
brakes and turns. It stays so: what continues its path rather than the leader's is that lamp, even
later, when the leader might be there. It is not followed. It may move in company with the leader,
which is then beside it as before; the follower coasts and searches by that.

Where both shine, a pose is of a place between them, nearer to the one that is brighter where the
follower is. Where that is the leader's by far, it is the leader's pose.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.control.leader.motion import (
    CHANCE,
    LeaderMotion,
    plausible,
    seen_at,
    slopes,
    turning,
)
from uuv_optical_array.control.leader.sight import SightSettings
from uuv_optical_array.control.vehicles.vehicle import VehicleLimits
from uuv_optical_array.core.geometry import Array, rotation_matrix, wrapped

# By which a leader like the follower changes its velocity and turn, m/s^2 and rad/s^2.
MOST_CHANGE = np.array(VehicleLimits.acceleration)
# Nearer to where the leader is expected, m, and less turned, rad, a lamp is no other vehicle's, as
# there is no room for one.
ROOM = np.repeat([0.5, 0.1], [3, 2])
# Standard deviation of a place, m, beyond which a pose tells nothing of a lamp's motion.
KNOWN_M = 1.0
# Share of another lamp in the light of both up to which a pose of it is ours, and by how much of
# the way between them, as a standard deviation, that pose is elsewhere.
OURS, SHARE_STD = 0.25, 0.25
STEP_M = 1e-3  # of a slope


class OtherLamp:
    """Another lamp, from the first pose of it on.

    - motion: its own.
    - alone: whether its light is the only one in sight: that of two lamps is of neither.
    - place, heading: of the leader in its axes, as it was seen first, m, ``(3,)``, and rad,
      ``(2,)``.
    """

    def __init__(self, now_s: float, pose: Array, covariance: Array, leader: LeaderMotion) -> None:
        """Begin with a pose, ``(5,)``, and its covariance, beside a leader as it is expected."""
        self.motion, self.alone = LeaderMotion(now_s, pose, covariance), True
        place, heading = seen_at(leader.own, pose)
        self.place: Array = rotation_matrix(*heading).T @ (leader.place - place)
        self.heading = wrapped(leader.heading - heading, 1)

    def has(self, pose: Array, covariance: Array, leaders: Sequence[LeaderMotion]) -> bool:
        """Say whether a pose goes on from this lamp rather than from a leader's, and take it."""
        if not (self.alone and self.motion.expects(pose, covariance)):
            return False
        others = [leader.unlikeliness(pose, covariance) for leader in leaders]
        if self.motion.unlikeliness(pose, covariance) > min(others):
            return False
        if covariance[:3, :3].trace() < KNOWN_M**2:
            self.motion.see(pose, covariance)
        return True

    def lead(self, leader: LeaderMotion) -> bool:
        """Let a leader go on in its company; say whether that may be where it is."""
        place, heading = self.beside(leader.own)
        if not leader.reaches(place, heading):
            return False
        turn, rotation = self.motion.turn, rotation_matrix(*self.heading)
        leader.place, leader.heading, leader.turn = place, heading, turn
        leader.speed = rotation.T @ (self.motion.speed + turning(turn, self.place))
        return True

    def mixes(self, leader: LeaderMotion, sight: SightSettings) -> bool:
        """Say whether its share of the light is too large for a pose of a leader in its company."""
        return not self.alone and self._share(leader, leader.place, sight) > OURS

    def see_both(
        self, pose: Array, covariance: Array, leader: LeaderMotion, sight: SightSettings
    ) -> None:
        """Correct where a leader is by a pose of the light of both, which lies between them.

        Where the share changes fast with the place, the pose says little along the line between.
        """
        way, share = self._way(leader), self._share(leader, leader.place, sight)
        by_place = [self._share(leader, leader.place + each, sight) for each in STEP_M * np.eye(3)]
        sees = np.eye(5, 10)
        sees[:3, :3] += np.outer(way, np.subtract(by_place, share) / STEP_M)
        off, spread = leader.off(pose, covariance)
        off[:3] -= share * way
        spread[:3, :3] += SHARE_STD**2 * np.outer(way, way)
        leader.take(off, spread, sees)

    def _share(self, leader: LeaderMotion, place: Array, sight: SightSettings) -> float:
        """Return its share of the light of both, as that of a leader at a place falls off."""
        lamps = place + np.stack([np.zeros(3), self._way(leader)])
        headings = np.stack([leader.heading, leader.heading - self.heading])
        own, other = sight.light(leader.own[:3], lamps, headings)
        return 1 / (1 + math.exp(own - other))

    def _way(self, leader: LeaderMotion) -> Array:
        """Return the way from a leader in its company to this lamp, m, ``(3,)``."""
        return -rotation_matrix(*(leader.heading - self.heading)) @ self.place

    def beside(self, own: Array) -> tuple[Array, Array]:
        """Return place and heading of a leader in its company, by where the follower is."""
        place, heading = seen_at(own, self.motion.pose)
        return place + rotation_matrix(*heading) @ self.place, wrapped(heading + self.heading, 1)


def goes_on(expected: Array, pose: Array, covariance: Array, since_s: float) -> bool:
    """Say whether a lamp may be that of a leader that was expected in another pose, ``(5,)``.

    - covariance: the sum of those of both poses, ``(5, 5)``, of which one may be vague.
    - since_s: since the pose by which the leader is expected, s.
    """
    place, heading = seen_at(expected, pose)
    sees = slopes(pose, heading)
    off = np.concatenate([place, wrapped(heading, 1)])
    return within_reach(off, sees @ covariance @ sees.T, since_s)


def within_reach(off: Array, spread: Array, since_s: float) -> bool:
    """Say whether a leader can plausibly be so far off its way after a time, s.

    - off: of its place, m, and heading, rad, ``(5,)``; spread: its covariance, ``(5, 5)``.
    """
    reach = ROOM + MOST_CHANGE * since_s**2 / 2
    spread = spread + np.diag(np.square(reach)) / chdtri(1, CHANCE)
    return plausible(off, spread)
