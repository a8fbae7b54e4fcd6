"""A lamp that is not the leader's, held apart from it for as long as it is seen to go on.

Two equal lamps look alike, so that only their ways tell them apart. A lamp where the leader cannot
have got since its light was seen, however hard it speeds up, brakes and turns, is another one. It
stays so: what goes on from it rather than from the leader is that lamp, also later, when the leader
might be there. It is not followed. A search takes into account that it may be in company with the
leader, which would then be beside it as before.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.control.leader.motion import CHANCE, LeaderMotion, seen_at, slopes
from uuv_optical_array.control.vehicles.vehicle import VehicleLimits
from uuv_optical_array.core.geometry import Array, rotation_matrix, wrapped

# By which a leader like the follower changes its velocity and turn, m/s^2 and rad/s^2.
MOST_CHANGE = np.array(VehicleLimits.acceleration)
# Nearer to where the leader is expected, m, and less turned, rad, a lamp is no other vehicle's, as
# there is no room for one.
ROOM = np.repeat([0.5, 0.1], [3, 2])


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
        self.motion.see(pose, covariance)
        return True

    def beside(self, own: Array) -> tuple[Array, Array]:
        """Return place and heading of a leader in its company, by where the follower is."""
        place, heading = seen_at(own, self.motion.pose)
        return place + rotation_matrix(*heading) @ self.place, wrapped(heading + self.heading, 1)


def goes_on(expected: Array, pose: Array, covariance: Array, since_s: float) -> bool:
    """Say whether a lamp may be that of a leader that was expected in another pose, ``(5,)``.

    - covariance: of `pose`, ``(5, 5)``. The errors of poses within a second are alike, so that
      their difference errs by no more than one of them.
    - since_s: since the pose by which the leader is expected, s.
    """
    place, heading = seen_at(expected, pose)
    sees = slopes(pose, heading)
    off = np.concatenate([place, wrapped(heading, 1)])
    return within_reach(off, sees @ covariance @ sees.T, since_s)


def within_reach(off: Array, spread: Array, since_s: float) -> bool:
    """Say whether a leader may have got off its way by so much in a time, s, but for a chance.

    - off: of its place, m, and heading, rad, ``(5,)``; spread: its covariance, ``(5, 5)``.
    """
    reach = ROOM + MOST_CHANGE * since_s**2 / 2
    spread = spread + np.diag(np.square(reach)) / chdtri(1, CHANCE)
    return float(off @ np.linalg.solve(spread, off)) <= chdtri(5, CHANCE)
