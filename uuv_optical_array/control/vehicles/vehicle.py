"""The demonstration's kinematic vehicle, and where a follower of it starts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.control.vehicles.sea import STILL_SEA, Sea
from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix


@dataclass(frozen=True)
class VehicleLimits:
    """Limits of surge, sway, heave, pitch rate and yaw rate, of their change, and of the pitch.

    SI units, rad. Thrust, mass and drag of a BlueROV2 Heavy (`bluerov2`) allow more turn and more
    acceleration than these. Of 23 N m of yaw the drag takes 0.5 N m at 0.6 rad/s, and 0.6 rad/s^2
    take 0.4 N m; of 15 N m of pitch 0.7, 0.2, and 0.9 N m to hold the largest pitch. 1 m/s^2 takes
    20 of 86 N of surge, 21 of 86 N of sway and 32 of 122 N of heave. The speeds take 47, 28 and
    28 N by the drag of Wu (2018); by that of von Benzon et al. (2022) none of them can be held.
    """

    speed: tuple[float, ...] = (1.5, 1.0, 0.8, 0.6, 0.6)
    acceleration: tuple[float, ...] = (1.0, 1.0, 1.0, 0.6, 0.6)
    pitch: float = 0.8  # rad: here the righting moment wins


class Vehicle:
    """A body that obeys its twist command within limits; its roll stays zero.

    The command is a velocity through the water: the sea, which may change at any time, carries the
    vehicle along. Position and attitude are of ``base_link`` in the world, m and rad, by REP 103.
    """

    limits = VehicleLimits()  # of a small hovering vehicle

    def __init__(
        self, position: ArrayLike, pitch: float = 0.0, yaw: float = 0.0, sea: Sea = STILL_SEA
    ) -> None:
        self.position = np.array(position, dtype=float)
        self.pitch = float(pitch)
        self.yaw = float(yaw)
        self.roll = 0.0
        self.sea = sea
        self.t_s = 0.0  # on the clock of the sea
        # Through the water: surge, sway, heave, pitch rate, yaw rate.
        self._rate: Array = np.zeros(5)

    @property
    def rotation(self) -> Array:
        """Rotation from the body to the world, shape ``(3, 3)``."""
        return rotation_matrix(self.pitch, self.yaw, self.roll)

    @property
    def linear(self) -> Array:
        """Velocity over ground in the body frame, m/s, shape ``(3,)``."""
        over_ground: Array = self._rate[:3] + self.rotation.T @ self.sea.velocity(
            self.position, self.t_s
        )
        return over_ground

    @property
    def angular(self) -> Array:
        """Angular velocity in the body frame, rad/s, shape ``(3,)``."""
        _, _, _, pitch_rate, yaw_rate = self._rate
        # A pitched body that turns level turns about its x axis, too.
        return np.array([-yaw_rate * np.tan(self.pitch), pitch_rate, yaw_rate])

    def step(self, linear: ArrayLike, angular: ArrayLike, dt: float) -> None:
        """Move on by one step of the midpoint rule, s.

        The command is in the body frame, m/s and rad/s, shape ``(3,)`` each; the roll rate is
        ignored. ValueError for a command or step that is not finite, or a negative step.
        """
        rate = self._ramped(linear, angular, dt)
        mean = (self._rate + rate) / 2
        pitch = self.pitch + mean[PITCH] * dt / 2
        yaw_rate = mean[YAW] / np.cos(pitch)
        rotation = rotation_matrix(pitch, self.yaw + yaw_rate * dt / 2)
        water = self.sea.velocity(self.position, self.t_s + dt / 2)
        self.position = self.position + (rotation @ mean[:3] + water) * dt
        self.t_s += dt
        self.yaw += yaw_rate * dt
        most = self.limits.pitch
        self.pitch = float(np.clip(self.pitch + mean[PITCH] * dt, -most, most))
        if abs(self.pitch) == most:
            rate[PITCH] = 0.0
        self._rate = rate

    def _ramped(self, linear: ArrayLike, angular: ArrayLike, dt: float) -> Array:
        """Return the rate that a command leads to within the limits; arguments as of `step`."""
        command = np.concatenate([linear, np.asarray(angular)[1:]]).astype(float)
        if command.shape != (5,) or not np.isfinite(command).all():
            raise ValueError(f"command {linear!r}, {angular!r} is not two finite triples")
        if not 0 <= dt < np.inf:
            raise ValueError(f"dt: {dt!r} s is not a step forward in time")
        fastest, slew = np.array(self.limits.speed), dt * np.array(self.limits.acceleration)
        change = np.clip(command, -fastest, fastest) - self._rate
        ramped: Array = self._rate + np.clip(change, -slew, slew)
        return ramped


def start_behind(
    leader: Vehicle, station_m: ArrayLike, offset: ArrayLike = (-0.5, -0.2, 0.0)
) -> Vehicle:
    """Return a follower at rest, of the leader's kind and parallel to it, in its sea.

    Station and offset from it are in the leader's frame, m, shape ``(3,)`` each.
    """
    position = leader.position + leader.rotation @ np.add(station_m, offset)
    return type(leader)(position, leader.pitch, leader.yaw, leader.sea)
