"""How the relative pose moves from frame to frame: at random, and by the follower's own commands.

The random part is white-noise acceleration (Y. Bar-Shalom, X.-R. Li and T. Kirubarajan,
*Estimation with Applications to Tracking and Navigation*, 2001, ch. 6).
"""

from bisect import bisect_left, bisect_right
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.core.messages import MAX_TWIST

LONG_AGO_NS = -(2**62)  # before any stamp
# Of a rate that is not known, m/s and rad/s: as at the start of a track.
RATE_STD = np.array([0.5, 0.5, 0.5, 0.1, 0.1])
STAMP = itemgetter(0)  # of a command
MAX_RATE = MAX_TWIST[:5]  # of surge, sway, heave, pitch and yaw rate


def walk_noise(walk: Array, step_s: float) -> Array:
    """Return the covariance that a random walk of the rate adds to pose and rate, ``(10, 10)``.

    - walk: covariance of the change of the rate in 1 s, m/s and rad/s, shape ``(5, 5)``.
    - step_s: length of the step, s, >= 0.
    """
    by_time = np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    return (by_time[:, None, :, None] * walk[:, None, :]).reshape(10, 10)


def swing(pose: Array) -> Array:
    """Return the slope of a pose's rate by that of its leader alone, shape ``(5, 5)``.

    - pose: ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.

    A leader that turns changes pitch and yaw, and swings the follower that does not turn with it.
    """
    x, y, z, _, _ = pose
    slope: Array = np.eye(5)
    slope[:3, PITCH], slope[:3, YAW] = (z, 0.0, -x), (-y, x, 0.0)
    return slope


def checked_rate(name: str, values: ArrayLike) -> Array:
    """Return a copy of five rates, m/s and rad/s; ValueError where they are out of bounds."""
    rate = np.array(values, dtype=float)
    if rate.shape != (5,) or not (np.abs(rate) <= MAX_RATE).all():
        raise ValueError(
            f"{name}: {rate.tolist()}; give three within +-{MAX_RATE[0]:g} m/s and two within "
            f"+-{MAX_RATE[-1]:g} rad/s"
        )
    return rate


class OwnMotion:
    """The follower's own motion: each command holds until the next."""

    def __init__(self) -> None:
        # By stamp; the first holds before its stamp, too.
        self._commands: list[tuple[int, Array]] = [(LONG_AGO_NS, np.zeros(5))]

    def command(self, stamp_ns: int, twist: ArrayLike) -> None:
        """Add a command as `Tracker.command` does, errors included; it replaces later ones."""
        twist = checked_rate("twist", twist)
        del self._commands[bisect_left(self._commands, stamp_ns, key=STAMP) :]
        self._commands.append((stamp_ns, twist))

    def forget(self, before_ns: int) -> None:
        """Drop the commands that no longer held at a stamp, ns."""
        del self._commands[: self._holding(before_ns)]

    def age_ns(self, stamp_ns: int) -> int:
        """Return how long ago the command that holds at a stamp was given, ns."""
        return stamp_ns - self._commands[self._holding(stamp_ns)][0]

    def twist(self, stamp_ns: int) -> Array:
        """Return the command that holds at a stamp, shape ``(5,)``."""
        return self._commands[self._holding(stamp_ns)][1]

    def displacement(self, start_ns: int, end_ns: int) -> Array:
        """Return the integral of the commands over a time, m and rad, shape ``(5,)``."""
        first = self._holding(start_ns)
        last = bisect_left(self._commands, end_ns, lo=first + 1, key=STAMP)
        stamps, twists = zip(*self._commands[first:last], strict=True)
        edges = np.array([0, *(stamp - start_ns for stamp in stamps[1:]), end_ns - start_ns])
        return np.diff(edges) * 1e-9 @ np.array(twists)

    def _holding(self, stamp_ns: int) -> int:
        return max(bisect_right(self._commands, stamp_ns, key=STAMP) - 1, 0)


def in_beacon(pose: Array, twist: Array) -> Array:
    """Turn a motion in the follower's frame into that of its pose.

    - pose: ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.
    - twist: surge, sway, heave, pitch and yaw, as rates or as a short way, shape ``(5,)``.
    - returned: in the units of `twist`, ``(5,)``; for small pitch, where turns add to the angles.
    """
    return np.concatenate([rotation_matrix(pose[PITCH], pose[YAW]) @ twist[:3], twist[3:]])
