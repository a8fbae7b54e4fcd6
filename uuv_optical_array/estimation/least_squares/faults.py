"""Faulty detectors: readings that no pose explains, while one pose explains all others.

They are found by least trimmed squares (P. Rousseeuw, 1984, J. Am. Stat. Assoc. 79, 871): from
poses whose images are alike but for a few readings, fits leave out those few that are farthest off,
until these stay the same. Then each is taken back with which the rest still fits.
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
TAKEN_BACK = 4.5  # cost of a reading, as of three standard deviations, up to which it is no fault
WELL = 0.84  # score of a fit from which the readings that are left out may be the wrong ones


def most_faulty(problem: Problem) -> int:
    """Return how many readings of an image may be left out; they may be the brightest."""
    readings = np.sort(problem.readings)
    for count in range(MOST_FAULTY, 0, -1):
        others = problem._replace(readings=readings[:-count])
        full = np.count_nonzero(others.readings >= problem.noise.high)
        if lit(others) + 2 * full >= LIT_EACH * count:
            return count
    return 0


def log_odds(problem: Problem, light: Any) -> Any:
    """Return by how much a fault is more probable than light that the reading hits exactly."""
    full = min(problem.noise.high, 2 * problem.readings.max() + 1)
    return np.log(FAULTY / full * np.sqrt(2 * np.pi * reading_variance(light, problem.noise)))


def grows(noise: ReadingNoise) -> bool:
    """Say whether the log-likelihood of a reading has a share of its variance."""
    return noise.slope > 0 or noise.square > 0


def trim(squares: Array, count: int, weights: Array) -> bool:
    """Give the largest of squares no weight; returns whether that changes anything."""
    before = weights.copy()
    weights.fill(1.0)
    for _ in range(count):
        weights[(squares * weights).argmax()] = 0.0
    return bool((before != weights).any())


def write_squares(problem: Problem, at: Array, squares: Array) -> Array:
    """Write by how many standard deviations readings are off, squared; returns the light."""
    light, noise = light_at(problem, at), problem.noise
    for j in range(len(light)):
        expected = min(max(light[j], noise.low), noise.high)
        squares[j] = (problem.readings[j] - expected) ** 2 / reading_variance(light[j], noise)
    return light


def leave_out(problem: Problem, poses: Array, roots: Array, count: int) -> bool:
    """Give readings that no pose explains no weight, and the light of the pose of the others.

    - problem: with readings and weights of its own, which are written.
    - poses, roots: where fits may start, as `frame.Guide` has them.
    - count: how many detectors may be faulty, > 0.
    - returned: whether there is such a reading.
    """
    weights, readings, noise = problem.weights, problem.readings, problem.noise
    squares, sight = weights.copy(), np.sqrt(np.maximum(readings, 0.0))
    distances = np.empty(min(len(poses), ROWS))
    for row in range(len(distances)):
        for j in range(len(readings)):
            squares[j] = (roots[j, row] - sight[j]) ** 2
        trim(squares, count, weights)
        distances[row] = (squares * weights).sum()
    least, at, best = np.inf, start_at(problem, poses[0]), weights.copy()
    there = at
    for _ in range(STARTS):
        row = int(distances.argmin())
        distances[row] = np.inf
        trim((roots[:, row] - sight) ** 2, count, weights)
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
    # A reading that bends the fit is not far off, and another one in its place.
    for place in np.flatnonzero(best == 0):
        if misfit(problem, at).score < WELL:
            break
        swapped, weights[place] = place, 1.0
        for j in range(len(readings)):
            if best[j] > 0:
                weights[j] = 0.0
                state = refine(problem, at, MOST_STEPS)
                if state.cost < least:
                    least, there, swapped = state.cost, state.parts[AT].copy(), j
                weights[j] = 1.0
        weights[swapped] = 0.0
        if swapped != place:
            at, best = there, weights.copy()
    for _ in range(count):
        light = write_squares(problem, at, squares)
        j, nearest = 0, np.inf
        for k in range(len(readings)):
            if weights[k] == 0 and squares[k] < nearest:
                j, nearest = k, squares[k]
        weights[j] = 1.0
        state = refine(problem, at, MOST_STEPS)
        worse = state.cost - least
        if grows(noise):
            worse -= 0.5 * np.log(reading_variance(light[j], noise))
        if worse > TAKEN_BACK:
            weights[j] = 0.0
            break
        least, at = state.cost, state.parts[AT].copy()
    light = light_at(problem, at)
    for j in range(len(readings)):
        if weights[j] == 0:
            readings[j] = min(max(light[j], noise.low), noise.high)
    return bool((weights == 0).any())


def log_evidence(problem: Problem) -> float:
    """Return the logarithm of the probability of the readings that are left out, as faults.

    As `FrameResult.log_evidence` has it, without the constants of the readings.
    """
    out = problem.weights == 0
    odds = log_odds(problem, problem.readings[out])
    if grows(problem.noise):
        odds = odds - 0.5 * np.log(reading_variance(problem.readings[out], problem.noise))
    return float(np.sum(odds))
