"""The ideal light of the lamp at each detector, in clear water and without electronics."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.array import DetectorArray
from uuv_optical_array.pose import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.quantity import Quantity

# A lamp is no point: nearer than its own size the inverse square does not hold.
MIN_RANGE_M = 1e-3


@dataclass(frozen=True)
class LampSettings:
    """The lamp of a scene: a Gaussian beam, and its power by what the array reads of it."""

    beam_sigma_deg: Annotated[float, Quantity("standard deviation of the beam", "deg", 0.1, 90)]
    reference_counts: Annotated[
        float, Quantity("largest reading of the aligned array at the reference", "counts", 1, 1e6)
    ]
    reference_range_m: Annotated[
        float, Quantity("base_link behind the lamp for that reading", "m", 0.1, 1000)
    ]


@dataclass(frozen=True)
class Rays:
    """The straight paths from the lamp to each detector, seen from the follower's ``base_link``.

    Parameters
    ----------
    range_m
        Length of the path, m, shape ``(..., n)``.
    off_axis_rad
        Angle between the beam axis and the path, in [0, pi] rad, shape ``(..., n)``.
    cos_incidence
        Cosine between the detector's normal and the direction back to the lamp, at most 1,
        shape ``(..., n)``.
    to_lamp
        From the detector to the lamp, m, shape ``(..., 3, n)``.
    beam_axis
        Unit vector along the beam, shape ``(..., 3, 1)``.
    """

    range_m: Array
    off_axis_rad: Array
    cos_incidence: Array
    to_lamp: Array
    beam_axis: Array


def trace(array: DetectorArray, poses: ArrayLike, roll: ArrayLike = 0.0) -> Rays:
    """Follow the light from the lamp to each detector.

    Parameters
    ----------
    array
        Detector array of n detectors.
    poses
        Poses of the follower in ``beacon``, m and rad, shape ``(..., 5)``.
    roll
        Roll of the follower, rad, broadcast to ``(...)``.

    Returns
    -------
    Rays
        Ranges and angles, shape ``(..., n)``; ranges are at least `MIN_RANGE_M`.
    """
    poses = np.asarray(poses, dtype=float)
    rotation = rotation_matrix(poses[..., PITCH], poses[..., YAW], roll)
    detectors = rotation @ array.positions.T + poses[..., :3, None]
    to_lamp = -(np.swapaxes(rotation, -1, -2) @ detectors)
    range_m = np.maximum(np.sqrt((detectors * detectors).sum(axis=-2)), MIN_RANGE_M)
    # arctan2 of the components in beacon keeps the small angles that arccos loses.
    across = np.hypot(detectors[..., 1, :], detectors[..., 2, :])
    cos_incidence = (to_lamp * array.normals.T).sum(axis=-2) / range_m
    return Rays(
        range_m,
        np.arctan2(across, -detectors[..., 0, :]),
        np.minimum(cos_incidence, 1.0),
        to_lamp,
        -rotation[..., 0, :, None],
    )


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
    light = np.exp(rays.off_axis_rad**2 * (-0.5 / beam_sigma_rad**2))
    light *= np.maximum(rays.cos_incidence, 0.0)
    light *= power / rays.range_m**2
    return light
