"""Whether residuals are those of a valid image: their sum of squares and its distribution.

A reading inside the limits adds the square of a standard normal, one near a limit less, as what
lies beyond is cut off; both have closed moments. The sum is approximated by a scaled chi-square of
the same mean and variance, less what the fit removes.
"""

from typing import Any

from numpy import maximum, minimum, sqrt
from scipy.special import ndtr

from uuv_optical_array.core.numerics.elementwise import choose, exp, law
from uuv_optical_array.estimation.information.likelihood import DENSITY
from uuv_optical_array.forward.noise import ReadingNoise

FITTED = 5  # numbers of the pose; every other unknown has a prior, whose square counts too


@law
def cut_moments(inside: Any) -> tuple[Any, Any]:
    """Return mean square and mean fourth power of a normal that is cut off at a limit."""
    a = minimum(abs(inside), 35.0)
    square_a, density = a * a, DENSITY * exp(-0.5 * a * a)
    beyond = ndtr(-a)
    within_square = 1 - beyond - a * density + square_a * beyond
    within_fourth = 3 * (1 - beyond) - a * (square_a + 3) * density + square_a * square_a * beyond
    beyond_square = (1 + square_a) * beyond - a * density
    beyond_fourth = (3 + square_a * (6 + square_a)) * beyond - a * (5 + square_a) * density
    square = choose(inside >= 0, within_square, maximum(beyond_square, 0.0))
    fourth = choose(inside >= 0, within_fourth, maximum(beyond_fourth, 0.0))
    return square, fourth


@law
def residual_moments(light: Any, std: Any, noise: ReadingNoise) -> tuple[Any, Any]:
    """Return mean and variance of ``(residual / std)^2`` at the expected light, both in counts."""
    # The farther limit cuts off next to nothing.
    square, fourth = cut_moments(minimum(light - noise.low, noise.high - light) / std)
    return square, maximum(fourth - square * square, 0.0)


@law
def chi_square_shape(mean: Any, variance: Any) -> tuple[Any, Any]:
    """Return the mean of a sum of squares that a fit leaves, and the spread of its cube root."""
    left = maximum(mean - FITTED, 1.0)
    return left, maximum(variance - 2 * FITTED, 2.0) / (9 * left * left)


@law
def chi_square_score(squares: Any, mean: Any, variance: Any) -> Any:
    """Return the standard normal value as improbable as a sum of squares, with those of priors."""
    left, spread = chi_square_shape(mean, variance)
    return ((squares / left) ** (1 / 3) - 1 + spread) / sqrt(spread)
