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

from uuv_optical_array.core.numerics.elementwise import exp, expm1, law

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
    _, off_axis, sine_ratio = angle
    narrow, optical_depth = beam_sigma_rad * beam_sigma_rad, scattering_per_m * range_m
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
    # All light together seems to come from one point, too.
    advance = p * near + q * far
    apart_one, apart_other = p * (near - advance), q * (far - advance)
    advance_depth = p * near_depth + q * far_depth
    advance_depth = advance_depth + apart_one * one_depth + apart_other * other_depth
    advance_half = apart_one * one_half + apart_other * other_half
    advance_narrow = p * near_narrow + q * far_narrow
    advance_narrow = advance_narrow + apart_one * one_narrow + apart_other * other_narrow
    square = 1 + advance * (advance - 2 * off_axis)
    distance = sqrt(square)
    pull = (advance - off_axis) / square
    turned = advance * sine_ratio / square
    lost = LOSS * optical_depth
    by_depth = p * one_depth + q * other_depth + pull * advance_depth - lost
    by_half = p * one_half + q * other_half + pull * advance_half + turned
    by_narrow = p * one_narrow + q * other_narrow + pull * advance_narrow
    inverse = 1 / range_m
    flux = power * inverse * inverse * exp(-lost) * (one + other) * distance
    incidence = minimum((cosine + advance * axial) / distance, 1.0)
    swing = axial / distance - incidence * pull
    width = 2 * beam_sigma_rad
    by_range, in_range = (by_depth - 2) * inverse, swing * advance_depth * inverse
    in_half_square = swing * advance_half - incidence * turned
    in_sigma = swing * advance_narrow * width
    light = flux, by_range, by_half, by_narrow * width, by_depth
    return light, (incidence, in_range, in_half_square, 1 / distance, advance / distance, in_sigma)
