"""From lamp to readings of one scene, with derivatives, for NumPy at many poses and compiled.

Components come first: a position is ``(3, ...)``, an image with its derivatives
``(1 + p, ..., n)``. With NumPy, each component holds any number of poses, shape ``(m, 1)``; in
compiled code it is a number, of one pose.
"""

import math
from typing import Any, NamedTuple

from numpy import exp, maximum

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.elementwise import (
    choose,
    indices,
    law,
    sandwich,
    transmit,
    workspace,
)
from uuv_optical_array.forward.light import (
    ALONG,
    COSINE,
    HALF_SQUARE,
    RANGE,
    TO_X,
    TO_Y,
    TO_Z,
    TURN,
    lamp_light,
    ray,
    slopes_by_lamp,
)

# Rows of the beam; those of slopes by settings of the laws follow.
LIGHT, BY_RANGE, BY_HALF_SQUARE, BY_COSINE, BY_SIGMA = range(5)
BEAM_ROWS = 5
# Kinds of step on the array.
BACKGROUND, GAIN, BLUR, SHADE = range(4)
DEGREE = math.pi / 180
# A scene without noise is read as if to a thousandth of a count.
MIN_VARIANCE = 1e-6


class ReadingNoise(NamedTuple):
    """How a scene's readings differ from the light.

    Parameters
    ----------
    variance, slope, square
        Variance of a reading in the dark, counts^2, with rounding; its growth with the light,
        counts; and with the square of the light, the variance of an unknown relative gain.
    low, high
        Limits of the readings, counts: at `low` or below, the light was at most `low` + 0.5, at
        `high` or above at least `high` - 0.5.
    """

    variance: float
    slope: float
    low: float
    high: float
    square: float = 0.0


class Optics(NamedTuple):
    """A scene in numbers.

    Parameters
    ----------
    detectors
        Their positions, m, and normals, shape ``(6, n)``.
    power, beam_sigma_rad
        As in `light.lamp_light`.
    nuisances
        Number of settings that have offsets.
    power_at, sigma_at
        Index among the nuisances of the offset of the power's logarithm, and of that of the beam's
        standard deviation, deg; -1: known.
    laws, law_settings, law_at
        Of transmission: functions, or their addresses for compiled code; their settings, shape
        ``(laws, 3)``; index of the nuisance that is the first of these, as `power_at`.
    step_kinds, step_values, step_scales, step_at
        Of each step on the array: `BACKGROUND`, `GAIN`, `BLUR` or `SHADE`; pattern, gains or
        logarithms, shape ``(steps, n)``; level of a background or slope of gains; index of the
        nuisance, as `power_at`.
    blur
        Of one axis, shape ``(side, side)``.
    """

    detectors: Array
    power: float
    beam_sigma_rad: float
    nuisances: int
    power_at: int
    sigma_at: int
    laws: Any
    law_settings: Array
    law_at: Any
    step_kinds: Any
    step_values: Array
    step_scales: Array
    step_at: Any
    blur: Array


def trace(detectors: Array, lamp: Any, rays: Any) -> None:
    """Write the `light.ray` from the lamp (six components) to each detector, ``(8, ..., n)``."""
    lamp_x, lamp_y, lamp_z, axis_x, axis_y, axis_z = lamp
    for j in indices(detectors.shape[1]):
        range_m, half_square, cosine, to_x, to_y, to_z, along_m, turn = ray(
            detectors[0, j],
            detectors[1, j],
            detectors[2, j],
            detectors[3, j],
            detectors[4, j],
            detectors[5, j],
            lamp_x,
            lamp_y,
            lamp_z,
            axis_x,
            axis_y,
            axis_z,
        )
        rays[RANGE, j], rays[HALF_SQUARE, j], rays[COSINE, j] = range_m, half_square, cosine
        rays[TO_X, j], rays[TO_Y, j], rays[TO_Z, j] = to_x, to_y, to_z
        rays[ALONG, j], rays[TURN, j] = along_m, turn


def shine(rays: Any, power: Any, beam_sigma_rad: float, beam: Any) -> None:
    """Write the ideal light at the end of each ray, and its slopes, into the rows of `beam`."""
    for j in indices(rays.shape[-1]):
        light, by_range, by_half_square, by_cosine, by_sigma = lamp_light(
            rays[RANGE, j], rays[HALF_SQUARE, j], rays[COSINE, j], power, beam_sigma_rad
        )
        beam[LIGHT, j], beam[BY_RANGE, j] = light, by_range
        beam[BY_HALF_SQUARE, j], beam[BY_COSINE, j] = by_half_square, by_cosine
        beam[BY_SIGMA, j] = by_sigma


def illuminate(
    optics: Optics, lamp: Any, nuisances: Any, rays: Any, beam: Any, differentiate: bool
) -> None:
    """Write the rays to each detector and the light that arrives there.

    Lamp and axis of the beam in ``base_link``, m, are six components; offsets of nuisances have
    shape ``(q, ...)``. Results are the rows of `light.ray`, shape ``(8, ..., n)``, and in `beam`
    the light, its slopes and those by settings of the laws, shape ``(5 + laws, ..., n)``.
    """
    power, beam_sigma_rad = optics.power, optics.beam_sigma_rad
    if optics.power_at >= 0:
        power = power * exp(nuisances[optics.power_at])
    if optics.sigma_at >= 0:
        beam_sigma_rad = beam_sigma_rad + DEGREE * nuisances[optics.sigma_at]
    trace(optics.detectors, lamp, rays)
    shine(rays, power, beam_sigma_rad, beam)
    for i in range(len(optics.laws)):
        first = optics.law_settings[i, 0]
        if optics.law_at[i] >= 0:
            first = first + nuisances[optics.law_at[i]]
        second, third = optics.law_settings[i, 1], optics.law_settings[i, 2]
        row = BEAM_ROWS + i
        transmit(optics.laws[i], rays, first, second, third, beam, row, differentiate)


