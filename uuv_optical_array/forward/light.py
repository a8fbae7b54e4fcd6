"""The ideal light of the lamp at a detector, in clear water and without electronics.

Functions take numbers or arrays, in m, rad and counts: see `core.numerics.elementwise`.
"""

import math
from typing import Any

from numpy import sqrt

from uuv_optical_array.core.geometry import dot
from uuv_optical_array.core.numerics.elementwise import choose, exp, law, maximum, minimum

# The inverse square of a point does not hold nearer than the size of the lamp.
MIN_RANGE_M = 1e-3
# Rows of the rays that `ray` returns, with the normals of the detectors. Incidence is that of the
# light as a whole: in water that scatters it does not come straight from the lamp.
RANGE, INVERSE, HALF_SQUARE, INCIDENCE, COSINE, AXIAL, ALONG, TURN = range(8)
TO_X, TO_Y, TO_Z, NORMAL_X, NORMAL_Y, NORMAL_Z = range(8, 14)
RAY_ROWS = 14

# eta / sin(eta) by powers of sin(eta / 2)^2, highest first: minimax up to 90 deg, error 3e-17.
ANGLE_BY_SINE = (
    *(129.4965921425985, -549.854387674268, 1106.590285820936, -1384.040718349535),
    *(1200.5793164306544, -762.592111683347, 367.0094224315992, -135.70522665573586),
    *(39.48028719850249, -8.589279250962834, 1.8269739439306438, 0.07153003441838945),
    *(0.3216916441387266, 0.3165217767949652, 0.34109207974380434, 0.36940433820855195),
    *(0.4063493148293764, 0.4571428553596468, 0.5333333333488273, 0.6666666666666132, 1.0),
)
EVEN, ODD = ANGLE_BY_SINE[::2], ANGLE_BY_SINE[1::2]  # powers, summed side by side


@law
def to_nearer_end(half_sine_squared: Any) -> tuple[Any, Any]:
    """Return an angle up to 90 deg over its sine, and the squared sine, by that of its half."""
    s = half_sine_squared
    fourth = s * s
    even, odd = EVEN[0], ODD[0]
    for k in range(1, len(EVEN)):
        even = even * fourth + EVEN[k]
    for k in range(1, len(ODD)):
        odd = odd * fourth + ODD[k]
    return even + s * odd, 4 * s * (1 - s)


@law
def off_axis(along_m: Any, half_sine_squared: Any, inverse: Any) -> tuple[Any, Any]:
    """Return half the squared angle off an axis, rad^2, and the angle over its sine and range, 1/m.

    It is exact near the axis and behind the lamp, without a call of a function. The second result
    is at most 1e9 over the range.

    - half_sine_squared: squared sine of half the angle to the nearer end of the axis, at most 0.5.
    - inverse: of the range, 1/m.
    """
    # Roots and divisions take most of the time of a ray: there is one of each here.
    relation, squared = to_nearer_end(half_sine_squared)
    ahead, sine = along_m >= 0, sqrt(squared)
    behind = math.pi - relation * sine
    half_square = 0.5 * choose(ahead, relation * relation * squared, behind * behind)
    turn = choose(ahead, relation, behind / maximum(sine, 1e-9)) * inverse
    return half_square, turn


@law
def ray(to: Any, normal: Any, axis: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """Follow the light from the lamp to a detector, by vectors in ``base_link``.

    - to: from the detector to the lamp, m.
    - normal, axis: unit vectors, out of the detector and along the lamp's beam.
    - returned range_m, inverse: length of the path, m, at least `MIN_RANGE_M`, and 1 over it.
    - returned half_sine_squared: as `off_axis` takes it, of the beam's axis and the path.
    - returned cosine, axial: of the normal's angles to the lamp, at most 1, and to the beam's axis.
    - returned along_m: the detector along the beam's axis, m.
    """
    along_m = -dot(to, axis)
    # The part across the beam, taken by itself, keeps the small angles that r^2 - along^2 loses.
    off = to[0] + along_m * axis[0], to[1] + along_m * axis[1], to[2] + along_m * axis[2]
    range_m = maximum(sqrt(dot(to, to)), MIN_RANGE_M)
    nearer = range_m + abs(along_m)
    shared = 1 / (range_m * nearer)
    inverse = shared * nearer
    cosine = minimum(dot(to, normal) * inverse, 1.0)
    return range_m, inverse, 0.5 * dot(off, off) * shared, cosine, dot(axis, normal), along_m


@law
def gaussian(
    half_square: Any, beam_sigma_rad: Any, weight: Any, width: Any, exponent: Any = 0.0
) -> tuple[Any, Any]:
    """Return the radiance of one Gaussian of a beam, and the slope of its logarithm.

    - weight, width: its light on the axis, and its width over the beam's sigma.
    - exponent: of what else dims the light exponentially.
    """
    precision = 1 / (beam_sigma_rad * beam_sigma_rad) / (width * width)
    return weight * exp(exponent - half_square * precision), -precision


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
    inverse: Any,
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

    - inverse, half_square: as `ray` returns them.
    - incidence: cosine of the angle between the detector's normal and where the light comes from.
    - power: reading times squared range of a detector on the axis that faces the lamp, counts m^2.
    - beam, by_half_square: as `radiance` returns them.
    - returned light: counts; 0 for a detector that faces away.
    - returned by_range, by_incidence, by_sigma: slopes of its logarithm, beside `by_half_square`;
      at the edge where a detector turns away from the lamp that of the dark side, 0.
    """
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
    slopes: tuple[Any, Any, Any], inverse: Any, cosine: Any, along_m: Any, turn: Any
) -> tuple[Any, Any, Any]:
    """Turn slopes of the light by range, half_square and cosine into those by the lamp.

    With the vector `to` from the detector to the lamp, the slope by the lamp's position is
    ``radial to + facing normal + bend axis``, and that by the beam's axis ``bend to`` with that by
    `axial` times the normal. `inverse` is that of the range.
    """
    by_range, by_half_square, by_cosine = slopes
    bend = by_half_square * turn
    facing = by_cosine * inverse
    radial = (by_range - facing * cosine + bend * along_m * inverse) * inverse
    return radial, facing, bend
