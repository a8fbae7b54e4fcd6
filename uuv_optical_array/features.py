"""The five key parameters of an image: the signature of a pose (Eren et al. 2016, section IV)."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.pose import Array
from uuv_optical_array.quantity import Quantity

FEATURE_NAMES = ("peak", "column", "row", "skewness_horizontal", "skewness_vertical")


@dataclass(frozen=True)
class SignatureSettings:
    """How a scene's images become signatures, and how the five numbers weigh in the match."""

    peak: Literal["detector", "subdetector"] = "subdetector"
    peak_weight: Annotated[float, Quantity("weight of the peak value", "", 1e-6, 1e6)] = 2.0
    position_weight: Annotated[
        float, Quantity("weight of column and row, per half width of the array", "", 1e-6, 1e6)
    ] = 1.0
    skewness_weight: Annotated[float, Quantity("weight of both skewnesses", "", 1e-6, 1e6)] = 1.0
    lift: Annotated[
        float, Quantity("constant appended to the five, so that the angle sees scale", "", 0, 1e6)
    ] = 1.0


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
    given = np.asarray(values, dtype=float)
    # Scaled to one, the powers neither overflow nor underflow.
    largest = np.abs(given).max(axis=-1, keepdims=True)
    scaled = np.divide(given, largest, out=np.zeros_like(given), where=largest > 0)
    deviation = scaled - scaled.mean(axis=-1, keepdims=True)
    second = (deviation**2).mean(axis=-1)
    third = (deviation**3).mean(axis=-1)
    # Rounding leaves about 1e-32 of a constant profile; that is no shape.
    varies = second > 1e-30
    return np.divide(third, second**1.5, out=np.zeros_like(second), where=varies)


def _vertex(profile: Array, index: Array) -> Array:
    """Offset of the parabola's vertex from a maximum at `index`, in detectors, within 0.5."""
    rows = np.arange(len(profile))
    last = profile.shape[1] - 1
    inside = (index > 0) & (index < last)
    before = profile[rows, np.maximum(index - 1, 0)]
    after = profile[rows, np.minimum(index + 1, last)]
    curvature = before - 2 * profile[rows, index] + after
    bent = inside & (curvature < 0)
    # Halved after the division: a difference of tiny readings may not halve.
    offset = np.divide(before - after, curvature, out=np.zeros_like(curvature), where=bent) / 2
    return np.clip(offset, -0.5, 0.5)


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
    count = int(np.prod(images.shape[:-2]))
    stack = images.reshape(count, side, side)
    frames = np.arange(len(stack))
    brightest = stack.max(axis=(1, 2))
    top = stack == brightest[:, None, None]
    indices = np.arange(side)
    lit_rows, lit_columns = top.sum(axis=2), top.sum(axis=1)
    size = lit_rows.sum(axis=1)
    centroid_row = (lit_rows @ indices) / size
    centroid_column = (lit_columns @ indices) / size
    distance = (indices[:, None] - centroid_row[:, None, None]) ** 2 + (
        indices - centroid_column[:, None, None]
    ) ** 2
    nearest = np.where(top, distance, np.inf).reshape(count, side * side).argmin(axis=1)
    row, column = np.divmod(nearest, side)
    horizontal, vertical = stack[frames, row], stack[frames, :, column]
    if peak == "subdetector":
        # A top that is flat along one axis still has its vertex along the other.
        one_row = np.count_nonzero(lit_rows, axis=1) == 1
        one_column = np.count_nonzero(lit_columns, axis=1) == 1
        at_row = np.where(one_row, row + _vertex(vertical, row), centroid_row)
        at_column = np.where(one_column, column + _vertex(horizontal, column), centroid_column)
    else:
        at_row, at_column = row.astype(float), column.astype(float)
    centre = (side - 1) / 2
    parameters = np.stack(
        [
            brightest / full_scale_counts,
            at_column - centre,
            at_row - centre,
            skewness(np.gradient(horizontal, axis=-1)),
            skewness(np.gradient(vertical, axis=-1)),
        ],
        axis=-1,
    )
    parameters[brightest <= 0] = 0.0
    return parameters.reshape(*images.shape[:-2], 5)


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
