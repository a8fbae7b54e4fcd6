"""Faulty detectors, whose readings are not believed.

Readings are Gaussian about the light, or those of a detector that is dead, stuck, dirty or in a
glint: anything to full scale, of all lamps. The weight of a detector is the probability that it
works; weights follow from residuals, and the fit from the weights, in turns (A. Dempster, N. Laird
and D. Rubin, 1977, J. R. Stat. Soc. B 39, 1). Far off all residuals are large, so the noise is
taken larger at first, and reduced (A. Blake and A. Zisserman, *Visual Reconstruction*, 1987).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.elementwise import partition
from uuv_optical_array.estimation.least_squares.problem import (
    Problem,
    light_at,
    lit,
    refine,
    start_at,
)
from uuv_optical_array.estimation.least_squares.starts import Guide, least_of, roots_of
from uuv_optical_array.forward.noise import ReadingNoise, grows, reading_variance

FAULTY = 1e-2  # probability that a detector is faulty, in an image that does not fit
AT_LIMIT = 0.25  # and how often it is then dark, or at full scale, for one that is neither
# Cost of a detector, that of three standard deviations, beyond which it has little weight: where
# one is faulty, others are doubted early. Each further lamp adds the growth of a chi-square with
# its degrees of freedom.
DISBELIEVED, EACH_LAMP = 4.5, 1.25
LIT_EACH = 6  # clearly lit detectors needed for each that is left out: any pose fits a few
STARTS: Any = np.int64(8)  # a NumPy integer, as Numba compiles again for each literal
COOLER = 0.25  # factor of the variance from turn to turn
TURNS = 12  # of weights and fit
STEPS: Any = np.int64(6)  # of a fit
SETTLED = 1e-2  # change of the weights below which they have converged


def most_faulty(problem: Problem) -> int:
    """Return how many detectors need not be believed; they may be the brightest."""
    lamps = problem.optics.lamps.shape[1]
    readings = np.sort(problem.readings.reshape(lamps, -1).max(axis=0))
    for count in range(len(readings) // (LIT_EACH + 1), 0, -1):
        others = readings[:-count]
        full = np.count_nonzero(others >= problem.noise.high)
        if lit(others, problem) + 2 * full >= LIT_EACH * count:
            return count
    return 0


def lines_of_neighbours(out: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which detectors are in a row or column of which neighbours are left out.

    What hides several of a line, as a hull does, is taken to hide all of it. Shapes as of an image.
    """
    square = out.reshape(-1, out.shape[1], out.shape[1])  # of each lamp
    rows = (square[:, :, 1:] & square[:, :, :-1]).any(axis=2, keepdims=True)
    columns = (square[:, 1:] & square[:, :-1]).any(axis=1, keepdims=True)
    return np.asarray(rows | columns).reshape(out.shape)


def write_squares(readings: Array, light: Array, noise: ReadingNoise, squares: Array) -> None:
    """Write by how many standard deviations detectors are off, squared, in all images."""
    squares[:] = 0.0
    for j in range(len(light)):
        off = readings[j] - min(max(light[j], noise.low), noise.high)
        squares[j % len(squares)] += off * off / reading_variance(light[j], noise)


