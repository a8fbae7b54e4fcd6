"""How likely readings are under expected light: Gaussian noise, censored at the array's noise."""

import math
from typing import Any

import numpy as np
from numpy import log, maximum, minimum, sqrt
from scipy.special import erfcx, log_ndtr, ndtr

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.elementwise import choose, indices, indices_where, law
from uuv_optical_array.forward.noise import ReadingNoise, grows, reading_variance, variance_slope

FAR = 35.0  # standard deviations inside, where a limit says nothing
ASYMPTOTIC = -37.0  # below this the series of Mills's ratio is right to 2e-12
DENSITY = 1 / math.sqrt(2 * math.pi)  # of a standard normal at 0


@law
def hazard(u: Any) -> Any:
    """Return the normal density over its distribution, phi(u) / Phi(u), without overflow."""
    # The scaled complementary error function does not underflow where both factors do.
    return math.sqrt(2 / math.pi) / erfcx(minimum(u, FAR) * -math.sqrt(0.5))


@law
def gaussian(reading: Any, light: Any, variance: Any) -> tuple[Any, Any, Any]:
    """Return value, score and Fisher information of a reading that is Gaussian about the light.

    They are the logarithm of the density, but for what the variance alone adds, its derivative by
    the light, 1/counts, and 1/counts^2.
    """
    precision = 1 / variance
    residual = reading - light
    score = residual * precision
    return -0.5 * residual * score, score, precision


@law
def gaussian_growing(reading: Any, light: Any, variance: Any, slope: Any) -> tuple[Any, Any, Any]:
    """As `gaussian`, where the variance grows with the light by a slope, counts.

    The information is ``1/v + v'^2 / (2 v^2)`` (S. Kay, Estimation Theory, 1993, eq. 3.31).
    """
    value, score, precision = gaussian(reading, light, variance)
    relative = slope * precision
    score = score + 0.5 * relative * ((reading - light) * score - 1)
    return value - 0.5 * log(variance), score, precision + 0.5 * relative * relative


@law
def censored(light: Any, bound: Any, sign: Any, variance: Any) -> tuple[Any, Any, Any]:
    """As `gaussian`, of a reading that only says that the light is not beyond a bound.

    The sign is 1 where the light is not below it, -1 where it is not above. In place of Fisher's
    information is the second derivative, sign turned.
    """
    precision = 1 / sqrt(variance)
    # Beyond this all is equally improbable, and a square is still finite.
    u = minimum(maximum(sign * (light - bound) * precision, -1e100), 1e100)
    over = hazard(u)
    share = maximum(over * (over + u), 0.0)
    # Where hazard and u cancel, the series of Mills's ratio does not.
    below = minimum(u, -1.0)
    s = 1 / (below * below)
    less = s * (1 - 3 * s * (1 - 5 * s * (1 - 7 * s * (1 - 9 * s))))
    share = choose(u <= ASYMPTOTIC, less / s / ((1 - less) * (1 - less)), share)
    return log_ndtr(u), sign * over * precision, share * precision * precision


def likelihood_of(readings: Any, light: Any, noise: ReadingNoise, result: Any) -> None:
    """Write the log-likelihood of each reading, with derivatives by its light.

    A reading inside the limits is Gaussian about the light; one at a limit is censored and counts
    by the probability of lying beyond (Tobit model). The result is as of `gaussian`, ``(3, n)``.
    """
    for j in indices(len(light)):
        variance = reading_variance(light[j], noise)
        if grows(noise):
            slope = variance_slope(light[j], noise)
            value, score, curvature = gaussian_growing(readings[j], light[j], variance, slope)
        else:
            value, score, curvature = gaussian(readings[j], light[j], variance)
        result[0, j], result[1, j], result[2, j] = value, score, curvature
    for j in indices(len(light)):
        for i in indices_where((readings[j] >= noise.high) | (readings[j] <= noise.low), j):
            above = readings[i] >= noise.high
            bound = choose(above, noise.high - 0.5, noise.low + 0.5)
            variance = reading_variance(light[i], noise)
            result[0, i], result[1, i], result[2, i] = censored(
                light[i], bound, choose(above, 1.0, -1.0), variance
            )


@np.errstate(under="ignore")
def log_likelihood(
    readings: Array, light: Array, noise: ReadingNoise
) -> tuple[Array, Array, Array]:
    """Return `likelihood_of` many images, each part in the shape of the light, ``(..., n)``.

    The last one, >= 0, is what the second derivative is to be for Gauss-Newton, sign turned.
    """
    result = np.empty((3, light.size))
    flat = np.broadcast_to(readings, light.shape).reshape(-1)
    likelihood_of(flat, light.reshape(-1), noise, result)
    value, score, curvature = result.reshape(3, *light.shape)
    return value, score, curvature


@np.errstate(under="ignore")
def information(light: Array, noise: ReadingNoise) -> Array:
    """Fisher information of a reading about its expected light.

    ``1/v + v'^2 / (2 v^2)`` inside the limits (S. Kay, Estimation Theory, 1993, eq. 3.31),
    with the share of the Gaussian that the limits cut off replaced by what a censored
    reading still says; 1/counts^2, in the shape of the light.
    """
    variance = reading_variance(light, noise)
    slope = variance_slope(light, noise)
    std = np.sqrt(variance)
    whole = 1 / variance + 0.5 * (slope / variance) ** 2
    low = (noise.low + 0.5 - light) / std
    high = (noise.high - 0.5 - light) / std
    if (low < -9).all() and (high > 9).all():
        return whole
    low, high = np.clip(low, -40, 40), np.clip(high, -40, 40)

    def density(u: Array) -> Array:
        return DENSITY * np.exp(-0.5 * u * u)

    inside = ndtr(high) - ndtr(low)
    share = inside - high * density(high) + low * density(low)
    share = share + density(low) * hazard(low) + density(high) * hazard(-high)
    return whole * np.clip(share, 0.0, 1.0)