def project(optics: Optics, lamp: Any, lamp_slopes: Any, rays: Any, beam: Any, image: Any) -> None:
    """Write the light on the array, and its slopes by p coordinates and q nuisances.

    `lamp_slopes` are those of lamp and axis by the coordinates, shape ``(6, p, ...)``. The image is
    light, slopes by the coordinates and by the nuisances, shape ``(1 + p + q, ..., n)``, or light
    alone, shape ``(1, ..., n)``.
    """
    detectors = optics.detectors
    size, n = lamp_slopes.shape[1], detectors.shape[1]
    for j in indices(n):
        image[0, j] = beam[LIGHT, j]
    if len(image) == 1:
        return
    vectors = workspace(6, lamp[0], n)
    _, _, _, axis_x, axis_y, axis_z = lamp
    for j in indices(n):
        light = beam[LIGHT, j]
        radial, facing, bend = slopes_by_lamp(
            light * beam[BY_RANGE, j],
            light * beam[BY_HALF_SQUARE, j],
            light * beam[BY_COSINE, j],
            rays[RANGE, j],
            rays[COSINE, j],
            rays[ALONG, j],
            rays[TURN, j],
        )
        to_x, to_y, to_z = rays[TO_X, j], rays[TO_Y, j], rays[TO_Z, j]
        vectors[0, j] = radial * to_x + facing * detectors[3, j] + bend * axis_x
        vectors[1, j] = radial * to_y + facing * detectors[4, j] + bend * axis_y
        vectors[2, j] = radial * to_z + facing * detectors[5, j] + bend * axis_z
        vectors[3, j], vectors[4, j], vectors[5, j] = bend * to_x, bend * to_y, bend * to_z
    for q in range(size):
        by_x, by_y, by_z = lamp_slopes[0, q], lamp_slopes[1, q], lamp_slopes[2, q]
        by_u, by_v, by_w = lamp_slopes[3, q], lamp_slopes[4, q], lamp_slopes[5, q]
        for j in indices(n):
            image[1 + q, j] = (
                vectors[0, j] * by_x
                + vectors[1, j] * by_y
                + vectors[2, j] * by_z
                + vectors[3, j] * by_u
                + vectors[4, j] * by_v
                + vectors[5, j] * by_w
            )
    first = 1 + size
    for row in range(first, len(image)):
        for j in indices(n):
            image[row, j] = 0.0
    if optics.power_at >= 0:
        for j in indices(n):
            image[first + optics.power_at, j] = image[0, j]
    if optics.sigma_at >= 0:
        for j in indices(n):
            image[first + optics.sigma_at, j] = image[0, j] * beam[BY_SIGMA, j] * DEGREE
    for i in range(len(optics.law_at)):
        if optics.law_at[i] >= 0:
            # A law may share a setting with the lamp.
            for j in indices(n):
                image[first + optics.law_at[i], j] += image[0, j] * beam[BEAM_ROWS + i, j]


def detect(optics: Optics, nuisances: Any, image: Any) -> None:
    """Apply the steps on the array to an image of `project`, with or without slopes, in place."""
    rows, n = len(image), image.shape[-1]
    first, differentiate = rows - optics.nuisances, rows > 1
    for i in range(len(optics.step_kinds)):
        kind, values, scale = optics.step_kinds[i], optics.step_values[i], optics.step_scales[i]
        place = optics.step_at[i]
        if kind == BACKGROUND:
            if place >= 0:
                scale = scale + nuisances[place]
                if differentiate:
                    for j in indices(n):
                        image[first + place, j] += values[j]
            for j in indices(n):
                image[0, j] += scale * values[j]
        elif kind == GAIN:
            if place >= 0:
                common = 1 + scale * nuisances[place]
                for row in range(1, rows):
                    for j in indices(n):
                        image[row, j] *= common
                if differentiate:
                    for j in indices(n):
                        image[first + place, j] += scale * image[0, j]
                for j in indices(n):
                    image[0, j] *= common
            for row in range(rows):
                for j in indices(n):
                    image[row, j] *= values[j]
        elif kind == SHADE:
            depth = nuisances[place]
            for j in indices(n):
                passed = exp(depth * values[j])
                for row in range(rows):
                    image[row, j] *= passed
            if differentiate:
                for j in indices(n):
                    image[first + place, j] += values[j] * image[0, j]
        else:
            sandwich(optics.blur, image)


@law
def reading_variance(light: Any, noise: ReadingNoise) -> Any:
    """Variance of a reading, counts^2, by its light, counts (Eren et al. 2016, eq. 7)."""
    lit = maximum(light, 0.0)
    return maximum(noise.variance + (noise.slope + noise.square * lit) * lit, MIN_VARIANCE)


@law
def variance_slope(light: Any, noise: ReadingNoise) -> Any:
    """Slope of `reading_variance` by the light, counts; at an edge that of the darker side."""
    lit = maximum(light, 0.0)
    grows = noise.variance + (noise.slope + noise.square * lit) * lit > MIN_VARIANCE
    return choose((light > 0) & grows, noise.slope + 2 * noise.square * lit, 0.0)
