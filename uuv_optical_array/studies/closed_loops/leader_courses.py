"""Courses of a leader in the closed loop: speeds and turn rates by time, linear between points."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from uuv_optical_array.control.vehicles.leader_path import LEADER_SPEED_M_PER_S
from uuv_optical_array.core.geometry import Array

# Values by time: (s, value), ..., linear between, the first before them and the last after.
Points: TypeAlias = tuple[tuple[float, float], ...]

SPEED = LEADER_SPEED_M_PER_S
RAMP_M_PER_S2 = 0.3  # of a leader that changes its speed
RAMP_S = 0.5  # in which it begins to turn, sway or sink, and ends


def at(points: Points, t_s: float) -> float:
    """Return the value of points at a time, s."""
    times_s, values = zip(*points, strict=True)
    return float(np.interp(t_s, times_s, values))


@dataclass(frozen=True)
class Course:
    """A leader's motion by its time on the path: speeds, m/s, and turn rates, rad/s.

    It is a `LeaderPath`.
    """

    surge: Points
    sway: Points = ((0.0, 0.0),)
    heave: Points = ((0.0, 0.0),)
    pitch: Points = ((0.0, 0.0),)
    yaw: Points = ((0.0, 0.0),)

    def __call__(self, t_s: float) -> tuple[Array, Array]:
        """Return the twist at a time, s."""
        linear = [at(points, t_s) for points in (self.surge, self.sway, self.heave)]
        return np.array(linear), np.array([0.0, at(self.pitch, t_s), at(self.yaw, t_s)])


def speeds(*then: tuple[float, float]) -> Points:
    """Return a surge from rest to the demonstration's speed, and to others from times on, s."""
    points, last = [(0.0, 0.0)], 0.0
    for since_s, speed in ((0.0, SPEED), *then):
        points += [(since_s, last), (since_s + abs(speed - last) / RAMP_M_PER_S2, speed)]
        last = speed
    return tuple(points)


def pulse(since_s: float, until_s: float, value: float) -> Points:
    """Return a value between two times, reached and left within `RAMP_S`, and 0 else."""
    inside = (since_s + RAMP_S, value), (until_s, value)
    return ((since_s, 0.0), *inside, (until_s + RAMP_S, 0.0))


def turning(since_s: float, rate_deg_per_s: float) -> tuple[Course, float]:
    """Return a straight way with a turn by a right angle, and when this ends, s."""
    until_s = since_s + 90.0 / rate_deg_per_s
    return Course(speeds(), yaw=pulse(since_s, until_s, np.radians(rate_deg_per_s))), until_s
