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

from uuv_optical_array.core.geometry import Array, rotation_matrix
from uuv_optical_array.forward.light import lamp_in_body, pitched

AZIMUTH, ELEVATION, DIMNESS, PITCH, YAW = range(5)


@dataclass(frozen=True)
class Chart:
    """The chart ``(azimuth, elevation, dimness, pitch, yaw)`` of an array under a lamp.

    The dimness is ``ln r + K r / 2 + eta^2 / (4 sigma^2)``, half the logarithm of what distance,
    water and beam take from the light at the array's centre.

    A planar array cannot tell where the lamp stands from how it shines. What it sees is how the
    light falls off across it: near the axis ``s (a - b) + 3 a`` in units of the range, where a
    and b are the azimuths of the lamp and of the beam's source direction and ``s = 1 / sigma^2``.
    Its azimuth is therefore ``a - b s / (s + 3)``, its elevation likewise, and its dimness takes
    Lambert's cosine in.

    Parameters
    ----------
    centre
        The array's centre in ``base_link``, m, shape ``(3,)``.
    beam_sigma_rad
        Standard deviation of the beam, rad, > 0.
    k_per_m
        Attenuation, 1/m, >= 0.
    planar
        Whether all detectors look the same way.
    """

    centre: Array
    beam_sigma_rad: float
    k_per_m: float
    planar: bool = False

    def from_pose(self, poses: Array, roll: ArrayLike) -> Array:
        """Return the coordinates of poses, shape ``(..., 5)``."""
        lamp, axis = lamp_in_body(poses, roll)
        sight = lamp - self.centre
        range_m = np.sqrt((sight * sight).sum(axis=-1))
        sight /= range_m[..., None]
        coordinates = np.empty(poses.shape)
        coordinates[..., :2] = _directions(sight)
        coordinates[..., DIMNESS] = np.log(range_m) + self.k_per_m / 2 * range_m
        coordinates[..., DIMNESS] += self._beam_loss(sight, axis)[0]
        if self.planar:
            coordinates[..., :2] -= self.share * _directions(-axis)
            coordinates[..., DIMNESS] -= 0.5 * np.log(_facing(sight))
        coordinates[..., PITCH:] = poses[..., PITCH:]
        return coordinates

    def to_pose(self, coordinates: Array, roll: ArrayLike) -> tuple[Array, Array, Array, Array]:
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
        log_volume : Array
            Logarithm of the volume of poses in m and rad that a unit volume of the chart holds,
            shape ``(...)``.
        """
        rotation = rotation_matrix(coordinates[..., PITCH], coordinates[..., YAW], roll)
        axis = -rotation[..., 0, :]
        angles = coordinates[..., :2]
        if self.planar:
            angles = angles + self.share * _directions(-axis)
        sight, _ = _sight(angles)
        dimness = coordinates[..., DIMNESS] - self._beam_loss(sight, axis)[0]
        if self.planar:
            dimness += 0.5 * np.log(_facing(sight))
        range_m = self._range(dimness)
        lamp = range_m[..., None] * sight + self.centre
        poses = np.empty(coordinates.shape)
        poses[..., :3] = -(rotation @ lamp[..., None])[..., 0]
        poses[..., PITCH:] = coordinates[..., PITCH:]
        return poses, lamp, axis, self._log_volume(range_m, angles)

    def to_lamp(
        self, coordinates: Array, roll: ArrayLike
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Return lamp, beam axis and pose, and how they change with the coordinates.

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
        poses : Array
            m and rad, shape ``(..., 5)``.
        pose_derivatives : Array
            Of the pose by the coordinates, shape ``(..., 5, 5)``.
        log_volume : Array
            As in `to_pose`.
        """
        rotation = rotation_matrix(coordinates[..., PITCH], coordinates[..., YAW], roll)
        axis = -rotation[..., 0, :]
        derivatives = np.zeros((*axis.shape[:-1], 6, 5))
        of_sight, of_axis = derivatives[..., :3, :], derivatives[..., 3:, :]
        of_axis[..., PITCH] = pitched(axis, roll)
        of_axis[..., YAW] = rotation[..., 1, :]
        angles = coordinates[..., :2]
        if self.planar:
            angles = angles + self.share * _directions(-axis)
        sight, turns = _sight(angles)
        of_sight[..., :2] = turns
        if self.planar:
            swing = _direction_slopes(-axis) @ -of_axis[..., PITCH:]
            of_sight[..., PITCH:] = self.share * (turns @ swing)
        loss, ratio = self._beam_loss(sight, axis)
        dimness = coordinates[..., DIMNESS] - loss
        # How the loss to the beam's profile, and so the range at this dimness, changes.
        stretch = axis[..., None, :] @ of_sight + sight[..., None, :] @ of_axis
        stretch *= -ratio[..., None, None]
        stretch[..., DIMNESS] = 1.0
        if self.planar:
            facing = _facing(sight)
            dimness += 0.5 * np.log(facing)
            slope = np.where(facing == sight[..., 0], 0.5 / facing, 0.0)
            stretch += slope[..., None, None] * of_sight[..., :1, :]
        range_m = self._range(dimness)
        stretch *= (1 / (1 / range_m + self.k_per_m / 2))[..., None, None]
        of_sight *= range_m[..., None, None]
        of_sight += sight[..., None] * stretch
        lamp = range_m[..., None] * sight + self.centre
        poses = np.empty(coordinates.shape)
        poses[..., :3] = -(rotation @ lamp[..., None])[..., 0]
        poses[..., PITCH:] = coordinates[..., PITCH:]
        # Pitch turns what the body sees, yaw turns about the beacon's z.
        of_lamp = of_sight.copy()
        of_lamp[..., PITCH] -= pitched(lamp, roll)
        pose_derivatives = np.zeros((*axis.shape[:-1], 5, 5))
        pose_derivatives[..., :3, :] = -rotation @ of_lamp
        pose_derivatives[..., 0, YAW] -= poses[..., 1]
        pose_derivatives[..., 1, YAW] += poses[..., 0]
        pose_derivatives[..., PITCH, PITCH] = pose_derivatives[..., YAW, YAW] = 1.0
        log_volume = self._log_volume(range_m, angles)
        return lamp, axis, derivatives, poses, pose_derivatives, log_volume

    def lookalikes(self, coordinates: Array) -> Array:
        """Return where a planar array sees nearly the same, shape ``(3, n)``; ``(0, n)`` if curved.

        To second order the light depends on pitch and yaw by the sum of their squares alone, so a
        ring of attitudes looks alike; these are the other three of four places on it.
        """
        turned = np.repeat(coordinates[None], 3 if self.planar else 0, axis=0)
        pitch, yaw = coordinates[PITCH], coordinates[YAW]
        for row, angles in zip(
            turned, ((-pitch, -yaw), (yaw, -pitch), (-yaw, pitch)), strict=False
        ):
            row[PITCH : YAW + 1] = angles
        return turned

    @property
    def share(self) -> float:
        """The c of ``azimuth - c b``, in which a planar array's azimuth differs from the lamp's."""
        return 1 / (1 + 3 * self.beam_sigma_rad**2)

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

    def _log_volume(self, range_m: Array, angles: Array) -> Array:
        level = np.maximum(np.abs(np.cos(angles[..., 1])), 1e-9)
        return np.log(range_m**2 * level / (1 / range_m + self.k_per_m / 2))

    def _range(self, target: Array) -> Array:
        """Solve ``ln r + K r / 2 = target``: with w = K r / 2, ln w + w is known."""
        # From a millimetre to a hundred kilometres: a fit that strays farther finds no light.
        target = np.clip(target, -7.0, 12.0)
        if self.k_per_m == 0:
            return np.exp(target)
        half_k = self.k_per_m / 2
        return np.asarray(wrightomega(target + np.log(half_k)) / half_k)


