"""One frame of ``least_squares``: from readings and their signature to pose and covariance.

Starts from the rows of a table that look alike, the minima that they lead to, the integral of the
posterior about the best: all in one call, which compiled code does not leave.
"""

from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.elementwise import borrowed
from uuv_optical_array.core.numerics.gauss_newton import first_damping
from uuv_optical_array.core.numerics.linear_algebra import cholesky, solve_lower
from uuv_optical_array.estimation.information.linearised import write_linear
from uuv_optical_array.estimation.least_squares.attitude_nodes import new_lattice
from uuv_optical_array.estimation.least_squares.faults import disbelieve
from uuv_optical_array.estimation.least_squares.posterior import (
    PosteriorMoments,
    integrate,
    laplace,
)
from uuv_optical_array.estimation.least_squares.problem import (
    FEW_STEPS,
    MOST_STEPS,
    Problem,
    State,
    evaluate,
    lit,
    misfit,
    propose,
    refine,
    settle,
    start_at,
    step,
)
from uuv_optical_array.estimation.least_squares.starts import (
    Guide,
    direction,
    nearest_rows,
    rows_alike,
)
from uuv_optical_array.estimation.least_squares.thinned import thinned
from uuv_optical_array.estimation.unknowns.coordinates import to_lamp

# Fewer lit detectors than these fit many poses, and this many starts are tried for them.
FEW_LIT, MOST_STARTS = 13, 64
# Fits closer together than this, in standard deviations, are in one minimum.
DISTINCT = 3.0
# Minima that are this much less probable, as a logarithm, are negligible.
NEGLIGIBLE = 12.0
# Minima up to this much less likely are covered to `DISTINCT`, however small their evidence.
RIVAL = 6.0
# Steps after which the damping restarts: the first ones, from far away, may damp too much.
LONG_STEPS = 2
# Near the lamp valleys are long and bent: so many minima of few lit detectors are followed to their
# end, in more steps.
FOLLOWED = 16

FITTED, NO_START, MISFIT, NO_COVARIANCE = range(4)
# How a frame is estimated: from the guide's starts, with all readings or with weights by their
# residuals; or by one linear step; or only linearised.
BELIEVED, DOUBTED, ONE_STEP, LINEARISED = range(4)
NOWHERE: Array = np.empty(0)
NOTHING: Array = np.empty((0, 0))


class FrameResult(NamedTuple):
    """What a frame led to.

    - outcome: `FITTED`, or why there is no pose.
    - pose, covariance: m and rad, shapes ``(5,)`` and ``(5, 5)``.
    - score, runner_up_score: `problem.misfit` of the two best minima; nan: there is none.
    - best: pose and nuisances of the best minimum, shape ``(p,)``.
    - log_evidence: of likelihood times prior, integrated, less what all kinds have in common.
    - linear_log_evidence: the same by Laplace's approximation about the best minimum.
    - coordinates: of `best`, shape ``(5,)``.
    - runner_up: pose of the next minimum; nan where there is none.
    - angle, runner_up_angle: spectral angles to the two nearest rows, rad.
    - weights: of the readings, shape ``(n,)``.
    - wider: whether the covariance had to be wider to cover a minimum about as likely as the best.
    """

    outcome: int
    pose: Array
    covariance: Array
    score: float
    runner_up: Array
    runner_up_score: float
    angle: float
    runner_up_angle: float
    best: Array
    log_evidence: float
    linear_log_evidence: float
    coordinates: Array
    weights: Array
    wider: bool = False


def is_near(at: Array, known: State) -> bool:
    """Say whether coordinates are within `DISTINCT` standard deviations of a minimum."""
    distance = 0.0
    for i in range(len(at)):
        shared = 0.0
        for j in range(len(at)):
            shared += known.information[i, j] * (at[j] - known.at[j])
        distance += (at[i] - known.at[i]) * shared
    return bool(distance < DISTINCT * DISTINCT)


def insert(minima: list[State], state: State) -> None:
    """Put a fit among the minima, best first, each once."""
    if not np.isfinite(state.cost):
        return
    for i in range(len(minima)):
        if is_near(state.at, minima[i]):
            if state.cost < minima[i].cost:
                minima[i] = state
            break
    else:
        minima.append(state)
    for i in range(len(minima) - 1, 0, -1):
        if minima[i].cost < minima[i - 1].cost:
            minima[i], minima[i - 1] = minima[i - 1], minima[i]


