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
from scipy.special import wrightomega

from uuv_optical_array.light import lamp_in_body, pitched
from uuv_optical_array.pose import Array, rotation_matrix

AZIMUTH, ELEVATION, DIMNESS, PITCH, YAW = range(5)


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
        lamp, axis = lamp_in_body(poses, roll)
        sight = lamp - self.centre
        level = np.hypot(sight[..., 0], sight[..., 1])
        range_m = np.hypot(level, sight[..., 2])
        coordinates = np.empty(poses.shape)
        coordinates[..., AZIMUTH] = np.arctan2(sight[..., 1], sight[..., 0])
        coordinates[..., ELEVATION] = np.arctan2(sight[..., 2], level)
        coordinates[..., DIMNESS] = np.log(range_m) + self.k_per_m / 2 * range_m
        coordinates[..., DIMNESS] += self._beam_loss(sight / range_m[..., None], axis)[0]
        coordinates[..., PITCH:] = poses[..., PITCH:]
        return coordinates

    def to_pose(self, coordinates: Array, roll: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the poses at coordinates, and with them lamp and beam axis.

        Parameters
        ----------
        coordinates
            Shape ``(..., 5)``.
        roll
            Roll of the follower, rad, broadcast to ``(...)``.

        Returns
        -------
        poses : Array
            m and rad, shape ``(..., 5)``.
        lamp, axis : Array
            As `light.lamp_in_body`, shape ``(..., 3)`` each.
        """
        rotation = rotation_matrix(coordinates[..., PITCH], coordinates[..., YAW], roll)
        sight, _ = self._sight(coordinates)
        axis = -rotation[..., 0, :]
        loss, _ = self._beam_loss(sight, axis)
        range_m = self._range(coordinates[..., DIMNESS] - loss)
        lamp = range_m[..., None] * sight + self.centre
        poses = np.empty(coordinates.shape)
        poses[..., :3] = -(rotation @ lamp[..., None])[..., 0]
        poses[..., PITCH:] = coordinates[..., PITCH:]
        return poses, lamp, axis

    def to_lamp(self, coordinates: Array, roll: ArrayLike) -> tuple[Array, Array, Array]:
        """Return lamp and beam axis in ``base_link``, and how they change with the coordinates.

        Parameters
        ----------
        coordinates
            Shape ``(..., 5)``.
        roll
            Roll of the follower, rad.

        Returns
        -------
        lamp, axis : Array
            As `light.lamp_in_body`, shape ``(..., 3)`` each.
        derivatives : Array
            Of lamp and axis, six rows, by the coordinates, shape ``(..., 6, 5)``.
        """
        rotation = rotation_matrix(coordinates[..., PITCH], coordinates[..., YAW], roll)
        axis = -rotation[..., 0, :]
        sight, sight_turns = self._sight(coordinates)
        loss, ratio = self._beam_loss(sight, axis)
        range_m = self._range(coordinates[..., DIMNESS] - loss)
        derivatives = np.zeros((*axis.shape[:-1], 6, 5))
        derivatives[..., 3:, PITCH] = pitched(axis, roll)
        derivatives[..., 3:, YAW] = rotation[..., 1, :]
        # How the loss to the beam's profile, and so the range at this dimness, changes.
        stretch = np.empty(coordinates.shape)
        stretch[..., :2] = (axis[..., None, :] @ sight_turns)[..., 0, :]
        stretch[..., DIMNESS] = 0.0
        stretch[..., PITCH:] = (sight[..., None, :] @ derivatives[..., 3:, PITCH:])[..., 0, :]
        stretch *= -ratio[..., None]
        stretch[..., DIMNESS] = 1.0
        stretch *= (1 / (1 / range_m + self.k_per_m / 2))[..., None]
        derivatives[..., :3, :] = sight[..., None] * stretch[..., None, :]
        derivatives[..., :3, :2] += range_m[..., None, None] * sight_turns
        return range_m[..., None] * sight + self.centre, axis, derivatives

    def _sight(self, coordinates: Array) -> tuple[Array, Array]:
        """Return the unit vector to the lamp, and its derivatives by azimuth and elevation."""
        azimuth, elevation = coordinates[..., AZIMUTH], coordinates[..., ELEVATION]
        cos_a, sin_a = np.cos(azimuth), np.sin(azimuth)
        cos_e, sin_e = np.cos(elevation), np.sin(elevation)
        sight = np.empty((*azimuth.shape, 3))
        turns = np.empty((*azimuth.shape, 3, 2))
        sight[..., 0], sight[..., 1], sight[..., 2] = cos_e * cos_a, cos_e * sin_a, sin_e
        turns[..., 0, 0], turns[..., 1, 0], turns[..., 2, 0] = -sight[..., 1], sight[..., 0], 0.0
        turns[..., 0, 1], turns[..., 1, 1], turns[..., 2, 1] = -sin_e * cos_a, -sin_e * sin_a, cos_e
        return sight, turns

    def _beam_loss(self, sight: Array, axis: Array) -> tuple[Array, Array]:
        """Return ``eta^2 / (4 sigma^2)``, and its derivative by ``sight . axis``."""
        cosine = -(sight * axis).sum(axis=-1)
        across = sight + cosine[..., None] * axis
        sine = np.sqrt((across * across).sum(axis=-1))
        off_axis = np.arctan2(sine, cosine)
        # eta / sin(eta), 1 on the axis.
        ratio = np.where(sine > 1e-9, off_axis / np.maximum(sine, 1e-9), 1.0)
        scale = 0.25 / self.beam_sigma_rad**2
        return scale * off_axis**2, 2 * scale * ratio

    def _range(self, target: Array) -> Array:
        """Solve ``ln r + K r / 2 = target``: with w = K r / 2, ln w + w is known."""
        # From a millimetre to a hundred kilometres: a fit that strays farther finds no light.
        target = np.clip(target, -7.0, 12.0)
        if self.k_per_m == 0:
            return np.exp(target)
        half_k = self.k_per_m / 2
        return np.asarray(wrightomega(target + np.log(half_k)) / half_k)