def _directions(vectors: Array) -> Array:
    """Return azimuth and elevation of vectors, shape ``(..., 2)``."""
    level = np.hypot(vectors[..., 0], vectors[..., 1])
    angles = np.empty((*vectors.shape[:-1], 2))
    angles[..., 0] = np.arctan2(vectors[..., 1], vectors[..., 0])
    angles[..., 1] = np.arctan2(vectors[..., 2], level)
    return angles


def _direction_slopes(units: Array) -> Array:
    """Differentiate azimuth and elevation by a unit vector, shape ``(..., 2, 3)``."""
    x, y, z = units[..., 0], units[..., 1], units[..., 2]
    # At the poles the azimuth has no slope.
    level = np.maximum(np.hypot(x, y), 1e-6)
    slopes = np.zeros((*units.shape[:-1], 2, 3))
    slopes[..., 0, 0], slopes[..., 0, 1] = -y / level**2, x / level**2
    slopes[..., 1, 0], slopes[..., 1, 1] = -x * z / level, -y * z / level
    slopes[..., 1, 2] = level
    return slopes


def _facing(sight: Array) -> Array:
    """Cosine of incidence on a planar array; at least that of a lamp almost beside it."""
    return np.maximum(sight[..., 0], 1e-3)


def _sight(angles: Array) -> tuple[Array, Array]:
    """Return the unit vector to the lamp, and its derivatives by azimuth and elevation."""
    cosine, sine = np.cos(angles), np.sin(angles)
    cos_a, cos_e = cosine[..., 0], cosine[..., 1]
    sin_a, sin_e = sine[..., 0], sine[..., 1]
    sight = np.empty((*cos_a.shape, 3))
    turns = np.zeros((*cos_a.shape, 3, 2))
    sight[..., 0], sight[..., 1], sight[..., 2] = cos_e * cos_a, cos_e * sin_a, sin_e
    turns[..., 0, 0], turns[..., 1, 0] = -sight[..., 1], sight[..., 0]
    turns[..., 0, 1], turns[..., 1, 1], turns[..., 2, 1] = -sin_e * cos_a, -sin_e * sin_a, cos_e
    return sight, turns