def descend(problem: Problem, minima: list[State], start: Array, steps: int) -> None:
    """Refine coordinates, unless they lead to one of the minima from above."""
    state = evaluate(problem, start)
    damping = first_damping(state)
    for k in range(steps):
        if k == LONG_STEPS:
            damping = first_damping(state)
        if damping == 0:
            break
        proposed = propose(problem, state, damping)
        for known in minima:
            if known.cost <= state.cost and is_near(proposed[0], known):
                return
        state, damping = step(problem, state, proposed, damping)
    insert(minima, state)


def find_minima(problem: Problem, guide: Guide, unit: Array, nearest: Any) -> list[State]:
    """Return the minima, best first.

    Those of a large array are found by few of its detectors, and refined by all.

    - unit, nearest: direction of the image, and the rows nearest to it, as many as candidates.
    """
    if len(guide.readings) == len(problem.readings):
        return search(problem, guide, unit, nearest)
    found = search_few(thinned(problem, guide.readings, guide.blur), guide, unit, nearest)
    minima = found[:0]
    for state in found:
        if state.cost - found[0].cost < NEGLIGIBLE:
            insert(minima, settle(problem, state.at))
    return minima


def minimum_from(problem: Problem, start: Array) -> list[State]:
    """Return the minimum that one start leads to, as `find_minima` does."""
    minima = [refine(problem, start, MOST_STEPS)]
    if not np.isfinite(minima[0].cost):
        minima.clear()
    return minima


def search_few(given: Problem, guide: Guide, unit: Array, nearest: Any) -> list[State]:
    """Return the minima that `search` finds by readings that the problem alone holds."""
    return search(borrowed(given), guide, unit, nearest)


def search(problem: Problem, guide: Guide, unit: Array, nearest: Any) -> list[State]:
    """Return what `find_minima` does, by the readings that the guide is of."""
    few = not guide.gaussian and lit(problem.readings, problem) < FEW_LIT
    rows, count, steps = nearest, guide.candidates, MOST_STEPS
    if few:
        count, steps = min(MOST_STARTS, guide.units.shape[1]), FEW_STEPS
        rows = rows_alike(problem.readings, guide, unit, count)
    minima = minimum_from(problem, start_at(problem, guide.poses[rows[0]]))
    for i in range(1, count):
        descend(problem, minima, start_at(problem, guide.poses[rows[i]]), steps)
    if not few:
        return minima
    found, minima = minima[:FOLLOWED], minima[:0]
    for state in found:
        insert(minima, refine(problem, state.at, MOST_STEPS))
    return minima


def score_of(problem: Problem, minima: list[State]) -> float:
    """Return the misfit of the best of minima; inf where there is none."""
    return misfit(problem, minima[0].at) if len(minima) > 0 else np.inf


def posterior_about(problem: Problem, minima: list[State]) -> PosteriorMoments:
    """Return the moments of the posterior that is connected with the best minimum that has any."""
    lattice = new_lattice(len(minima[0].at))
    moments = integrate(problem, minima[0], lattice)
    for i in range(1, len(minima)):
        if not np.isfinite(moments.log_weight):
            moments = integrate(problem, minima[i], lattice)
    return moments


def cover(minima: list[State], pose: Array, covariance: Array) -> bool:
    """Widen a covariance to cover minima about as likely as the best; returns whether it had to."""
    wider = False
    for state in minima:
        off = state.pose - pose
        factor, weighed = covariance.copy(), off.copy()
        if state.cost - minima[0].cost > RIVAL or not cholesky(factor):
            continue
        solve_lower(factor, weighed)
        square = 0.0
        for i in range(5):
            square += weighed[i] * weighed[i]
        excess = 1 / DISTINCT**2 - 1 / max(square, 1e-9)
        if excess > 0:
            wider = True
            for i in range(5):
                for j in range(5):
                    covariance[i, j] += excess * (off[i] * off[j])
    return wider


