"""How likely readings are under expected light: Gaussian noise, censored at the array's limits."""

from dataclasses import dataclass

import numpy as np
from scipy.special import erfcx, log_ndtr, ndtr

from uuv_optical_array.core.geometry import Array

FAR = 35.0  # standard deviations inside, where a limit says nothing
ASYMPTOTIC = -37.0  # below this the series of Mills's ratio is right to 2e-12
LOG_SQRT_2PI = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True)
class Limits:
    """Readings that only bound the light.

    Parameters
    ----------
    low
        A reading at or below this says that the light was not above `low` + 0.5, counts.
    high
        A reading at or above this says that the light was not below `high` - 0.5, counts.
    """

    low: float = -np.inf
    high: float = np.inf


def _hazard(u: Array) -> Array:
    """Return the normal density over its distribution, phi(u) / Phi(u), without overflow."""
    # The scaled complementary error function does not underflow where both factors do.
    return np.sqrt(2 / np.pi) / erfcx(np.minimum(u, FAR) * -np.sqrt(0.5))


@np.errstate(under="ignore")
def log_likelihood(
    readings: Array, light: Array, variance: Array, slope: Array, limits: Limits
) -> tuple[Array, Array, Array]:
    """Log-likelihood of readings, with its first two derivatives by the light.

    A reading inside the limits is Gaussian about the light; one at a limit is censored and
    counts by the probability of lying beyond (the Tobit model).

    Parameters
    ----------
    readings
        Counts, shape ``(..., n)`` or ``(n,)``.
    light
        Expected light, counts, shape ``(..., n)``.
    variance, slope
        Variance of a reading, counts^2, and its derivative by the light, in that shape.
    limits
        The array's.

    Returns
    -------
    value : Array
        Summed over the detectors, without the constant, shape ``(...)``.
    score : Array
        Derivative by the light, 1/counts, shape ``(..., n)``.
    curvature : Array
        What the second derivative is to be for Gauss-Newton, with its sign turned, >= 0,
        1/counts^2, shape ``(..., n)``.
    """
    curvature = 1 / variance
    residual = readings - light
    score = residual * curvature
    terms = -0.5 * residual * score
    if slope.any():
        relative = slope * curvature
        score = score + 0.5 * relative * (residual * score - 1)
        curvature = curvature + 0.5 * relative**2
        terms -= 0.5 * np.log(variance)
    for beyond, bound, sign in (
        (readings >= limits.high, limits.high - 0.5, 1.0),
        (readings <= limits.low, limits.low + 0.5, -1.0),
    ):
        if beyond.any():
            here = np.broadcast_to(beyond, light.shape)
            inverse_std = 1 / np.sqrt(variance[here])
            # Beyond this all is as improbable, and a square still has a number.
            u = np.clip(sign * (light[here] - bound) * inverse_std, -1e100, 1e100)
            hazard = _hazard(u)
            terms[here] = log_ndtr(u)
            score[here] = sign * hazard * inverse_std
            share = np.maximum(hazard * (hazard + u), 0.0)
            # Where hazard and u cancel, the series of Mills's ratio does not.
            far = u <= ASYMPTOTIC
            s = 1 / u[far] ** 2
            less = s * (1 - 3 * s * (1 - 5 * s * (1 - 7 * s * (1 - 9 * s))))
            share[far] = less / s / (1 - less) ** 2
            curvature[here] = share * inverse_std**2
    return terms.sum(axis=-1), score, curvature


@np.errstate(under="ignore")
def information(light: Array, variance: Array, slope: Array, limits: Limits) -> Array:
    """Fisher information of a reading about its expected light.

    ``1/v + v'^2 / (2 v^2)`` inside the limits (S. Kay, Estimation Theory, 1993, eq. 3.31),
    with the share of the Gaussian that the limits cut off replaced by what a censored
    reading still says.

    Parameters
    ----------
    light, variance, slope, limits
        As in `log_likelihood`, in one shape.

    Returns
    -------
    Array
        1/counts^2, in that shape, >= 0.
    """
    std = np.sqrt(variance)
    whole = 1 / variance + 0.5 * (slope / variance) ** 2
    low = (limits.low + 0.5 - light) / std
    high = (limits.high - 0.5 - light) / std
    if (low < -9).all() and (high > 9).all():
        return whole
    low, high = np.clip(low, -40, 40), np.clip(high, -40, 40)

    def density(u: Array) -> Array:
        return np.exp(-0.5 * u * u - LOG_SQRT_2PI)

    inside = ndtr(high) - ndtr(low)
    share = inside - high * density(high) + low * density(low)
    share = share + density(low) * _hazard(low) + density(high) * _hazard(-high)
    return whole * np.clip(share, 0.0, 1.0)
