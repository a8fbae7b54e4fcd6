"""The noise of a reading by its light, for NumPy and compiled."""

from typing import Any, NamedTuple

from uuv_optical_array.core.numerics.elementwise import choose, law, maximum

# A scene without noise is read as if to a thousandth of a count.
MIN_VARIANCE = 1e-6


class ReadingNoise(NamedTuple):
    """How a scene's readings differ from the light.

    - variance, slope, square: variance of a reading in the dark, counts^2, with rounding; its
      growth with the light, counts, and with its square: the variance of what is relative to it.
    - low, high: limits of the readings, counts: at `low` or below, the light was at most `low` +
      0.5, at `high` or above at least `high` - 0.5.
    - black: reading of darkness, counts, which is no light.
    """

    variance: float
    slope: float
    low: float
    high: float
    square: float = 0.0
    black: float = 0.0


def grows(noise: ReadingNoise) -> bool:
    """Say whether noise grows with the light, so that likelihoods have a share of its variance."""
    return noise.slope > 0 or noise.square > 0


@law
def reading_variance(light: Any, noise: ReadingNoise) -> Any:
    """Variance of a reading, counts^2, by its light, counts (Eren et al. 2016, eq. 7)."""
    lit = maximum(light - noise.black, 0.0)
    return maximum(noise.variance + (noise.slope + noise.square * lit) * lit, MIN_VARIANCE)


@law
def variance_slope(light: Any, noise: ReadingNoise) -> Any:
    """Slope of `reading_variance` by the light, counts; at an edge that of the darker side."""
    lit = maximum(light - noise.black, 0.0)
    more = noise.variance + (noise.slope + noise.square * lit) * lit > MIN_VARIANCE
    return choose((lit > 0) & more, noise.slope + 2 * noise.square * lit, 0.0)
