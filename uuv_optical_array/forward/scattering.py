"""The light of the lamp in water that scatters, as a sea of absorption a and scattering b has it.

Photons that were hardly turned form a core that widens slowly, the others a halo that widens fast,
in the small-angle approximation (E. Fermi and L. Eyges; for light in the sea S. Q. Duntley 1971,
SIO Ref. 71-1, and D. Arnush 1972, J. Opt. Soc. Am. 62, 1109). The light of each travels farther
off the axis than the ray from the lamp: it seems to come from a point of the axis nearer to the
array. With range r, angle eta off the axis and ``x = B b r``::

    sigma_core^2 = sigma^2 + C b r / 3,    sigma_halo^2 = sigma_core^2 + H x / (3 s)
    s = 1 - exp(-x),    tau_i = t_i (1 - sigma^2 / sigma_i^2),    kappa_i = tau_i / (1 + tau_i)
    flux = power / r^2  exp(-(a + K b) r)  sum_i w_i (sigma / sigma_i)^2
           exp(-eta^2 / (2 sigma_i^2)) d_i,    w_core = 1 - s,    w_halo = s

with the direction `d_i` from the point ``kappa_i r`` ahead of the lamp on the axis, and t of 2 for
the core and 1 for the halo. A detector of normal n reads ``-n . flux``. The constants are fitted to
a transport of photons (`uuv_array study transport`) with the phase function of Fournier and Forand
for sea water. The absorption is a factor that `effects.water.beer` describes.
"""

from typing import Any

from numpy import sqrt

from uuv_optical_array.core.numerics.elementwise import choose, exp, expm1, law, maximum, minimum

CORE, HALO = 0.0013, 0.0754  # C and H, rad^2
SHARE, LOSS = 0.188, 0.0562  # B and K
CORE_TILT, HALO_TILT = 2.0, 1.0  # t


@law
def part(
    narrow: Any, variance: Any, growth: Any, tilt: float, angle: Any
) -> tuple[Any, Any, Any, Any, Any, Any, Any]:
    """Return core or halo without its weight, and where it seems to come from.

    - narrow, variance, growth: variance of the beam at the lamp and of this part, rad^2, and the
      slope of the latter by the logarithm of ``b r``.
    - tilt: the t above.
    - angle: as of `scattered_light`.
    - returned strength, by_depth, by_half_square, by_narrow: flux over the distance to the apparent
      source; slopes of its logarithm by the logarithm of ``b r``, half_square and `narrow`.
    - returned advance, advance_by_depth, advance_by_narrow: of the apparent source on the axis, as
      a share of the range, with slopes.
    """
    half_square, off_axis, sine_ratio = angle
    # A division takes as long as ten products, so slopes take the square's inverse from the root's.
    precision = 1 / variance
    ratio = narrow * precision
    inverse = 1 / (1 + tilt * (1 - ratio))
    advance, by_ratio = 1 - inverse, -tilt * inverse * inverse
    by_depth, by_narrow = -by_ratio * ratio * growth * precision, by_ratio * (1 - ratio) * precision
    distance = sqrt(1 + advance * (advance - 2 * off_axis))
    nearness = 1 / distance
    strength = ratio * exp(-half_square * precision) * nearness
    closer = nearness * nearness
    pull = (off_axis - advance) * closer
    wider = half_square * precision - 1
    return (
        strength,
        wider * growth * precision + pull * by_depth,
        -precision - advance * sine_ratio * closer,
        1 / narrow + wider * precision + pull * by_narrow,
        advance,
        by_depth,
        by_narrow,
    )


@law
def joined(nearer: Any, farther: Any) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
    """Return two parts of the light, which together seem to come from one point, too.

    Light is linear in the beam, so flux and its moment about the lamp add up. Each is strength and
    advance with slopes, as of `core_and_halo`.
    """
    one, one_depth, one_half, one_narrow, near, near_depth, near_half, near_narrow = nearer
    other, depth, half, narrow, far, far_depth, far_half, far_narrow = farther
    both = one + other
    safe = choose(both == 0, 1.0, both)
    p, q = one / safe, other / safe
    advance = p * near + q * far
    apart_one, apart_other = p * (near - advance), q * (far - advance)
    advance_depth = p * near_depth + q * far_depth
    advance_half = p * near_half + q * far_half
    advance_narrow = p * near_narrow + q * far_narrow
    return (
        both,
        p * one_depth + q * depth,
        p * one_half + q * half,
        p * one_narrow + q * narrow,
        advance,
        advance_depth + apart_one * one_depth + apart_other * depth,
        advance_half + apart_one * one_half + apart_other * half,
        advance_narrow + apart_one * one_narrow + apart_other * narrow,
    )