def estimate_frame(
    given: Problem, to_start: Guide, way: int, place: Array, linear: Array
) -> FrameResult | None:
    """Estimate the pose of one image, or linearise it: together they are compiled in less time.

    - given: the posterior of the image.
    - to_start: where to start.
    - way: `BELIEVED`; `DOUBTED`: readings may be faulty, and those of the problem and the weights
      are written; `ONE_STEP`: what one linear step from a place leads to, by its Gaussian;
      `LINEARISED`: nothing, but `write_linear` writes.
    - place: coordinates and nuisances, or pose and nuisances, shape ``(p,)``, or `NOWHERE`.
    - linear: what is written, shape ``(4 + p, n)``, or `NOTHING`.
    """
    problem, guide = borrowed(given), borrowed(to_start)
    if way == LINEARISED:
        write_linear(problem.optics, problem.noise, problem.readings, place, problem.roll, linear)
        return None
    if way == ONE_STEP:
        return one_step(problem, place, given.weights)
    unknown = np.full((5, 5 + len(problem.nuisance_mean)), np.nan)
    nothing, covariance, at = unknown[0, :5].copy(), unknown[:, :5].copy(), unknown[0].copy()
    coordinates: Any = nothing
    outcome, pose, evidence, by_laplace, log_faulty = NO_START, nothing, -np.inf, -np.inf, 0.0
    runner_up, runner_up_score, wider = nothing, np.nan, False
    there: Any = at
    if way == DOUBTED:
        there, log_faulty = disbelieve(problem, guide)
    unit = direction(problem.readings, guide)
    nearest, chords = nearest_rows(guide.units, unit, max(guide.candidates, 2))
    angle = 2 * np.arcsin(min(0.5 * chords[0], 1.0))
    second_angle = 2 * np.arcsin(min(0.5 * chords[1], 1.0))
    if way == DOUBTED:
        minima = minimum_from(problem, there)
    else:
        minima = find_minima(problem, guide, unit, nearest)
    score = score_of(problem, minima)
    if len(minima) > 0:
        for i in range(len(at)):
            at[i] = minima[0].pose[i] if i < 5 else minima[0].at[i]
        coordinates = minima[0].at[:5].copy()
        outcome = MISFIT
        if score <= guide.max_score:
            outcome = FITTED
            moments, density = laplace(minima[0]), log_density(problem.nuisance_std)
            by_laplace = moments.log_weight + density
            if not guide.gaussian:
                moments = posterior_about(problem, minima)
            pose, evidence = moments.mean, moments.log_weight + density + log_faulty
            covariance = moments.covariance
            wider = cover(minima, pose, covariance)
            if not np.isfinite(evidence) or not cholesky(covariance.copy()):
                outcome = NO_COVARIANCE
            if len(minima) > 1:
                runner_up = minima[1].pose
                runner_up_score = misfit(problem, minima[1].at)
    return FrameResult(
        outcome,
        pose,
        covariance,
        score,
        runner_up,
        runner_up_score,
        angle,
        second_angle,
        at,
        evidence,
        by_laplace,
        coordinates,
        given.weights,
        wider,
    )


def one_step(problem: Problem, at: Array, weights: Array) -> FrameResult:
    """Return the Gaussian that one linear step from a place, ``(p,)``, leads to, as a frame."""
    state = evaluate(problem, at)
    there, decrement = propose(problem, state, 0.0)
    moments = laplace(state)
    _, pose, _ = to_lamp(problem.frame, there, problem.roll)
    best, mean = there.copy(), np.empty(5)
    for i in range(5):
        best[i] = mean[i] = pose[i]
    log_evidence = moments.log_weight + decrement + log_density(problem.nuisance_std)
    return FrameResult(
        FITTED,
        mean,
        moments.covariance,
        np.nan,
        np.full(5, np.nan),
        np.nan,
        np.nan,
        np.nan,
        best,
        log_evidence,
        log_evidence,
        there[:5].copy(),
        weights,
        False,
    )


def log_density(stds: Array) -> float:
    """Return the logarithm of the density of the nuisances' prior at its mean, without 2 pi."""
    log = 0.0
    for std in stds:
        log -= np.log(std)
    return log