def weigh(squares: Array, heat: float, weights: Array) -> tuple[float, float]:
    """Write the weights of detectors, with a variance `heat` times as large.

    - returned: largest change of a weight, and what the weights add to the cost of the readings.
    """
    detectors, change, cost = len(squares), 0.0, 0.0
    doubted = DISBELIEVED + EACH_LAMP * (len(weights) // detectors - 1)
    for d in range(detectors):
        weight = 1 / (1 + np.exp(min(0.5 * squares[d] / heat - doubted, 500.0)))
        change = max(change, abs(weight - weights[d]))
        weights[d::detectors] = weight
        cost += doubted * (1 - weight) + weight * np.log(weight)
        if weight < 1:
            cost += (1 - weight) * np.log(1 - weight)
    return change, cost


def log_faulty(
    readings: Array, light: Array, noise: ReadingNoise, weights: Array, lamps: int
) -> float:
    """Return the logarithm of the probability of readings that are not believed, as faults."""
    log, faulty, dimmest = 0.0, FAULTY ** (1 / lamps), 3 * np.sqrt(noise.variance)
    for j in range(len(light)):
        doubt, reading = 1 - weights[j], readings[j]
        if noise.low < reading < noise.high:
            # Half are dimmed, to any share of the light, and half brighter, ever more rarely.
            own = max(light[j] - noise.black, dimmest)
            brighter = max(reading - noise.black, own)
            # The cost of readings leaves out what the variance adds where that does not grow.
            variance = 1.0 if grows(noise) else reading_variance(light[j], noise)
            density = 0.5 * own / (brighter * brighter)
            log += doubt * (np.log(faulty * density) + 0.5 * np.log(2 * np.pi * variance))
        else:
            log += doubt * np.log(faulty * AT_LIMIT)
    return log


def write_unlike(guide: Guide, row: int, sight: Array, squares: Array) -> None:
    """Write how much an image and that of a pose differ, by the guide's detectors."""
    squares[:], readings, roots = 0.0, guide.readings, guide.roots
    for j in range(len(readings)):
        off = roots[j, row] - sight[readings[j]]
        squares[j % len(squares)] += off * off


def heat_of(squares: Array) -> float:
    """Return the factor of the variance that makes most residuals usual ones."""
    ordered, middle = squares.copy(), len(squares) // 2
    partition(ordered, middle)
    return max(ordered[middle], 1.0)


def fit_believed(problem: Problem, at: Array, squares: Array) -> tuple[float, Array]:
    """Fit readings from a place with weights by their residuals, which are written.

    - squares: workspace, one for each detector.
    - returned: cost in all, and where that is.
    """
    readings, weights, noise = problem.readings, problem.weights, problem.noise
    write_squares(readings, light_at(problem, at), noise, squares)
    heat, total = heat_of(squares), np.inf
    for _ in range(TURNS):
        change, added = weigh(squares, heat, weights)
        state = refine(problem, at, STEPS)
        at, total = state.at, state.cost + added
        write_squares(readings, light_at(problem, at), noise, squares)
        if heat == 1 and change < SETTLED:
            break
        heat = max(min(COOLER * heat, heat_of(squares)), 1.0)
    return total, at


def out_of(weights: Array, detectors: int) -> int:
    """Count the detectors that are not believed."""
    count = 0
    for d in range(detectors):
        if weights[d] < 0.5:
            count += 1
    return count


def disbelieve(problem: Problem, guide: Guide) -> tuple[Array, float]:
    """Write the weights of readings where one pose explains most of them, by the best of starts.

    - problem: with readings and weights of its own; what is not believed is made that of the pose.
    - guide: where fits may start.
    - returned: where the fit is, and logarithm of the probability of what is not believed.
    """
    weights, readings, noise = problem.weights, problem.readings, problem.noise
    lamps, sight = problem.optics.lamps.shape[1], roots_of(readings)
    detectors = len(readings) // lamps
    seen, squares = np.empty(guide.side * guide.side), np.empty(detectors)
    most, distances = max(detectors // (LIT_EACH + 1), 1), np.zeros(guide.units.shape[1])
    believed = len(seen) - max(len(seen) // (LIT_EACH + 1), 1)
    for row in range(len(distances)):
        write_unlike(guide, row, sight, seen)
        partition(seen, believed)
        for j in range(believed):
            distances[row] += seen[j]
    rows, _ = least_of(distances, STARTS)
    least, best = np.inf, weights.copy()
    at = start_at(problem, guide.poses[0])
    for row in rows:
        weights[:] = 1.0
        cost, there = fit_believed(problem, start_at(problem, guide.poses[row]), squares)
        if cost < least and out_of(weights, detectors) <= most:
            least, best, at = cost, weights.copy(), there
    # Where a detector is dark, another pose may have turned it away: is it dead instead?
    dark = 3 * np.sqrt(noise.variance)
    for d in range(detectors):
        brightest = 0.0
        for j in range(d, len(readings), detectors):
            brightest = max(brightest, readings[j])
        if best[d] < 0.5 or brightest > dark:
            continue
        for j in range(len(weights)):
            weights[j] = best[j] if j % detectors != d else 0.0
        there = refine(problem, at, STEPS).at
        cost, there = fit_believed(problem, there, squares)
        if cost < least and out_of(weights, detectors) <= most:
            least, best, at = cost, weights.copy(), there
    light = light_at(problem, at)
    for j in range(len(weights)):
        weights[j] = best[j]
    log = log_faulty(readings, light, noise, weights, lamps)
    for j in range(len(weights)):
        if weights[j] < 0.5:
            readings[j] = min(max(light[j], noise.low), noise.high)
    return at, log
