"""The five key parameters of an image: the signature of a pose (Eren et al. 2016, section IV)."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy import floor, maximum, minimum, sqrt
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.numerics.elementwise import at_place, choose, each, law, when
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.scene import SignatureSettings

FEATURE_NAMES = ("peak", "column", "row", "skewness_horizontal", "skewness_vertical")
FEW_IMAGES = 8  # up to here one after the other is faster than all at once


@dataclass(frozen=True)
class FeatureSettings:
    """What is no image of the lamp; parameters of the feature node."""

    min_peak_counts: Annotated[
        float, Quantity("peak below which there is no light", "counts", 0, 65535)
    ] = 5.0


def skewness(values: ArrayLike) -> Array:
    """Compute the population skewness along the last axis; 0 for values that do not vary.

    Parameters
    ----------
    values
        Shape ``(..., n)``, any unit.

    Returns
    -------
    Array
        ``m3 / m2^1.5``, shape ``(...)``, dimensionless.
    """
    return np.asarray(skewness_of(np.moveaxis(np.asarray(values, dtype=float), -1, 0)))


def skewness_of(values: Any) -> Any:
    """As `skewness`, of values along the first axis."""
    count = len(values)
    # Scaled to one, the powers neither overflow nor underflow.
    largest, mean = 0.0 * values[0], 0.0 * values[0]
    for k in range(count):
        largest = maximum(largest, abs(values[k]))
    largest = choose(largest > 0, largest, 1.0)
    for k in range(count):
        mean = mean + values[k] / largest
    mean = mean / count
    second, third = 0.0 * mean, 0.0 * mean
    for k in range(count):
        off = values[k] / largest - mean
        square = off * off
        second, third = second + square, third + square * off
    second, third = second / count, third / count
    # Rounding leaves about 1e-32 of a constant profile; that is no shape.
    varies = second > 1e-30
    second = choose(varies, second, 1.0)
    return choose(varies, third, 0.0) / (second * sqrt(second))


def differentiate(profiles: Any, slopes: Any, i: Any) -> None:
    """Differentiate profiles along the first axis, as `numpy.gradient`, shape ``(side, m)``."""
    last = len(profiles) - 1
    slopes[0, i] = profiles[1, i] - profiles[0, i]
    slopes[last, i] = profiles[last, i] - profiles[last - 1, i]
    for k in range(1, last):
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
    readings: Any, side: int, i: Any, places: Any, wide: Any, high: Any, centres: Any
) -> None:
    """Choose among the brightest detectors of an image the one nearest their centroid.

    Parameters
    ----------
    readings, side
        As in `write_parameters`.
    i
        The image, or those with ties.
    places
        Result: row-major place of the detector, shape ``(m,)``.
    wide, high
        Results: more than 0 where the top is more than a detector wide or high.
    centres
        Result: column and row of the centroid, shape ``(2, m)``.
    """
    brightest = readings[0, i]
    for k in range(1, side * side):
        brightest = maximum(brightest, readings[k, i])
    tops, column_sum, row_sum = 0 * brightest, 0 * brightest, 0 * brightest
    for k in range(side * side):
        is_top = choose(readings[k, i] == brightest, 1.0, 0.0)
        tops = tops + is_top
        column_sum = column_sum + is_top * (k % side)
        row_sum = row_sum + is_top * (k // side)
    # Of several nearest the first; in whole numbers, so that ties are ties.
    nearest, place = 0 * brightest + 1e300, 0 * brightest
    width, height = 0 * brightest, 0 * brightest
    for k in range(side * side):
        column_off = k % side * tops - column_sum
        row_off = k // side * tops - row_sum
        off = column_off * column_off + row_off * row_off
        is_top = readings[k, i] == brightest
        better = is_top & (off < nearest)
        nearest = choose(better, off, nearest)
        place = choose(better, float(k), place)
        width = width + choose(is_top, abs(column_off), 0.0)
        height = height + choose(is_top, abs(row_off), 0.0)
    places[i], wide[i], high[i] = place, width, height
    centres[0, i], centres[1, i] = column_sum / tops, row_sum / tops


def write_parameters(
    readings: Any, side: int, full_scale_counts: float, subdetector: bool, parameters: Any
) -> None:
    """Write the key parameters of images: see `key_parameters`.

    Parameters
    ----------
    readings
        Counts, row-major, shape ``(side * side, m)``.
    side, full_scale_counts
        As in `key_parameters`.
    subdetector
        Whether the peak is placed between detectors.
    parameters
        Result, shape ``(5, m)``.
    """
    last, middle, count = side - 1, 0.5 * (side - 1), readings.shape[1]
    places, wide, high = np.empty(count), np.empty(count), np.empty(count)
    centres = np.zeros((2, count))
    profiles, slopes = np.empty((side, count)), np.empty((side, count))
    for i in each(readings.shape[1]):
        brightest = readings[0, i]
        place = 0 * brightest
        for k in range(1, side * side):
            better = readings[k, i] > brightest
            brightest = choose(better, readings[k, i], brightest)
            place = choose(better, float(k), place)
        tops = 0 * brightest
        for k in range(side * side):
            tops = tops + choose(readings[k, i] == brightest, 1.0, 0.0)
        places[i], wide[i], high[i] = place, 0.0, 0.0
        for t in when(tops > 1, i):
            settle_ties(readings, side, t, places, wide, high, centres)
        place = places[i]
        row = floor((place + 0.5) / side)
        column = place - row * side
        parameters[0, i] = brightest / full_scale_counts
        for upright in range(2):
            along = choose(upright == 1, row, column)
            across = choose(upright == 1, column, row)
            step, base = (side, across) if upright == 1 else (1, across * side)
            for k in range(side):
                profiles[k, i] = at_place(readings, base + k * step, i)
            differentiate(profiles, slopes, i)
            found = along
            if subdetector:
                inside = (along > 0) & (along < last)
                before = at_place(readings, base + maximum(along - 1, 0) * step, i)
                after = at_place(readings, base + minimum(along + 1, last) * step, i)
                found = along + choose(inside, vertex(before, brightest, after), 0.0)
                flat = choose(upright == 1, high[i], wide[i]) > 0
                found = choose(flat, centres[upright, i], found)
            lit = brightest > 0
            parameters[1 + upright, i] = choose(lit, found - middle, 0.0)
            parameters[3 + upright, i] = choose(lit, skewness_of(slopes[:, i]), 0.0)
        for _ in when(brightest <= 0, i):
            parameters[0, _] = 0.0


def prepare(side: int) -> None:
    """Compile what `key_parameters` of a few images runs from then on in this process."""
    write = compilation.compiled(write_parameters)
    compilation.prepare(write, np.ones((side * side, 1)), side, 1.0, True, np.empty((5, 1)))


@np.errstate(under="ignore")  # the least of readings lose digits, no more
def key_parameters(
    images: ArrayLike, full_scale_counts: float, peak: Literal["detector", "subdetector"]
) -> Array:
    """Compute the five key parameters of images.

    The peak is the brightest detector; of several equally bright ones (a saturated top, a
    tie) the one nearest their centroid, of several nearest the first in reading order. Both
    profiles run through it.

    Parameters
    ----------
    images
        Readings in counts, finite and >= 0, shape ``(..., side, side)`` with side >= 2.
    full_scale_counts
        Largest reading of the array (I_max), counts, > 0.
    peak
        ``detector`` places the peak at a whole detector, as the paper does; ``subdetector``
        at the vertex of a parabola through its neighbours, or along an axis on which the top
        is flat at its centroid.

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
    count = readings.shape[1]
    parameters = np.empty((5, count))
    write = write_parameters
    if count <= FEW_IMAGES:
        write = compilation.if_prepared(write, compilation.by_number(write))
    write(readings, side, float(full_scale_counts), peak == "subdetector", parameters)
    return parameters.T.reshape(*images.shape[:-2], 5)


