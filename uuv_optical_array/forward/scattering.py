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

from numpy import maximum, minimum, sqrt

from uuv_optical_array.core.numerics.elementwise import choose, exp, expm1, law

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
    ratio = narrow / variance
    reach = 1 + tilt * (1 - ratio)
    advance = 1 - 1 / reach
    by_ratio = -tilt / (reach * reach)
    by_depth, by_narrow = -by_ratio * ratio * growth / variance, by_ratio * (1 - ratio) / variance
    square = 1 + advance * (advance - 2 * off_axis)
    strength = ratio * exp(-half_square / variance) / sqrt(square)
    pull = (off_axis - advance) / square
    wider = half_square / variance - 1
    return (
        strength,
        wider * growth / variance + pull * by_depth,
        -1 / variance - advance * sine_ratio / square,
        1 / narrow + wider / variance + pull * by_narrow,
        advance,
        by_depth,
        by_narrow,
    )


@law
def together(
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
    straight, scattered = exp(-x), -expm1(-x)
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
    one, other = straight * one, scattered * other
    one_depth, other_depth = one_depth - x, other_depth + straight * many
    both = maximum(one + other, 1e-300)
    p, q = one / both, other / both
    advance = p * near + q * far
    apart_one, apart_other = p * (near - advance), q * (far - advance)
    advance_depth = p * near_depth + q * far_depth
    advance_depth = advance_depth + apart_one * one_depth + apart_other * other_depth
    advance_half = apart_one * one_half + apart_other * other_half
    advance_narrow = p * near_narrow + q * far_narrow
    advance_narrow = advance_narrow + apart_one * one_narrow + apart_other * other_narrow
    return (
        one + other,
        p * one_depth + q * other_depth,
        p * one_half + q * other_half,
        p * one_narrow + q * other_narrow,
        advance,
        advance_depth,
        advance_half,
        advance_narrow,
    )


@law
def weighed(
    angle: Any, narrow: Any, optical_depth: Any, weight: Any, width: Any
) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
    """Return strength and its slopes of one of several Gaussians, and its moment with slopes."""
    square = width * width
    strength, depth, half, wide, advance, advance_depth, advance_half, advance_wide = together(
        angle, square * narrow, optical_depth
    )
    strength = weight * strength
    return (
        strength,
        strength * depth,
        strength * half,
        strength * wide * square,
        strength * advance,
        strength * (advance * depth + advance_depth),
        strength * (advance * half + advance_half),
        strength * (advance * wide + advance_wide) * square,
    )


@law
def together_of_three(
    angle: Any, narrow: Any, optical_depth: Any, gaussians: Any
) -> tuple[Any, Any, Any, Any, Any, Any, Any, Any]:
    """Return the same of a beam of three Gaussians, as `light.beam_of_three` has them.

    Light is linear in the beam, so flux and moment of the apparent sources add up.
    """
    first = weighed(angle, narrow, optical_depth, gaussians[0, 0], gaussians[1, 0])
    second = weighed(angle, narrow, optical_depth, gaussians[0, 1], gaussians[1, 1])
    third = weighed(angle, narrow, optical_depth, gaussians[0, 2], gaussians[1, 2])
    flux = first[0] + second[0] + third[0]
    by_depth = first[1] + second[1] + third[1]
    by_half = first[2] + second[2] + third[2]
    by_narrow = first[3] + second[3] + third[3]
    moment = first[4] + second[4] + third[4]
    moment_depth = first[5] + second[5] + third[5]
    moment_half = first[6] + second[6] + third[6]
    moment_narrow = first[7] + second[7] + third[7]
    flux = maximum(flux, 0.0)
    inverse = choose(flux > 0, 1 / maximum(flux, 1e-300), 0.0)
    by_depth, by_half, by_narrow = by_depth * inverse, by_half * inverse, by_narrow * inverse
    advance = moment * inverse
    return (
        flux,
        by_depth,
        by_half,
        by_narrow,
        advance,
        moment_depth * inverse - advance * by_depth,
        moment_half * inverse - advance * by_half,
        moment_narrow * inverse - advance * by_narrow,
    )


@law
def scattered_light(
    range_m: Any,
    angle: Any,
    cosine: Any,
    axial: Any,
    power: Any,
    beam_sigma_rad: Any,
    scattering_per_m: Any,
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Flux of the lamp's light at a detector in water that scatters, without absorption.

    - range_m, cosine, axial: as `light.ray` returns them.
    - angle: off the axis: half its square, its cosine, and its sine over itself.
    - returned flux, by_range, by_half_square, by_sigma, by_scattering: counts, and slopes of its
      logarithm, the last by the logarithm of b.
    - returned incidence, in_range, in_half_square, in_cosine, in_axial, in_sigma: cosine of the
      angle between the normal and where the flux comes from, and its slopes; that by the logarithm
      of b is `in_range` times the range.
    """
    optical_depth = scattering_per_m * range_m
    apparent = together(angle, beam_sigma_rad * beam_sigma_rad, optical_depth)
    return arriving(range_m, angle, cosine, axial, power, beam_sigma_rad, optical_depth, apparent)


@law
def scattered_light_of_three(
    range_m: Any,
    angle: Any,
    cosine: Any,
    axial: Any,
    power: Any,
    beam_sigma_rad: Any,
    gaussians: Any,
    scattering_per_m: Any,
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return the same as `scattered_light` of a beam of three `gaussians`, shape ``(2, 3)``."""
    optical_depth = scattering_per_m * range_m
    narrow = beam_sigma_rad * beam_sigma_rad
    apparent = together_of_three(angle, narrow, optical_depth, gaussians)
    return arriving(range_m, angle, cosine, axial, power, beam_sigma_rad, optical_depth, apparent)


@law
def arriving(
    range_m: Any,
    angle: Any,
    cosine: Any,
    axial: Any,
    power: Any,
    beam_sigma_rad: Any,
    optical_depth: Any,
    apparent: Any,
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return `scattered_light` by what `together` says of the beam."""
    strength, strength_depth, strength_half, strength_narrow = apparent[:4]
    advance, advance_depth, advance_half, advance_narrow = apparent[4:]
    _, off_axis, sine_ratio = angle
    square = 1 + advance * (advance - 2 * off_axis)
    distance = sqrt(square)
    pull = (advance - off_axis) / square
    turned = advance * sine_ratio / square
    lost = LOSS * optical_depth
    by_depth = strength_depth + pull * advance_depth - lost
    by_half = strength_half + pull * advance_half + turned
    by_narrow = strength_narrow + pull * advance_narrow
    inverse = 1 / range_m
    flux = power * inverse * inverse * exp(-lost) * strength * distance
    incidence = minimum((cosine + advance * axial) / distance, 1.0)
    swing = axial / distance - incidence * pull
    width = 2 * beam_sigma_rad
    by_range, in_range = (by_depth - 2) * inverse, swing * advance_depth * inverse
    in_half_square = swing * advance_half - incidence * turned
    in_sigma = swing * advance_narrow * width
    light = flux, by_range, by_half, by_narrow * width, by_depth
    return light, (incidence, in_range, in_half_square, 1 / distance, advance / distance, in_sigma)
