"""The command that steers a vehicle to a goal, within its limits and off what it must not reach.

Behind a leader that turns fast the station moves sideways faster than a vehicle sways; then the bow
turns towards the way, while the array still sees the lamp, and surge does what sway cannot.

A lamp is kept off by the minimum distance, and a depth by its room above and below, by one rule:

- where there is no room left, nothing moves the follower that way, whatever the limits of
  acceleration say, and it backs off;
- else the speed lets the follower come to rest within the room by braking at
  ``max_acceleration_m_per_s2``, should the lamp stop dead;
- and also while the command falls to zero, should the light be lost.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.core.geometry import YAW, Array

# Largest angle of the bow off the lamp towards the way, so that the array sees the lamp, rad, and
# the gain of this turn relative to that of another.
CRAB_RAD, CRAB_GAIN = 0.7, 2.0


class KeepOff(NamedTuple):
    """What to keep off: a lamp, or a depth.

    - room_m: how much nearer the follower may come, m; below 0 it is too near.
    - away: unit vector from it, in the follower's axes, shape ``(3,)``.
    - drift: by which it makes the room grow, m/s.
    """

    room_m: float
    away: Array
    drift: float = 0.0


class Aim(NamedTuple):
    """What to steer to.

    - error: from the follower to the goal, m and rad, shape ``(5,)``.
    - speed: of the goal, m/s and rad/s, shape ``(5,)``, in the axes of `error`.
    - to_body: rotation from these axes to the follower's, shape ``(3, 3)``.
    - lamps: to keep off; the bow keeps the first in sight while it turns into the way.
    - depths: to keep off. Where all cannot be kept off, the last one counts most, and depths more
      than lamps.
    - straight: whether the way to the goal is to be straight, where it is faster than the limits.
      Else each axis goes as fast as it may: a goal that moves on is reached sooner by that, but
      with the bow down the way there leads up, as surge is cut and the heave that makes up is not.
      The bow does not turn into a straight way, because a search limits its turn.
    """

    error: Array
    speed: Array
    to_body: Array
    lamps: Sequence[KeepOff]
    depths: Sequence[KeepOff] = ()
    straight: bool = False


class Steering:
    """Steers within the limits of the settings."""

    def __init__(self, settings: FormationSettings) -> None:
        self._settings = s = settings
        turn, turn_acceleration = np.radians([s.max_turn_deg_per_s, s.max_acceleration_deg_per_s2])
        self._gain = np.repeat([s.position_gain_per_s, s.attitude_gain_per_s], [3, 2])
        self._max_rate = np.array(
            [s.max_surge_m_per_s, s.max_sway_m_per_s, s.max_sway_m_per_s, turn, turn]
        )
        self._max_slew = np.repeat([s.max_acceleration_m_per_s2, turn_acceleration], [3, 2])

    def rate(self, aim: Aim, before: Array, elapsed_s: float) -> Array:
        """Return the rate to command towards a goal, m/s and rad/s, shape ``(5,)``.

        - before: the last rate that was commanded, ``(5,)``, so long ago, s.
        """
        error, speed, to_body, lamps, depths, straight = aim
        wanted = self._gain * error + speed
        wanted[:3] = to_body @ wanted[:3]
        crab = 0.0
        if lamps and not straight:  # a search has a limit of its turn
            crab = self._crab(wanted[:2], -lamps[0].away, float(error[YAW]))
        if crab:
            wanted[YAW] = CRAB_GAIN * self._gain[YAW] * (error[YAW] + crab) + speed[YAW]
        if straight:
            most = self._max_rate[:3]
            wanted[:3] /= max(float(np.max(np.abs(wanted[:3]) / most)), 1.0)
        wanted = np.clip(wanted, -self._max_rate, self._max_rate)
        change = (wanted - before) * min(elapsed_s / self._settings.smoothing_s, 1.0)
        slew = self._max_slew * elapsed_s
        rate: Array = before + np.clip(change, -slew, slew)
        for off in (*lamps, *depths):
            rate[:3] = self._kept_off(rate[:3], before[:3], off, float(slew[0]))
        return rate

    def _crab(self, velocity: Array, to_lamp: Array, turn: float) -> float:
        """Return by how much to turn the bow towards a wanted velocity that exceeds the sway.

        - velocity: surge and sway, m/s, ``(2,)``; to_lamp: ``(3,)``; both as the bow is now.
        - turn: to the heading that is wanted, rad.
        - returned: from that heading, rad; 0 where no turn that keeps the lamp in sight helps.
        """
        speed, most = math.hypot(*velocity), self._settings.max_sway_m_per_s
        way = math.remainder(math.atan2(velocity[1], velocity[0]) - turn, 2 * math.pi)
        if speed * abs(math.sin(way)) <= most:
            return 0.0
        lamp = math.remainder(math.atan2(to_lamp[1], to_lamp[0]) - turn, 2 * math.pi)
        crab = math.copysign(abs(way) - math.asin(most / speed), way)
        crab = min(max(crab, min(lamp - CRAB_RAD, 0.0)), max(lamp + CRAB_RAD, 0.0))
        return crab if abs(math.sin(way - crab)) < abs(math.sin(way)) else 0.0

    def _kept_off(self, velocity: Array, before: Array, off: KeepOff, slew: float) -> Array:
        """Return the velocity nearest to one wanted that keeps off something, m/s.

        `before` is the last one that was commanded; both are in the follower's frame. The speed of
        backing off grows by `slew` at most, m/s.
        """
        s = self._settings
        room_m, away, drift = off
        if room_m > 0:
            braking = math.sqrt(2 * s.max_acceleration_m_per_s2 * room_m)
            allowed = min(room_m / s.blind_s, braking)
        else:
            allowed = s.position_gain_per_s * room_m
        allowed += min(drift, 0.0)  # a leader that comes nearer
        # Backing off gains speed as any motion does.
        allowed = max(allowed, min(-float(away @ before), 0.0) - slew)
        # Straight away from it, within the limits of all axes.
        fastest = float(np.min(self._max_rate[:3] / np.maximum(np.abs(away), 1e-9)))
        allowed = max(allowed, -fastest)
        closing = -float(away @ velocity)
        if closing <= allowed:
            return velocity
        # Within a box and on one side of a plane the nearest is off by some multiple of the plane's
        # normal, cut to the box. Closing in is linear in it but where an axis reaches its limit.
        most = self._max_rate[:3]
        of = np.abs(away) > 1e-9
        shifts = np.append(0.0, (np.copysign(most, away) - velocity)[of] / away[of])
        shifts = np.sort(np.maximum(shifts, 0.0))
        cut = np.clip(velocity + shifts[:, None] * away, -most, most)
        shift = np.interp(-allowed, cut @ away, shifts)
        return np.asarray(np.clip(velocity + shift * away, -most, most))


def bow_to(way: Array) -> tuple[float, float]:
    """Return the pitch and yaw, rad, at which the bow points along a way, shape ``(3,)``."""
    return -math.atan2(way[2], math.hypot(way[0], way[1])), math.atan2(way[1], way[0])


def polar(place: Array) -> tuple[float, Array]:
    """Return the range of a place, m, and the unit vector to it; astern where it is the origin."""
    range_m = float(np.linalg.norm(place))
    return range_m, place / range_m if range_m > 0 else np.array([-1.0, 0.0, 0.0])
