"""The ideal light of the lamp at each detector, in clear water and without electronics."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad

from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.array import DetectorArray

# A lamp is no point: nearer than its own size the inverse square does not hold.
MIN_RANGE_M = 1e-3


@dataclass(frozen=True)
class LampSettings:
    """The lamp of a scene: a Gaussian beam, and its power by what the array reads of it."""

    beam_sigma_deg: Annotated[float, Quantity("standard deviation of the beam", "deg", 0.1, 90)]
    reference_counts: Annotated[
        float, Quantity("largest reading of the lamp, aligned at the reference", "counts", 1, 1e6)
    ]
    reference_range_m: Annotated[
        float, Quantity("base_link behind the lamp for that reading", "m", 0.1, 1000)
    ]


def beam_solid_angle(sigma_rad: float) -> float:
    """Flux of the Gaussian beam over its intensity on the axis, of all directions.

    Parameters
    ----------
    sigma_rad
        Standard deviation of the beam, rad, > 0.

    Returns
    -------
    float
        ``2 pi`` times the integral of ``exp(-eta^2 / (2 sigma^2)) sin eta`` from 0 to pi, sr; for
        a narrow beam ``2 pi sigma^2``.
    """
    end = min(math.pi, 12 * sigma_rad)  # a narrow peak would be missed in a wide interval
    integral, _ = quad(lambda eta: math.exp(-((eta / sigma_rad) ** 2) / 2) * math.sin(eta), 0, end)
    return 2 * math.pi * float(integral)


@dataclass(frozen=True)
class Rays:
    """The straight paths from the lamp to each detector.

    Parameters
    ----------
    range_m
        Length of the path, m, shape ``(..., n)``.
    off_axis_rad
        Angle between the beam axis and the path, in [0, pi] rad, shape ``(..., n)``.
    cos_incidence
        Cosine between the detector's normal and the direction back to the lamp, at most 1,
        shape ``(..., n)``.
    along_m, across_m
        Detector along the beam axis and off it, m, shape ``(..., n)``.
    to_lamp
        From the detector to the lamp, in ``base_link``, m, shape ``(..., 3, n)``.
    beam_axis
        Unit vector along the beam, in ``base_link``, shape ``(..., 3, 1)``.
    """

    range_m: Array
    off_axis_rad: Array
    cos_incidence: Array
    along_m: Array
    across_m: Array
    to_lamp: Array
    beam_axis: Array


def lamp_in_body(poses: ArrayLike, roll: ArrayLike = 0.0) -> tuple[Array, Array]:
    """Return what decides the light: where the lamp is and where it shines, in ``base_link``.

    Parameters
    ----------
    poses
        Poses of the follower in ``beacon``, m and rad, shape ``(..., 5)``.
    roll
        Roll of the follower, rad, broadcast to ``(...)``.

    Returns
    -------
    lamp : Array
        Position, m, shape ``(..., 3)``.
    axis : Array
        Unit vector along the beam, shape ``(..., 3)``.
    """
    poses = np.asarray(poses, dtype=float)
    rotation = rotation_matrix(poses[..., PITCH], poses[..., YAW], roll)
    lamp = -(poses[..., None, :3] @ rotation)[..., 0, :]
    return lamp, -rotation[..., 0, :]


def trace(array: DetectorArray, lamp: Array, axis: Array) -> Rays:
    """Follow the light from the lamp to each detector.

    Parameters
    ----------
    array
        Detector array of n detectors.
    lamp, axis
        What `lamp_in_body` returns, shape ``(..., 3)`` each.

    Returns
    -------
    Rays
        Ranges and angles, shape ``(..., n)``; ranges are at least `MIN_RANGE_M`.
    """
    beam_axis = axis[..., None]
    to_lamp = lamp[..., None] - array.positions.T
    along_m = -(to_lamp * beam_axis).sum(axis=-2)
    # The part across the beam, taken by itself, keeps the small angles that r^2 - along^2 loses.
    across = to_lamp + along_m[..., None, :] * beam_axis
    across_m = np.sqrt((across * across).sum(axis=-2))
    range_m = np.maximum(np.sqrt((to_lamp * to_lamp).sum(axis=-2)), MIN_RANGE_M)
    cos_incidence = np.minimum((to_lamp * array.normals.T).sum(axis=-2) / range_m, 1.0)
    off_axis_rad = np.arctan2(across_m, along_m)
    return Rays(range_m, off_axis_rad, cos_incidence, along_m, across_m, to_lamp, beam_axis)


class LateRays(Rays):
    """`Rays` that are traced when they are first asked for, which most effects never do.

    Parameters
    ----------
    array
        Detector array of n detectors.
    poses, roll
        As in `lamp_in_body`.
    """

    def __init__(self, array: DetectorArray, poses: Array, roll: Array) -> None:
        self.__dict__["_asked"] = array, poses, roll

    def __getattr__(self, name: str) -> Array:
        """Trace the rays; only reached while they are missing."""
        if name not in Rays.__dataclass_fields__:
            raise AttributeError(name)
        array, poses, roll = self._asked
        self.__dict__.update(vars(trace(array, *lamp_in_body(poses, roll))))
        return self.__dict__[name]


def irradiance(rays: Rays, beam_sigma_rad: float, power: float = 1.0) -> Array:
    """Light on each detector: inverse square, Gaussian beam and Lambert's cosine.

    ``E = power / r^2  exp(-eta^2 / (2 sigma^2))  max(0, cos theta)``
    (Eren et al. 2016, eqs 1 to 4 and 8, with ``power = L0 r_half^2``).

    Parameters
    ----------
    rays
        Paths from the lamp, shape ``(..., n)``; ranges > 0 m.
    beam_sigma_rad
        Standard deviation of the beam in the off-axis angle, > 0 rad.
    power
        Reading times squared range of a detector that faces the lamp on the axis,
        counts m^2, >= 0.

    Returns
    -------
    Array
        Light in counts, shape ``(..., n)``, >= 0; 0 for a detector that faces away.
    """
    return _facing(rays, beam_sigma_rad, power) * np.maximum(rays.cos_incidence, 0.0)


def _facing(rays: Rays, beam_sigma_rad: float, power: float) -> Array:
    """Light on a detector that faces the lamp."""
    light = np.exp(rays.off_axis_rad**2 * (-0.5 / beam_sigma_rad**2))
    light *= power / rays.range_m**2
    return light


def irradiance_with_derivatives(
    rays: Rays, array: DetectorArray, beam_sigma_rad: float, power: float
) -> tuple[Array, Array]:
    """Return `irradiance` and its derivatives by where the lamp is and by where it shines.

    Parameters
    ----------
    rays, beam_sigma_rad, power
        As in `irradiance`.
    array
        The n detectors.

    Returns
    -------
    light : Array
        As `irradiance`, shape ``(..., n)``.
    derivatives : Array
        By the three components of the lamp's position, per m, and by those of the beam axis,
        both in ``base_link``, shape ``(..., 6, n)``; 0 for a detector that faces away.
    """
    facing = _facing(rays, beam_sigma_rad, power)
    facing *= rays.cos_incidence > 0
    light = facing * rays.cos_incidence
    inverse = 1 / rays.range_m
    # eta / sin(eta); on the axis itself it meets only zeros.
    ratio = rays.off_axis_rad * rays.range_m / np.maximum(rays.across_m, 1e-9 * rays.range_m)
    bend = light * ratio * inverse * (1 / beam_sigma_rad**2)
    radial = (3 * light + bend * rays.along_m) * (-inverse * inverse)
    derivatives = np.empty((*light.shape[:-1], 6, light.shape[-1]))
    by_position, by_axis = derivatives[..., :3, :], derivatives[..., 3:, :]
    np.multiply(radial[..., None, :], rays.to_lamp, out=by_position)
    by_position += (facing * inverse)[..., None, :] * array.normals.T
    by_position -= bend[..., None, :] * rays.beam_axis
    np.multiply(-bend[..., None, :], rays.to_lamp, out=by_axis)
    return light, derivatives


def squared_angle_slopes(rays: Rays) -> tuple[Array, Array]:
    """Differentiate half the square of the off-axis angle.

    Parameters
    ----------
    rays
        Paths from the lamp, shape ``(..., n)``.

    Returns
    -------
    by_position : Array
        By the lamp's position in ``base_link``, rad^2/m, shape ``(..., 3, n)``.
    by_axis : Array
        By the beam axis, rad^2, shape ``(..., 3, n)``.
    """
    # eta / sin(eta) over the range; on the axis itself it meets only zeros.
    ratio = rays.off_axis_rad / np.maximum(rays.across_m, 1e-9 * rays.range_m)
    by_axis = ratio[..., None, :] * rays.to_lamp
    turned = (ratio * rays.along_m / rays.range_m**2)[..., None, :] * rays.to_lamp
    return ratio[..., None, :] * rays.beam_axis + turned, by_axis


def lamp_derivatives(poses: ArrayLike, roll: ArrayLike = 0.0) -> Array:
    """Differentiate `lamp_in_body` by the pose.

    Parameters
    ----------
    poses, roll
        As in `lamp_in_body`.

    Returns
    -------
    Array
        Position and axis, six rows, by x, y, z, pitch and yaw, shape ``(..., 6, 5)``.
    """
    poses = np.asarray(poses, dtype=float)
    to_body = np.swapaxes(rotation_matrix(poses[..., PITCH], poses[..., YAW], roll), -1, -2)
    lamp = -(to_body @ poses[..., :3, None])[..., 0]
    derivatives = np.zeros((*lamp.shape[:-1], 6, 5))
    derivatives[..., :3, :3] = -to_body
    derivatives[..., :3, 3] = pitched(lamp, roll)
    # Yaw turns about the beacon's z.
    x, y = poses[..., 0, None], poses[..., 1, None]
    derivatives[..., :3, 4] = to_body[..., 1] * x - to_body[..., 0] * y
    derivatives[..., 3:, 3] = pitched(-to_body[..., 0], roll)
    derivatives[..., 3:, 4] = to_body[..., 1]
    return derivatives


def pitched(seen: Array, roll: ArrayLike) -> Array:
    """Differentiate by the pitch a vector that the body sees, shape ``(..., 3)``."""
    # When the body turns about u, what it sees turns by -u x; pitch turns about Rx(-roll) y.
    sin_r, cos_r = np.sin(roll), np.cos(roll)
    turning = np.empty(seen.shape)
    turning[..., 0] = -(seen[..., 1] * sin_r + seen[..., 2] * cos_r)
    turning[..., 1] = seen[..., 0] * sin_r
    turning[..., 2] = seen[..., 0] * cos_r
    return turning


@dataclass
class Light:
    """The light on the array as the effects change it, with its derivatives where asked for.

    Parameters
    ----------
    image
        Light in counts, shape ``(..., side, side)``.
    derivatives
        By the lamp's position and the beam axis, six rows, and by each of `offsets`, shape
        ``(..., 6 + len(offsets), side, side)``; ``None`` where nobody asked.
    offsets
        What is added to settings of the scene, by dotted name, each of shape ``(...)``.
    time_s
        Moment of the image, s, shape ``(...)``; ``None`` where what moves is left out.
    """

    image: Array
    derivatives: Array | None = None
    offsets: Mapping[str, Array] = field(default_factory=dict)
    time_s: Array | None = None

    def setting(self, name: str, value: float) -> float | Array:
        """Return a setting with its offset, ready to be combined with images."""
        return value + self.offsets[name][..., None, None] if name in self.offsets else value

    def change(self, linear: Callable[[Array], Array]) -> None:
        """Apply a linear change to the image and so to every derivative."""
        self.image = linear(self.image)
        if self.derivatives is not None:
            self.derivatives = linear(self.derivatives)

    def dim(self, transmission: Array) -> None:
        """Multiply by a transmission, shape ``(..., side, side)``; see also `slope`."""
        self.image *= transmission
        if self.derivatives is not None:
            self.derivatives *= transmission[..., None, :, :]

    def slope_by_position(self, slope: Callable[[], Array]) -> None:
        """Add a derivative by the lamp's position, shape ``(..., 3, side, side)``."""
        if self.derivatives is not None:
            self.derivatives[..., :3, :, :] += slope()

    def slope_by_axis(self, slope: Callable[[], Array]) -> None:
        """Add a derivative by the beam axis, shape ``(..., 3, side, side)``."""
        if self.derivatives is not None:
            self.derivatives[..., 3:6, :, :] += slope()

    def slope_by(self, name: str, slope: Callable[[], float | Array]) -> None:
        """Add a derivative by an offset, shape ``(..., side, side)``, where it is asked for."""
        if self.derivatives is not None and name in self.offsets:
            self.derivatives[..., 6 + list(self.offsets).index(name), :, :] += slope()
