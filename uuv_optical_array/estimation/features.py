"""The five key parameters of an image: the signature of a pose (Eren et al. 2016, section IV)."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity

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
    scaled = given / np.where(largest > 0, largest, 1.0)
    count = given.shape[-1]
    deviation = scaled - np.add.reduce(scaled, axis=-1, keepdims=True) / count
    squared = deviation * deviation
    second = np.add.reduce(squared, axis=-1) / count
    third = np.add.reduce(squared * deviation, axis=-1) / count
    # Rounding leaves about 1e-32 of a constant profile; that is no shape.
    varies = second > 1e-30
    return np.where(varies, third, 0.0) / np.where(varies, second, 1.0) ** 1.5


def _vertex(profiles: Array, index: NDArray[np.intp]) -> Array:
    """Offset of the parabola's vertex from a maximum at `index`, in detectors, within 0.5."""
    last = profiles.shape[1] - 1
    around = np.clip(index[:, None] + (-1, 0, 1), 0, last)
    before, top, after = np.take_along_axis(profiles, around, axis=1).T
    curvature = before - 2 * top + after
    bent = (index > 0) & (index < last) & (curvature < 0)
    # Halved after the division: a difference of tiny readings may not halve.
    offset = np.where(bent, before - after, 0.0) / np.where(bent, curvature, 1.0) / 2
    return np.clip(offset, -0.5, 0.5)


def _flat_tops(top: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Array]:
    """Return the peak of tops of several detectors, and along which axes they are flat, and where.

    Both hold column and row, shape ``(2, m)``; the second is nan along an axis on which the top
    is one detector wide, so that it still has its vertex there.
    """
    indices = np.arange(top.shape[-1])
    counts = np.stack([top.sum(axis=1), top.sum(axis=2)])  # by column, by row
    centroids = (counts @ indices) / counts.sum(axis=-1)
    away = (indices - centroids[..., None]) ** 2
    distance = np.where(top, away[1, :, :, None] + away[0, :, None, :], np.inf)
    row, column = np.divmod(distance.reshape(len(top), -1).argmin(axis=1), len(indices))
    sharp = np.count_nonzero(counts, axis=-1) == 1
    return np.stack([column, row]), np.where(sharp, np.nan, centroids)


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
    stack, frames = images.reshape(count, side, side), np.arange(count)
    flat = images.reshape(count, side * side)
    brightest = flat.max(axis=1)
    top = flat == brightest[:, None]
    # Of each frame in column and row: the peak, and where the top is flat its centroid.
    peaks = np.array(np.divmod(top.argmax(axis=1), side)[::-1])
    flat_at = np.full((2, count), np.nan)
    tied = np.flatnonzero(np.count_nonzero(top, axis=1) > 1)
    if len(tied):
        peaks[:, tied], flat_at[:, tied] = _flat_tops(top[tied].reshape(-1, side, side))
    column, row = peaks
    # Of each frame its horizontal, then of each its vertical profile.
    profiles = np.concatenate([stack[frames, row], stack[frames, :, column]])
    places = peaks.reshape(-1).astype(float)
    if peak == "subdetector":
        places += _vertex(profiles, peaks.reshape(-1))
        np.copyto(places, flat_at.reshape(-1), where=~np.isnan(flat_at.reshape(-1)))
    parameters = np.empty((count, 5))
    parameters[:, 0] = brightest / full_scale_counts
    parameters[:, 1:3] = places.reshape(2, count).T - (side - 1) / 2
    parameters[:, 3:] = skewness(np.gradient(profiles, axis=-1)).reshape(2, count).T
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