@law
def core_and_halo(
    angle: Any, narrow: Any, optical_depth: Any
) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
    """Return core and halo of one Gaussian, which together seem to come from one point, too.

    - angle: as of `scattered_light`.
    - narrow: variance of the beam at the lamp, rad^2.
    - optical_depth: scattering times range.
    - returned strength, by_depth, by_half_square, by_narrow, and advance with the same slopes: as
      of `part`.
    """
    x = SHARE * optical_depth
    scattered = -expm1(-x)
    straight = 1 - scattered
    core, core_growth = narrow + CORE / 3 * optical_depth, CORE / 3 * optical_depth
    many = x / scattered
    halo = core + HALO / 3 * many
    halo_growth = core_growth + HALO / 3 * many * (1 - straight * many)
    one, one_depth, one_half, one_narrow, near, near_depth, near_narrow = part(
        narrow, core, core_growth, CORE_TILT, angle
    )
    other, other_depth, other_half, other_narrow, far, far_depth, far_narrow = part(
        narrow, halo, halo_growth, HALO_TILT, angle
    )
    one_depth, other_depth = one_depth - x, other_depth + straight * many
    return joined(
        (straight * one, one_depth, one_half, one_narrow, near, near_depth, 0.0, near_narrow),
        (scattered * other, other_depth, other_half, other_narrow, far, far_depth, 0.0, far_narrow),
    )


@law
def weighed(
    angle: Any, beam_sigma_rad: Any, optical_depth: Any, weight: Any, width: Any
) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
    """Return `core_and_halo` of a Gaussian of a beam, with slopes by the square of its sigma.

    - weight, width: the Gaussian's light on the axis, and its width over the beam's sigma.
    """
    square = width * width
    light, depth, half, wide, advance, advance_depth, advance_half, advance_wide = core_and_halo(
        angle, square * (beam_sigma_rad * beam_sigma_rad), optical_depth
    )
    return (
        weight * light,
        depth,
        half,
        square * wide,
        advance,
        advance_depth,
        advance_half,
        square * advance_wide,
    )


@law
def scattered_light(
    range_m: Any,
    inverse: Any,
    angle: Any,
    cosine: Any,
    axial: Any,
    power: Any,
    beam_sigma_rad: Any,
    scattering_per_m: Any,
    source: Any,
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Flux of the lamp's light at a detector in water that scatters, without absorption.

    - range_m, inverse, cosine, axial: as `light.ray` returns them.
    - angle: off the axis: half its square, its cosine, and its sine over itself.
    - source: what the light seems to come from, of all Gaussians, `joined` and `weighed`.
    - returned flux, by_range, by_half_square, by_sigma, by_scattering: counts, and slopes of its
      logarithm, the last by the logarithm of b.
    - returned incidence, in_range, in_half_square, in_cosine, in_axial, in_sigma: cosine of the
      angle between the normal and where the flux comes from, and its slopes; that by the logarithm
      of b is `in_range` times the range.
    """
    optical_depth = scattering_per_m * range_m
    strength, strength_depth, strength_half, strength_narrow = source[:4]
    advance, advance_depth, advance_half, advance_narrow = source[4:]
    _, off_axis, sine_ratio = angle
    distance = sqrt(1 + advance * (advance - 2 * off_axis))
    nearness = 1 / distance
    closer = nearness * nearness
    pull, turned = (advance - off_axis) * closer, advance * sine_ratio * closer
    lost = LOSS * optical_depth
    by_depth = strength_depth + pull * advance_depth - lost
    by_half = strength_half + pull * advance_half + turned
    by_narrow = strength_narrow + pull * advance_narrow
    flux = power * inverse * inverse * exp(-lost) * maximum(strength, 0.0) * distance
    incidence = minimum((cosine + advance * axial) * nearness, 1.0)
    swing = axial * nearness - incidence * pull
    width = 2 * beam_sigma_rad
    by_range, in_range = (by_depth - 2) * inverse, swing * advance_depth * inverse
    in_half_square = swing * advance_half - incidence * turned
    in_sigma = swing * advance_narrow * width
    light = flux, by_range, by_half, by_narrow * width, by_depth
    return light, (incidence, in_range, in_half_square, nearness, advance * nearness, in_sigma)
