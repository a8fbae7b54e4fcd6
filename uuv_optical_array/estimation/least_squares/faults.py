"""Faulty detectors, whose readings are not believed.

Readings are Gaussian about the light, or those of a detector that is dead, stuck, dirty or in a
glint: anything to full scale, of all lamps. How far a detector is believed is its weight, which
follows from its residuals, and the fit from the weights, in turns (A. Dempster, N. Laird and
D. Rubin, 1977, J. R. Stat. Soc. B 39, 1). From afar all residuals are large, so the noise is taken
for larger at first, and cools (A. Blake and A. Zisserman, *Visual Reconstruction*, 1987).
"""

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.problem import (
    AT,
    Problem,
    light_at,
    lit,
    refine,
    start_at,
)
from uuv_optical_array.estimation.least_squares.starts import Guide
from uuv_optical_array.forward.optics import ReadingNoise, reading_variance

FAULTY = 1e-2  # probability that a detector reads anything, in an image that does not fit
AT_LIMIT = 0.25  # and that it is then dark, or at full scale
# Cost of a detector, as of three standard deviations, beyond which it is hardly believed: where one
# is faulty, few others are worth the risk. Each further lamp adds what chi-squares of more degrees
# of freedom are larger.
DISBELIEVED, EACH_LAMP = 4.5, 1.25
LIT_EACH = 6  # clearly lit detectors beside each that is not believed, or the rest fits anything
STARTS = 8
COOLER = 0.25  # factor of the variance from turn to turn
TURNS, STEPS = 12, 6  # of weights and fit, and steps of the latter
SETTLED = 1e-2  # change of the weights from which they stay


def lamps_of(problem: Problem) -> int:
    """Return how many lamps an image is of."""
    return problem.optics.lamps.shape[1]


def most_faulty(problem: Problem) -> int:
    """Return how many detectors need not be believed; they may be the brightest."""
    readings = np.sort(problem.readings.reshape(lamps_of(problem), -1).max(axis=0))
    for count in range(len(readings) // (LIT_EACH + 1), 0, -1):
        others = readings[:-count]
        full = np.count_nonzero(others >= problem.noise.high)
        if lit(problem._replace(readings=others)) + 2 * full >= LIT_EACH * count:
            return count
    return 0


def grows(noise: ReadingNoise) -> bool:
    """Say whether the log-likelihood of a reading has a share of its variance."""
    return noise.slope > 0 or noise.square > 0


def write_squares(problem: Problem, light: Array, squares: Array) -> None:
    """Write by how many standard deviations detectors are off, squared, in all images."""
    noise = problem.noise
    squares.fill(0.0)
    for j in range(len(light)):
        off = problem.readings[j] - min(max(light[j], noise.low), noise.high)
        squares[j % len(squares)] += off * off / reading_variance(light[j], noise)


def weigh(problem: Problem, squares: Array, heat: float) -> tuple[float, float]:
    """Write how far detectors are believed, by a variance `heat` times as large.

    - returned: largest change of a weight, and what the weights add to the cost of the readings.
    """
    weights, detectors = problem.weights, len(squares)
    doubted = DISBELIEVED + EACH_LAMP * (lamps_of(problem) - 1)
    change, cost = 0.0, 0.0
    for d in range(detectors):
        weight = 1 / (1 + np.exp(min(0.5 * squares[d] / heat - doubted, 500.0)))
        change = max(change, abs(weight - weights[d]))
        weights[d::detectors] = weight
        cost += doubted * (1 - weight) + weight * np.log(weight)
        if weight < 1:
            cost += (1 - weight) * np.log(1 - weight)
    return change, cost


def log_faulty(problem: Problem, light: Array) -> float:
    """Return the logarithm of the probability of readings that are not believed, as faults."""
    noise, log, faulty = problem.noise, 0.0, FAULTY ** (1 / lamps_of(problem))
    full = min(noise.high, 2 * np.max(problem.readings) + 1)
    for j in range(len(light)):
        doubt = 1 - problem.weights[j]
        if noise.low < problem.readings[j] < noise.high:
            # The cost of readings leaves out what the variance adds where that does not grow.
            variance = 1.0 if grows(noise) else reading_variance(light[j], noise)
            log += doubt * (np.log(faulty / full) + 0.5 * np.log(2 * np.pi * variance))
        else:
            log += doubt * np.log(faulty * AT_LIMIT)
    return log


def write_unlike(guide: Guide, row: int, sight: Array, squares: Array) -> None:
    """Write how unlike an image and that of a pose are, by detectors that the guide has."""
    squares.fill(0.0)
    for j in range(len(guide.readings)):
        place = j % len(squares)
        squares[place] += (guide.roots[j, row] - sight[guide.readings[j]]) ** 2


def heat_of(squares: Array) -> float:
    """Return the factor of the variance that makes most residuals usual ones."""
    return max(np.sort(squares)[len(squares) // 2], 1.0)


def fit_believed(problem: Problem, at: Array, squares: Array) -> tuple[float, Array]:
    """Fit readings from a place with the weights that they deserve, which are written.

    - squares: workspace, one for each detector.
    - returned: cost in all, and where that is.
    """
    write_squares(problem, light_at(problem, at), squares)
    heat, total = heat_of(squares), np.inf
    for _ in range(TURNS):
        change, added = weigh(problem, squares, heat)
        state = refine(problem, at, STEPS)
        at, total = state.parts[AT].copy(), state.cost + added
        write_squares(problem, light_at(problem, at), squares)
        if heat == 1 and change < SETTLED:
            break
        heat = max(min(COOLER * heat, heat_of(squares)), 1.0)
    return total, at


def disbelieve(problem: Problem, guide: Guide) -> tuple[Array, float]:
    """Write the weights of readings where one pose explains most of them, by the best of starts.

    - problem: with readings and weights of its own; what is not believed is made that of the pose.
    - guide: where fits may start.
    - returned: where the fit is, and logarithm of the probability of what is not believed.
    """
    weights, readings, noise = problem.weights, problem.readings, problem.noise
    detectors, sight = len(readings) // lamps_of(problem), np.sqrt(np.maximum(readings, 0.0))
    seen, squares = np.empty(guide.side * guide.side), np.empty(detectors)
    most, distances = max(detectors // (LIT_EACH + 1), 1), np.empty(guide.units.shape[1])
    for row in range(len(distances)):
        write_unlike(guide, row, sight, seen)
        distances[row] = np.sort(seen)[: len(seen) - max(len(seen) // (LIT_EACH + 1), 1)].sum()
    least, best = np.inf, np.ones_like(weights)
    at = start_at(problem, guide.poses[0])
    for _ in range(STARTS):
        row = int(np.argmin(distances))
        distances[row] = np.inf
        weights.fill(1.0)
        cost, there = fit_believed(problem, start_at(problem, guide.poses[row]), squares)
        if cost < least and (weights[:detectors] < 0.5).sum() <= most:
            least, best, at = cost, weights.copy(), there
    light = light_at(problem, at)
    for j in range(len(weights)):
        weights[j] = best[j]
    log = log_faulty(problem, light)
    for j in range(len(weights)):
        if weights[j] < 0.5:
            readings[j] = min(max(light[j], noise.low), noise.high)
    return at, log
