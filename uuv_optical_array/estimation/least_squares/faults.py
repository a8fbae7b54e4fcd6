"""Faulty detectors: readings that no pose explains, while one pose explains all others.

They are found by least trimmed squares (P. Rousseeuw, 1984, J. Am. Stat. Assoc. 79, 871): from
poses whose images are alike but for a few readings, fits leave out the few farthest off, until
these stay the same. Then each is taken back with which the rest still fits. A faulty detector
is so in the images of all lamps.
"""

from typing import Any

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.problem import (
    AT,
    MOST_STEPS,
    Problem,
    light_at,
    lit,
    misfit,
    refine,
    start_at,
)
from uuv_optical_array.forward.optics import ReadingNoise, reading_variance

MOST_FAULTY = 3
LIT_EACH = 6  # clearly lit detectors beside each that may be left out, or the rest fits anything
# Probability that a detector is, in an image that does not fit: it reads anything to full scale.
FAULTY = 1e-2
STARTS, ROUNDS = 8, 5
ROWS = 1536  # poses whose images are compared
# Cost of a detector, as of three standard deviations, up to which it is no fault, and what each
# further lamp adds, as chi-squares of more degrees of freedom are about so much larger.
TAKEN_BACK, EACH_LAMP = 4.5, 1.25
WELL = 0.84  # score of a fit from which the readings that are left out may be the wrong ones


def lamps_of(problem: Problem) -> Any:
    """Return how many lamps an image is of."""
    return problem.optics.lamps.shape[1]


def most_faulty(problem: Problem) -> int:
    """Return how many detectors may be left out; they may be the brightest."""
    readings = np.sort(problem.readings.reshape(lamps_of(problem), -1).max(axis=0))
    for count in range(MOST_FAULTY, 0, -1):
        others = problem._replace(readings=readings[:-count])
        full = np.count_nonzero(others.readings >= problem.noise.high)
        if lit(others) + 2 * full >= LIT_EACH * count:
            return count
    return 0


def log_odds(problem: Problem, light: Any) -> Any:
    """Return by how much a fault is more probable than light that the reading hits exactly."""
    full = min(problem.noise.high, 2 * problem.readings.max() + 1)
    faulty = FAULTY ** (1 / lamps_of(problem))  # a detector is so in the images of all lamps
    return np.log(faulty / full * np.sqrt(2 * np.pi * reading_variance(light, problem.noise)))


def grows(noise: ReadingNoise) -> bool:
    """Say whether the log-likelihood of a reading has a share of its variance."""
    return noise.slope > 0 or noise.square > 0


def trim(squares: Array, count: int, weights: Array) -> bool:
    """Give the detectors of the largest squares no weight; returns whether that changes any."""
    before, detectors = weights.copy(), len(squares)
    weights.fill(1.0)
    for _ in range(count):
        weights[(squares * weights[:detectors]).argmax() :: detectors] = 0.0
    return bool((before != weights).any())


def write_unlike(roots: Array, row: int, sight: Array, squares: Array) -> None:
    """Write how unlike an image and that of a pose are, detector by detector."""
    squares.fill(0.0)
    for j in range(len(sight)):
        squares[j % len(squares)] += (roots[j, row] - sight[j]) ** 2


def write_squares(problem: Problem, at: Array, squares: Array) -> Array:
    """Write by how many standard deviations detectors are off, squared; returns the light."""
    light, noise = light_at(problem, at), problem.noise
    squares.fill(0.0)
    for j in range(len(light)):
        off = problem.readings[j] - min(max(light[j], noise.low), noise.high)
        squares[j % len(squares)] += off**2 / reading_variance(light[j], noise)
    return light


def leave_out(problem: Problem, poses: Array, roots: Array, count: int) -> bool:
    """Give detectors that no pose explains no weight, and the light of the pose of the others.

    - problem: with readings and weights of its own, which are written.
    - poses, roots: where fits may start, as `frame.Guide` has them.
    - returned: whether there is such a detector, of at most `count`, > 0.
    """
    weights, readings, noise = problem.weights, problem.readings, problem.noise
    lamps, sight = lamps_of(problem), np.sqrt(np.maximum(readings, 0.0))
    detectors = len(readings) // lamps
    squares, distances = np.zeros(detectors), np.empty(min(len(poses), ROWS))
    for row in range(len(distances)):
        write_unlike(roots, row, sight, squares)
        trim(squares, count, weights)
        distances[row] = (squares * weights[:detectors]).sum()
    least, at, best = np.inf, start_at(problem, poses[0]), weights.copy()
    there = at
    for _ in range(STARTS):
        row = int(distances.argmin())
        distances[row] = np.inf
        write_unlike(roots, row, sight, squares)
        trim(squares, count, weights)
        alike, there, cost = weights, start_at(problem, poses[row]), least
        for _ in range(ROUNDS):
            alike = weights.copy()
            state = refine(problem, there, MOST_STEPS)
            there, cost = state.parts[AT].copy(), state.cost
            write_squares(problem, there, squares)
            if not trim(squares, count, weights):
                break
        if cost < least:
            least, at, best = cost, there, alike
    for j in range(len(readings)):
        weights[j] = best[j]
    # A detector that bends the fit is not far off, and another one in its place.
    suspects = best
    for place in range(detectors):
        if suspects[place] > 0:
            continue
        if misfit(problem, at).score < WELL:
            break
        swapped = place
        weights[place::detectors] = 1.0
        for j in range(detectors):
            if best[j] > 0:
                weights[j::detectors] = 0.0
                state = refine(problem, at, MOST_STEPS)
                if state.cost < least:
                    least, there, swapped = state.cost, state.parts[AT].copy(), j
                weights[j::detectors] = 1.0
        weights[swapped::detectors] = 0.0
        if swapped != place:
            at, best = there, weights.copy()
    for _ in range(count):
        light = write_squares(problem, at, squares)
        j, nearest = 0, np.inf
        for k in range(detectors):
            if weights[k] == 0 and squares[k] < nearest:
                j, nearest = k, squares[k]
        weights[j::detectors] = 1.0
        state = refine(problem, at, MOST_STEPS)
        worse = state.cost - least
        if grows(noise):
            for k in range(j, len(light), detectors):
                worse -= 0.5 * np.log(reading_variance(light[k], noise))
        if worse > TAKEN_BACK + EACH_LAMP * (lamps - 1):
            weights[j::detectors] = 0.0
            break
        least, at = state.cost, state.parts[AT].copy()
    light = light_at(problem, at)
    for j in range(len(readings)):
        if weights[j] == 0:
            readings[j] = min(max(light[j], noise.low), noise.high)
    return bool((weights == 0).any())


def log_evidence(problem: Problem) -> float:
    """Return the logarithm of the probability of the readings that are left out, as faults."""
    out = problem.weights == 0
    odds = log_odds(problem, problem.readings[out])
    if grows(problem.noise):
        odds = odds - 0.5 * np.log(reading_variance(problem.readings[out], problem.noise))
    return float(np.sum(odds))
