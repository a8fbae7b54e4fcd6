"""The ideal light of the lamp at a detector, in clear water and without electronics.

Functions take numbers or arrays, in m, rad and counts: see `core.numerics.elementwise`.
"""

import math
from typing import Any

from numpy import maximum, minimum, sqrt

from uuv_optical_array.core.geometry import dot
from uuv_optical_array.core.numerics.elementwise import choose, exp, law

# The inverse square of a point does not hold nearer than the size of the lamp.
MIN_RANGE_M = 1e-3
# Rows of the rays that `ray` returns, with the normals of the detectors. Incidence is that of the
# light as a whole: in water that scatters it does not come straight from the lamp.
RANGE, HALF_SQUARE, INCIDENCE, COSINE, AXIAL, ALONG, TURN = range(7)
TO_X, TO_Y, TO_Z, NORMAL_X, NORMAL_Y, NORMAL_Z = range(7, 13)
RAY_ROWS = 13

# eta^2 / s by powers of s = sin(eta)^2, highest first: minimax up to 45 deg, error 7e-17.
SQUARED_ANGLE = (
    *(2.7124616655916145, -10.004857358882923, 17.571727023989236, -19.01318692404218),
    *(14.169478164381292, -7.60441630782109, 3.077360310267226, -0.9071505140312446),
    *(0.23928802702305582, -0.00937123339089781, 0.03828718456652349, 0.03928961497271882),
    *(0.04874835923485211, 0.061566307856399424, 0.08126989914313835, 0.11428571312458523),
    *(0.17777777779004794, 0.333333333333282, 1.0),
)
EVEN, ODD = SQUARED_ANGLE[::2], SQUARED_ANGLE[1::2]  # powers, summed side by side


@law
def off_axis(along_m: Any, across_squared: Any, range_m: Any) -> tuple[Any, Any]:
    """Return half the squared angle off an axis, rad^2, and the angle over its sine and range, 1/m.

    It is exact near the axis and behind the lamp, without a call of a function. The second result
    is at most 1e9 over the range.
    """
    # Of half the angle to the nearer end of the axis, at most 45 deg, the squared sine.
    s = across_squared / (2 * range_m * (range_m + abs(along_m)))
    fourth = s * s
    even, odd = EVEN[0], ODD[0]
    for k in range(1, len(EVEN)):
        even = even * fourth + EVEN[k]
    for k in range(1, len(ODD)):
        odd = odd * fourth + ODD[k]
    relation = even + s * odd
    squared = 4 * s * relation
    ahead = along_m >= 0
    behind = math.pi - sqrt(squared)
    half_square = choose(ahead, 0.5 * squared, 0.5 * behind * behind)
    sine = maximum(2 * sqrt(s * (1 - s)), 1e-9)
    turn = choose(ahead, sqrt(relation / (1 - s)), behind / sine) / range_m
    return half_square, turn


