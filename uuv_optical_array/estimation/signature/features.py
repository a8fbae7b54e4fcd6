"""The five key parameters of an image: the signature of a pose (Eren et al. 2016, section IV)."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy import floor, sqrt
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.elementwise import (
    at_place,
    choose,
    indices,
    indices_where,
    law,
    maximum,
    minimum,
)
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.scene import Scene, SignatureSettings

FEATURE_NAMES = ("peak", "column", "row", "skewness_horizontal", "skewness_vertical")
LEAST = 1e-300  # scale of values that are practically 0
# Readings that differ by no more than this share are equally bright: in images of a model, which
# rounding makes differ in NumPy by another part than in compiled code.
TIE = 1e-12
Peak = Literal["detector", "subdetector"]


@dataclass(frozen=True)
class FeatureSettings:
    """Which images show no lamp; parameters of the feature node."""

    min_peak_counts: Annotated[
        float,
        Quantity("peak above darkness, below which an image has no light", "counts", 0, 65535),
    ] = 5.0


def write_skewness(values: Any, skews: Any) -> None:
    """Write the population skewness ``m3 / m2^1.5`` of m columns, ``(n, m)``, shape ``(m,)``.

    It is 0 without variation.
    """
    count, m = values.shape
    sums = np.zeros((4, m))
    scale, mean, second, third = sums[0], sums[1], sums[2], sums[3]
    # Scaled to one, the powers neither overflow nor underflow.
    for k in range(count):
        for i in indices(m):
            scale[i] = maximum(scale[i], abs(values[k, i]))
    for i in indices(m):
        scale[i] = 1 / maximum(scale[i], LEAST)
    for k in range(count):
        for i in indices(m):
            mean[i] += values[k, i] * scale[i]
    for i in indices(m):
        mean[i] /= count
    for k in range(count):
        for i in indices(m):
            off = values[k, i] * scale[i] - mean[i]
            square = off * off
            second[i] += square
            third[i] += square * off
    for i in indices(m):
        variance, cubes = second[i] / count, third[i] / count
        # Rounding leaves about 1e-32 of a constant profile; that is no shape.
        varies = variance > 1e-30
        variance = choose(varies, variance, 1.0)
        skews[i] = choose(varies, cubes, 0.0) / (variance * sqrt(variance))


def differentiate(profiles: Any, slopes: Any) -> None:
    """Differentiate profiles along the first axis, as `numpy.gradient`, shape ``(side, m)``."""
    last, m = len(profiles) - 1, profiles.shape[1]
    for i in indices(m):
        slopes[0, i] = profiles[1, i] - profiles[0, i]
        slopes[last, i] = profiles[last, i] - profiles[last - 1, i]
    for k in range(1, last):
        for i in indices(m):
            slopes[k, i] = 0.5 * (profiles[k + 1, i] - profiles[k - 1, i])


@law
def vertex(before: Any, top: Any, after: Any) -> Any:
    """Offset of a parabola's vertex from the largest of three readings, in detectors, to 0.5."""
    curvature = before - 2 * top + after
    bent = curvature < 0
    # Halved after the division: a difference of tiny readings may not halve.
    offset = choose(bent, before - after, 0.0) / choose(bent, curvature, 1.0) / 2
    return minimum(maximum(offset, -0.5), 0.5)


