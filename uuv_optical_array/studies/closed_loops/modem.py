"""A leader that sends its motion, as by a modem: seldom, late, and not exactly."""

import math

import numpy as np

from uuv_optical_array.control.leader.told_motion import Message
from uuv_optical_array.control.vehicles.vehicle import Vehicle

PERIOD_S, LATE_S = 1.0, 0.5
STDS = np.repeat([0.05, math.radians(1.0)], 3)  # of velocity, m/s, and turn, rad/s


class Modem:
    """What a follower hears of a vehicle's motion through the water, in the order of its times."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._told_s = -math.inf
        self._under_way: list[tuple[float, Message]] = []

    def __call__(self, vehicle: Vehicle, t_s: float) -> Message | None:
        """Return what arrives at a time, s; ``None``: nothing."""
        if t_s - self._told_s >= PERIOD_S - 1e-6:
            self._told_s = t_s
            water = vehicle.sea.velocity(vehicle.position, vehicle.t_s)
            through = vehicle.linear - vehicle.rotation.T @ water
            twist = np.concatenate([through, vehicle.angular]) + STDS * self._rng.normal(size=6)
            message = Message(t_s, twist[:3], twist[3:], np.diag(STDS**2))
            self._under_way.append((t_s + LATE_S, message))
        if self._under_way and t_s >= self._under_way[0][0] - 1e-6:
            return self._under_way.pop(0)[1]
        return None