@law
def ray(to: Any, normal: Any, axis: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """Follow the light from the lamp to a detector, by vectors in ``base_link``.

    - to: from the detector to the lamp, m.
    - normal, axis: unit vectors, out of the detector and along the lamp's beam.
    - returned range_m: length of the path, m, at least `MIN_RANGE_M`.
    - returned half_square, turn: as `off_axis`, of the angle between the beam's axis and the path.
    - returned cosine, axial: of the normal's angles to the lamp, at most 1, and to the beam's axis.
    - returned along_m: the detector along the beam's axis, m.
    """
    along_m = -dot(to, axis)
    # The part across the beam, taken by itself, keeps the small angles that r^2 - along^2 loses.
    off = to[0] + along_m * axis[0], to[1] + along_m * axis[1], to[2] + along_m * axis[2]
    range_m = maximum(sqrt(dot(to, to)), MIN_RANGE_M)
    half_square, turn = off_axis(along_m, dot(off, off), range_m)
    cosine = minimum(dot(to, normal) / range_m, 1.0)
    return range_m, half_square, cosine, dot(axis, normal), along_m, turn


@law
def gaussian(half_square: Any, beam_sigma_rad: Any, weight: Any, width: Any) -> tuple[Any, Any]:
    """Return the radiance of one Gaussian of a beam, and the slope of its logarithm.

    - weight, width: its light on the axis, and its width over the beam's sigma.
    """
    precision = 1 / (beam_sigma_rad * beam_sigma_rad) / (width * width)
    return weight * exp(-half_square * precision), -precision


@law
def added(beam: Any, by_half_square: Any, part: Any, part_by_half_square: Any) -> tuple[Any, Any]:
    """Return the sum of two parts of a beam's radiance, and the slope of its logarithm."""
    whole = beam + part
    share = part / choose(whole == 0, 1.0, whole)
    return whole, by_half_square + share * (part_by_half_square - by_half_square)


@law
def radiance(half_square: Any, beam_sigma_rad: Any, gaussians: Any) -> tuple[Any, Any]:
    """Return the radiance of a beam over that on the axis, and the slope of its logarithm.

    - gaussians: weights on the axis, and widths over the beam's sigma, shape ``(2, k)``.
    """
    beam = gaussian(half_square, beam_sigma_rad, gaussians[0, 0], gaussians[1, 0])
    for k in range(1, gaussians.shape[1]):
        part = gaussian(half_square, beam_sigma_rad, gaussians[0, k], gaussians[1, k])
        beam = added(beam[0], beam[1], part[0], part[1])
    return beam


@law
def lamp_light(
    range_m: Any,
    half_square: Any,
    incidence: Any,
    power: Any,
    beam_sigma_rad: Any,
    beam: Any,
    by_half_square: Any,
) -> tuple[Any, Any, Any, Any]:
    """Light on a detector: inverse square, beam and Lambert's cosine.

    ``E = power / r^2  sum_i w_i exp(-eta^2 / (2 sigma_i^2))  max(0, cos theta)``
    (Eren et al. 2016, eqs 1 to 4 and 8, of one Gaussian and with ``power = L0 r_half^2``).

    - range_m, half_square: as `ray` returns them.
    - incidence: cosine of the angle between the detector's normal and where the light comes from.
    - power: reading times squared range of a detector on the axis that faces the lamp, counts m^2.
    - beam, by_half_square: as `radiance` returns them.
    - returned light: counts; 0 for a detector that faces away.
    - returned by_range, by_incidence, by_sigma: slopes of its logarithm, beside `by_half_square`;
      at the edge where a detector turns away from the lamp that of the dark side, 0.
    """
    inverse = 1 / range_m
    facing, by_incidence = lambert(incidence)
    light = power * inverse * inverse * maximum(beam, 0.0) * facing
    by_sigma = -2 * half_square * by_half_square / beam_sigma_rad
    return light, -2 * inverse, by_incidence, by_sigma


@law
def lambert(incidence: Any) -> tuple[Any, Any]:
    """Return the share of the light that a detector takes, and the slope of its logarithm."""
    slope = choose(incidence > 0, 1 / maximum(incidence, 1e-300), 0.0)
    return maximum(incidence, 0.0), slope


@law
def slopes_by_lamp(
    slopes: tuple[Any, Any, Any], range_m: Any, cosine: Any, along_m: Any, turn: Any
) -> tuple[Any, Any, Any]:
    """Turn slopes of the light by range, half_square and cosine into those by the lamp.

    With the vector `to` from the detector to the lamp, the slope by the lamp's position is
    ``radial to + facing normal + bend axis``, and that by the beam's axis ``bend to`` with that by
    `axial` times the normal.
    """
    by_range, by_half_square, by_cosine = slopes
    bend = by_half_square * turn
    facing = by_cosine / range_m
    radial = (by_range - facing * cosine + bend * along_m / range_m) / range_m
    return radial, facing, bend