@np.errstate(under="ignore")
def lifted(parameters: ArrayLike, settings: SignatureSettings, side: int) -> Array:
    """Weigh the five parameters and append the constant: the vectors that are matched.

    The spectral angle of five numbers does not see their common scale, so that an aligned
    array has one signature at every range; the appended constant makes the angle see it.

    Parameters
    ----------
    parameters
        Key parameters, shape ``(..., 5)``.
    settings
        The scene's weights.
    side
        Detectors in a row, >= 2.

    Returns
    -------
    Array
        Shape ``(..., 6)``, dimensionless.
    """
    parameters = np.asarray(parameters, dtype=float)
    position = settings.position_weight * 2 / (side - 1)
    skew = settings.skewness_weight
    weights = np.array([settings.peak_weight, position, position, skew, skew])
    vectors = np.empty((*parameters.shape[:-1], 6))
    vectors[..., :5] = parameters * weights
    vectors[..., 5] = settings.lift
    return vectors


def no_pattern(image: Array, min_peak_counts: float) -> str | None:
    """Say why an image carries no pattern to match, or ``None`` where it does.

    Parameters
    ----------
    image
        Readings in counts, shape ``(side, side)``.
    min_peak_counts
        Peak below which there is no light, counts.

    Returns
    -------
    str or None
        The reason, with the figure that decided.
    """
    brightest, darkest = float(np.max(image)), float(np.min(image))
    if not np.isfinite(brightest):
        return f"not finite: a detector reads {brightest}"
    if brightest < min_peak_counts:
        return f"no light: the peak of {brightest:g} counts is below {min_peak_counts:g}"
    if brightest == darkest:
        return f"no pattern: every detector reads {brightest:g} counts"
    return None