def settle_ties(
    readings: Any,
    side: int,
    i: Any,
    brightest: Any,
    places: Any,
    wide: Any,
    high: Any,
    centres: Any,
) -> None:
    """Choose among the brightest detectors of an image (`TIE`) the one nearest their centroid."""
    top = brightest[i]
    least = top - TIE * abs(top)
    tops, column_sum, row_sum = 0 * top, 0 * top, 0 * top
    for k in range(side * side):
        is_top = choose(readings[k, i] >= least, 1.0, 0.0)
        tops = tops + is_top
        column_sum = column_sum + is_top * (k % side)
        row_sum = row_sum + is_top * (k // side)
    # Of several nearest the first; in whole numbers, so that ties are ties.
    nearest, place = 0 * top + 1e300, 0 * top
    width, height = 0 * top, 0 * top
    for k in range(side * side):
        column_off = k % side * tops - column_sum
        row_off = k // side * tops - row_sum
        off = column_off * column_off + row_off * row_off
        is_top = readings[k, i] >= least
        better = is_top & (off < nearest)
        nearest = choose(better, off, nearest)
        place = choose(better, float(k), place)
        width = width + choose(is_top, abs(column_off), 0.0)
        height = height + choose(is_top, abs(row_off), 0.0)
    places[i], wide[i], high[i] = place, width, height
    # From the middle on, so that what is symmetric about it ends there, however it is divided.
    middle = 0.5 * (side - 1)
    centres[0, i] = middle + (column_sum - middle * tops) / tops
    centres[1, i] = middle + (row_sum - middle * tops) / tops


def write_parameters(
    readings: Any, side: int, full_scale_counts: float, subdetector: bool, parameters: Any
) -> None:
    """Write the `key_parameters`, ``(5, m)``, of m images by readings, ``(side * side, m)``."""
    last, middle, m = side - 1, 0.5 * (side - 1), readings.shape[1]
    peaks, flats = np.empty((6, m)), np.zeros((4, m))
    brightest, places, tops = peaks[0], peaks[1], peaks[2]
    along, start, skews = peaks[3], peaks[4], peaks[5]
    wide, high, centres = flats[0], flats[1], flats[2:]
    profiles, slopes, sides = np.empty((side, m)), np.empty((side, m)), np.zeros((2, m))
    # The images are the innermost loop everywhere, which a compiler turns into vectors.
    for i in indices(m):
        brightest[i], places[i], tops[i] = readings[0, i], 0.0, 1.0
    for k in range(1, side * side):
        for i in indices(m):
            reading, top = readings[k, i], brightest[i]
            better = reading > top + TIE * abs(top)
            tied = reading >= top - TIE * abs(top)
            tops[i] = choose(better, 1.0, tops[i] + choose(tied, 1.0, 0.0))
            places[i] = choose(better, float(k), places[i])
            brightest[i] = choose(better, reading, top)
    for i in indices(m):
        parameters[0, i] = maximum(brightest[i], 0.0) / full_scale_counts
        for t in indices_where(tops[i] > 1, i):
            settle_ties(readings, side, t, brightest, places, wide, high, centres)
    for upright in range(2):
        step = side if upright == 1 else 1
        flat = high if upright == 1 else wide
        for i in indices(m):
            row = floor((places[i] + 0.5) / side)
            column = places[i] - row * side
            along[i] = choose(upright == 1, row, column)
            start[i] = choose(upright == 1, column, row * side)
        for k in range(side):
            for i in indices(m):
                profiles[k, i] = at_place(readings, start[i] + k * step, i)
        differentiate(profiles, slopes)
        write_skewness(slopes, skews)
        if subdetector:
            # A choice from each row in turn makes vectors, a look-up of one place of each does not.
            for k in range(side):
                for i in indices(m):
                    sides[0, i] = choose(along[i] == k + 1, profiles[k, i], sides[0, i])
                    sides[1, i] = choose(along[i] == k - 1, profiles[k, i], sides[1, i])
            for i in indices(m):
                before, after = sides[0, i], sides[1, i]
                inside = (along[i] > 0) & (along[i] < last)
                offset = choose(inside, vertex(before, brightest[i], after), 0.0)
                along[i] = choose(flat[i] > 0, centres[upright, i], along[i] + offset)
        for i in indices(m):
            lit = brightest[i] > 0
            parameters[1 + upright, i] = choose(lit, along[i] - middle, 0.0)
            parameters[3 + upright, i] = choose(lit, skews[i], 0.0)


def prepare(side: int) -> None:
    """Compile what `key_parameters` runs from then on in this process."""
    readings, parameters = np.ones((side * side, 1)), np.empty((5, 1))
    compilation.prepare(write_parameters, readings, side, 1.0, True, parameters)


@np.errstate(under="ignore")  # the least of readings lose digits, no more
def parameters_of(readings: Array, full_scale_counts: float, peak: Peak) -> Array:
    """Return the `key_parameters`, ``(5, m)``, of m images by readings, ``(side * side, m)``."""
    side, parameters = math.isqrt(len(readings)), np.empty((5, readings.shape[1]))
    write = compilation.loaded(write_parameters)
    write(readings, side, float(full_scale_counts), peak == "subdetector", parameters)
    return parameters


def key_parameters(images: ArrayLike, full_scale_counts: float, peak: Peak) -> Array:
    """Compute the five key parameters of images.

    The peak is the brightest detector; of equal ones (a saturated top, a tie) the one nearest their
    centroid, of several nearest the first in reading order. Both profiles run through it.

    Parameters
    ----------
    images
        Readings in counts, finite and >= 0, shape ``(..., side, side)`` with side >= 2.
    full_scale_counts
        Largest reading of the array (I_max), counts, > 0.
    peak
        ``detector`` places the peak at a whole detector, as the paper does; ``subdetector`` at the
        vertex of a parabola through its neighbours, or along a flat top at its centroid.

    Returns
    -------
    Array
        Shape ``(..., 5)``: peak over full scale; column and row of the peak from the centre,
        in detectors (column grows to starboard, row downwards); skewness of the gradient of
        the horizontal and of the vertical profile. All 0 where there is no light.

    Raises
    ------
    ValueError
        For images that are not square or not finite.
    """
    images = np.asarray(images, dtype=float)
    if images.ndim < 2 or images.shape[-1] != images.shape[-2] or images.shape[-1] < 2:
        raise ValueError(f"images: shape {images.shape}; give (..., side, side) with side >= 2")
    if not np.isfinite(images).all():
        raise ValueError("images: not finite; drop frames that hold NaN or infinity")
    side = images.shape[-1]
    readings = np.ascontiguousarray(images.reshape(-1, side * side).T)
    parameters = parameters_of(readings, full_scale_counts, peak)
    return parameters.T.reshape(*images.shape[:-2], 5)


@np.errstate(under="ignore")
def lifted(parameters: ArrayLike, settings: SignatureSettings, side: int) -> Array:
    """Weigh the five parameters and append the constant: the vectors that are matched.

    The spectral angle of five numbers does not see their common scale, so that an aligned array has
    one signature at every range; with the constant it does. Shapes: ``(..., 5)``, ``(..., 6)``.
    """
    parameters = np.asarray(parameters, dtype=float)
    position = settings.position_weight * 2 / (side - 1)
    skew = settings.skewness_weight
    weights = np.array([settings.peak_weight, position, position, skew, skew])
    vectors = np.empty((*parameters.shape[:-1], 6))
    vectors[..., :5] = parameters * weights
    vectors[..., 5] = settings.lift
    return vectors


def scene_parameters(images: Array, scene: Scene) -> Array:
    """Return the key parameters of a scene's images, of all lamps together, shape ``(..., 5)``."""
    return key_parameters(together(images), scene.full_scale_counts, scene.signature.peak)


def no_pattern(image: Array, min_peak_counts: float) -> str | None:
    """Say why an image carries no pattern to match, or ``None`` where it does.

    If all readings are at full scale, the lamp is near, the sun shines in, or the array is broken.
    So uncertain a pose is useless near a leader, and without one the follower stops.
    """
    brightest, darkest = float(image.max()), float(image.min())
    if not math.isfinite(brightest):
        return f"not finite: a detector reads {brightest}"
    if brightest < min_peak_counts:
        return f"no light: the peak of {brightest:g} counts is below {min_peak_counts:g}"
    if brightest == darkest:
        return same_everywhere(brightest)
    return None


def same_everywhere(reading: float) -> str:
    """Say that all detectors read the same, counts."""
    return f"no pattern: every detector reads {reading:g} counts"
