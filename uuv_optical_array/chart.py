"""Coordinates of the pose in which an image is nearly linear.

In ``(x, y, z, pitch, yaw)`` the poses that explain an image lie along a bent valley, far narrower
than the bend: the array knows where the lamp stands in its own view and how bright it is, much
better than where in the beam it floats. The chart takes just these: the lamp's azimuth and
elevation seen from the array's centre, the logarithm of the brightness there, pitch and yaw. In
it a quadratic model holds, so fits arrive in few steps and a Gaussian describes what they know.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.pose import PITCH, YAW, Array, rotation_matrix

AZIMUTH, ELEVATION, DIMNESS = range(3)


@dataclass(frozen=True)
class Chart:
    """The chart ``(azimuth, elevation, dimness, pitch, yaw)`` of an array under a lamp.

    The dimness is ``ln r + K r / 2 + eta^2 / (4 sigma^2)``, half the logarithm of what distance,
    water and beam take from the light at the array's centre.

    Parameters
    ----------
    centre
        The array's centre in ``base_link``, m, shape ``(3,)``.
    beam_sigma_rad
        Standard deviation of the beam, rad, > 0.
    k_per_m
        Attenuation, 1/m, >= 0.
    """

    centre: Array
    beam_sigma_rad: float
    k_per_m: float

    def from_pose(self, poses: Array, roll: ArrayLike) -> Array:
        """Return the coordinates of poses, shape ``(..., 5)``."""
        rotation = rotation_matrix(poses[..., PITCH], poses[..., YAW], roll)
        to_body = np.swapaxes(rotation, -1, -2)
        sight = -(to_body @ poses[..., :3, None])[..., 0] - self.centre
        array_in_beacon = -(rotation @ sight[..., None])[..., 0]
        level = np.hypot(sight[..., 0], sight[..., 1])
        range_m = np.hypot(level, sight[..., 2])
        off_axis = np.arctan2(
            np.hypot(array_in_beacon[..., 1], array_in_beacon[..., 2]), -array_in_beacon[..., 0]
        )
        dimness = np.log(range_m) + self.k_per_m / 2 * range_m
        return np.stack(
            [
                np.arctan2(sight[..., 1], sight[..., 0]),
                np.arctan2(sight[..., 2], level),
                dimness + (off_axis / (2 * self.beam_sigma_rad)) ** 2,
                poses[..., PITCH],
                poses[..., YAW],
            ],
            axis=-1,
        )

    def to_pose(self, coordinates: Array, roll: ArrayLike) -> tuple[Array, Array]:
        """Return the poses at coordinates, and how they change with them.

        Parameters
        ----------
        coordinates
            Shape ``(..., 5)``.
        roll
            Roll of the follower, rad.

        Returns
        -------
        poses : Array
            m and rad, shape ``(..., 5)``.
        derivatives : Array
            Of the poses by the coordinates, shape ``(..., 5, 5)``.
        """
        azimuth, elevation, dimness, pitch, yaw = np.moveaxis(coordinates, -1, 0)
        rotation = rotation_matrix(pitch, yaw, roll)
        cos_a, sin_a = np.cos(azimuth), np.sin(azimuth)
        cos_e, sin_e = np.cos(elevation), np.sin(elevation)
        # Sight line to the lamp and its derivatives, in base_link; then all in beacon.
        body = np.empty((*azimuth.shape, 3, 3))
        body[..., 0, 0], body[..., 1, 0], body[..., 2, 0] = cos_e * cos_a, cos_e * sin_a, sin_e
        body[..., 0, 1], body[..., 1, 1], body[..., 2, 1] = -cos_e * sin_a, cos_e * cos_a, 0.0
        body[..., 0, 2], body[..., 1, 2], body[..., 2, 2] = -sin_e * cos_a, -sin_e * sin_a, cos_e
        turned = -(rotation @ body)
        place = turned[..., 0]  # of the array's centre, seen from the lamp
        across = np.hypot(place[..., 1], place[..., 2])
        off_axis = np.arctan2(across, -place[..., 0])
        range_m = self._range(dimness - (off_axis / (2 * self.beam_sigma_rad)) ** 2)
        centre = rotation @ self.centre
        poses = np.empty(coordinates.shape)
        poses[..., :3] = range_m[..., None] * place - centre
        poses[..., 3:] = coordinates[..., 3:]

        # How place and centre turn: azimuth, elevation, then pitch about Rz y and yaw about z.
        moves = np.zeros((*azimuth.shape, 3, 5))
        moves[..., AZIMUTH] = turned[..., 1]
        moves[..., ELEVATION] = turned[..., 2]
        sin_y, cos_y = np.sin(yaw), np.cos(yaw)
        swings = np.zeros((*azimuth.shape, 3, 5))
        for turning, turns in ((place, moves), (centre, swings)):
            x, y, z = turning[..., 0], turning[..., 1], turning[..., 2]
            turns[..., 0, PITCH] = cos_y * z
            turns[..., 1, PITCH] = sin_y * z
            turns[..., 2, PITCH] = -sin_y * y - cos_y * x
            turns[..., 0, YAW] = -y
            turns[..., 1, YAW] = x
        # d(eta^2 / 2) = (eta / sin eta) d(place_x); on the axis the ratio is 1.
        ratio = off_axis / np.maximum(across, 1e-300)
        ratio = np.where(across > 1e-9, ratio, 1.0)
        stretch = moves[..., 0, :] * (-0.5 / self.beam_sigma_rad**2 * ratio)[..., None]
        stretch[..., DIMNESS] += 1.0
        stretch *= (1 / (1 / range_m + self.k_per_m / 2))[..., None]
        derivatives = np.zeros((*azimuth.shape, 5, 5))
        derivatives[..., :3, :] = (
            range_m[..., None, None] * moves + place[..., None] * stretch[..., None, :] - swings
        )
        derivatives[..., 3, PITCH] = derivatives[..., 4, YAW] = 1.0
        return poses, derivatives

    def _range(self, target: Array) -> Array:
        """Solve ``ln r + K r / 2 = target`` by Newton's method in ln r, from below the root."""
        if self.k_per_m == 0:
            return np.exp(target)
        log_range = target - np.log1p(self.k_per_m / 2 * np.exp(np.minimum(target, 300.0)))
        for _ in range(4):
            water = self.k_per_m / 2 * np.exp(log_range)
            log_range = log_range - (log_range + water - target) / (1 + water)
        return np.exp(log_range)
