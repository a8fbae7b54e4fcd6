"""One frame of ``least_squares``: from readings and their signature to pose and covariance.

`estimate_frame` is all of it in one call, or of a large array in two, which compiled code does not
leave: it starts from poses whose images look alike, finds the minima of the cost that they lead to,
and integrates the posterior about the best one.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

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
from uuv_optical_array.estimation.unknowns.coordinates import from_pose, to_lamp

# Fewer lit detectors than these fit many poses, and this many starts are tried for them.
FEW_LIT, MOST_STARTS = 13, 64
# Fits closer together than this, in standard deviations, are in one minimum.
DISTINCT = 3.0
# Minima that are this much less probable, as a logarithm, are negligible.
NEGLIGIBLE = 12.0
# The covariance covers minima up to this much less likely, to `DISTINCT` standard deviations.
RIVAL = 6.0
# Steps after which the damping restarts: the first ones, from far away, may damp too much.
LONG_STEPS = 2
# Near the lamp valleys are long and bent: so many minima of few lit detectors are followed to their
# end, in more steps.
FOLLOWED = 16

FITTED, NO_START, MISFIT, NO_COVARIANCE = range(4)
# How a frame is estimated: with all readings, or with weights by their residuals; or by one linear
# step; or only linearised; or, of a large array, searched by few detectors and settled by all.
BELIEVED, DOUBTED, ONE_STEP, LINEARISED, SEARCHED, SETTLED = range(6)
NOWHERE: Array = np.empty(0)
# Outcome, scores of best and next minimum, evidence, that by Laplace, whether wider.
Numbers: TypeAlias = tuple[int, float, float, float, float, bool]
# Rows of what a frame writes, after the five of the covariance.
POSE_ROW, RUNNER_UP_ROW, BEST_ROW, ANGLES_ROW = range(5, 9)


class FrameResult(NamedTuple):
    """What a frame led to.

    - outcome: `FITTED`, or why there is no pose.
    - pose, covariance: m and rad, shapes ``(5,)`` and ``(5, 5)``.
    - score, runner_up_score: `problem.misfit` of the two best minima; nan: there is none.
    - best: pose and nuisances of the best minimum, shape ``(p,)``.
    - log_evidence: of likelihood times prior, integrated, less what all kinds have in common.
    - linear_log_evidence: the same by Laplace's approximation about the best minimum.
    - runner_up: pose of the next minimum; nan where there is none.
    - angles: spectral angles to the two nearest rows, nearest first, rad.
    - weights: of the readings, shape ``(n,)``.
    - wider: whether the covariance was widened to cover a minimum about as likely as the best.
    """

    outcome: int
    pose: Array
    covariance: Array
    score: float
    runner_up: Array
    runner_up_score: float
    angles: Array
    best: Array
    log_evidence: float
    linear_log_evidence: float
    weights: Array
    wider: bool


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
        known = minima[i]
        if is_near(state.at, known):
            if state.cost < known.cost:
                minima[i] = state
            break
    else:
        minima.append(state)
    for i in range(len(minima) - 1, 0, -1):
        one, other = minima[i - 1], minima[i]
        if other.cost < one.cost:
            minima[i - 1], minima[i] = other, one


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


def minimum_from(problem: Problem, start: Array) -> list[State]:
    """Return the minimum that coordinates and nuisances lead to; none where there is none."""
    minima = [refine(problem, start, MOST_STEPS)]
    if not np.isfinite(minima[0].cost):
        minima.clear()
    return minima


def settled(problem: Problem, places: Array) -> list[State]:
    """Return the minima near places, coordinates and nuisances, shape ``(k, p)``, best first."""
    found = [settle(problem, places[k]) for k in range(len(places))]
    minima = found[:0]
    for state in found:
        insert(minima, state)
    return minima


def search(problem: Problem, starts: Array, few: bool) -> list[State]:
    """Return the minima that poses lead to, best first.

    - starts: poses of level followers, shape ``(k, 5)``.
    - few: whether few detectors are lit.
    """
    steps = FEW_STEPS if few else MOST_STEPS
    minima = minimum_from(problem, start_at(problem, starts[0]))
    for i in range(1, len(starts)):
        descend(problem, minima, start_at(problem, starts[i]), steps)
    if not few:
        return minima
    found, minima = minima[:FOLLOWED], minima[:0]
    for state in found:
        state = refine(problem, state.at, MOST_STEPS)
        insert(minima, settle(problem, state.at))
    return minima


def posterior_about(problem: Problem, minima: list[State]) -> PosteriorMoments:
    """Return the moments of the posterior that is connected with the best minimum that has any."""
    lattice = new_lattice(5 + len(problem.nuisance_mean))
    for state in minima:
        moments = integrate(problem, state, borrowed(lattice))
        if np.isfinite(moments.log_weight):
            break
    return moments


def cover(minima: list[State], pose: Array, covariance: Array) -> bool:
    """Widen a covariance to cover minima about as likely as the best; True if it was widened."""
    wider = False
    for state in minima:
        factor, off, weighed = covariance.copy(), np.empty(5), np.empty(5)
        for i in range(5):
            off[i] = weighed[i] = state.pose[i] - pose[i]
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
    given: Problem, to_start: Guide, way: int, place: Array, written: Array
) -> Numbers:
    """Estimate the pose of one image, or linearise it: together they are compiled in less time.

    Arrays are written, and none is returned: Numba returns an array by way of Python code, in which
    Ctrl-C ends the process.

    - given: the posterior of the image.
    - to_start: where to start.
    - way: `BELIEVED`; `DOUBTED`: readings may be faulty, and those of the problem and the weights
      are written; `ONE_STEP`: what one linear step from a place leads to, by its Gaussian;
      `LINEARISED`: what `write_linear` writes, and nothing else; `SEARCHED`: where the minima are,
      and nothing else; `SETTLED`: from near these.
    - place: pose and nuisances, shape ``(p,)``; of `BELIEVED` and `SEARCHED` the pose of a level
      follower alone to start from, ``(5,)``, or `NOWHERE`: where the guide says; of `SETTLED`
      coordinates and nuisances of all places, one after the other.
    - written: shape ``(4 + p, n)`` of `LINEARISED`, ``(MOST_STARTS, p)`` of `SEARCHED`, else
      `new_rows`, which `frame_result` names.
    """
    problem, guide = borrowed(given), borrowed(to_start)
    if way == LINEARISED:
        write_linear(problem.optics, problem.noise, problem.readings, place, problem.roll, written)
        return NO_START, np.nan, np.nan, np.nan, np.nan, False
    if way == ONE_STEP:
        return one_step(problem, place, written)
    start, log_faulty = place, 0.0
    if way == DOUBTED:
        start, log_faulty = disbelieve(problem, guide)
    unit = direction(problem.readings, guide)
    rows, chords = nearest_rows(guide.units, unit, max(guide.candidates, 2))
    if way == DOUBTED:
        minima = minimum_from(problem, start)
    elif way == SETTLED:
        minima = settled(problem, place.reshape(-1, 5 + len(problem.nuisance_mean)))
    else:
        kept = problem.readings[guide.readings]
        few = not guide.gaussian and lit(kept, problem) < FEW_LIT
        starts = guide.poses[rows[: guide.candidates]]
        if len(place) > 0:
            starts = place.reshape(1, 5)
        elif few:
            starts = guide.poses[rows_alike(kept, guide, unit, MOST_STARTS)]
        minima = search(problem, starts, few)
    if way == SEARCHED:
        for i in range(len(minima)):
            state = minima[i]
            if state.cost - minima[0].cost < NEGLIGIBLE:
                write(state.at, written[i])
        return NO_START, np.nan, np.nan, np.nan, np.nan, False
    for i in range(2):
        written[ANGLES_ROW, i] = 2 * np.arcsin(min(0.5 * chords[i], 1.0))
    return result_of(problem, guide, minima, log_faulty, written)


def write(values: Any, row: Array) -> None:
    """Write values to the first places of a row.

    Numba compiles ``row[:5] = values`` with all that it takes to name two shapes that differ.
    """
    for i in range(len(values)):
        row[i] = values[i]


def new_rows(problem: Problem) -> Array:
    """Return the rows that `estimate_frame` writes what it finds to; nan: there is none."""
    return np.full((ANGLES_ROW + 1, 5 + len(problem.nuisance_mean)), np.nan)


def frame_result(
    fit_frame: Callable[..., Any], problem: Problem, guide: Guide, way: int, place: Array
) -> FrameResult:
    """Return what `estimate_frame`, compiled or not, leads to as of `BELIEVED` to `ONE_STEP`.

    A large array is searched by few of its detectors, and what is found refined by all.
    """
    written = new_rows(problem)
    if way == BELIEVED and len(guide.readings) < len(problem.readings):
        few = thinned(problem, guide.readings, guide.blur)
        of_few = guide._replace(readings=np.arange(len(guide.readings)))
        found = np.full((MOST_STARTS, written.shape[1]), np.nan)
        fit_frame(few, of_few, SEARCHED, place, found)
        way, place = SETTLED, found[np.isfinite(found[:, 0])].reshape(-1)
    numbers = fit_frame(problem, guide, way, place, written)
    outcome, score, runner_up_score, log_evidence, linear_log_evidence, wider = numbers
    return FrameResult(
        outcome=outcome,
        pose=written[POSE_ROW, :5],
        covariance=written[:5, :5],
        score=score,
        runner_up=written[RUNNER_UP_ROW, :5],
        runner_up_score=runner_up_score,
        angles=written[ANGLES_ROW, :2],
        best=written[BEST_ROW],
        log_evidence=log_evidence,
        linear_log_evidence=linear_log_evidence,
        weights=problem.weights,
        wider=wider,
    )


def result_of(
    problem: Problem, guide: Guide, minima: list[State], log_faulty: float, written: Array
) -> Numbers:
    """Write and return what the minima of a frame's cost, best first, leave of the pose.

    - log_faulty: logarithm of the probability of what the weights leave out.
    """
    score, outcome, runner_up_score = np.inf, NO_START, np.nan
    evidence, by_laplace, wider = -np.inf, -np.inf, False
    if len(minima) > 0:
        best = minima[0]
        write(best.at, written[BEST_ROW])
        write(best.pose, written[BEST_ROW])
        score, outcome = misfit(problem, best.at), MISFIT
    if score <= guide.max_score:
        moments, density = laplace(minima[0]), log_density(problem.nuisance_std)
        by_laplace = moments.log_weight + density
        if not guide.gaussian:
            moments = posterior_about(problem, minima)
        evidence, covariance = moments.log_weight + density + log_faulty, moments.covariance
        wider = cover(minima, moments.mean, covariance)
        write(moments.mean, written[POSE_ROW])
        for i in range(5):
            write(covariance[i], written[i])
        sound = np.isfinite(evidence) and cholesky(covariance.copy())
        outcome = FITTED if sound else NO_COVARIANCE
        if len(minima) > 1:
            runner_up = minima[1]
            write(runner_up.pose, written[RUNNER_UP_ROW])
            runner_up_score = misfit(problem, runner_up.at)
    return outcome, score, runner_up_score, evidence, by_laplace, wider


def one_step(problem: Problem, place: Array, written: Array) -> Numbers:
    """Write and return the Gaussian that one linear step from pose and nuisances leads to."""
    at, given = place.copy(), (place[0], place[1], place[2], place[3], place[4])
    write(from_pose(problem.frame, given, problem.roll), at)
    state = evaluate(problem, at)
    best, decrement = propose(problem, state, 0.0)
    moments = laplace(state)
    _, pose, _ = to_lamp(problem.frame, best, problem.roll)
    log_evidence = moments.log_weight + decrement + log_density(problem.nuisance_std)
    write(best, written[BEST_ROW])
    for i in range(5):
        written[POSE_ROW, i] = written[BEST_ROW, i] = pose[i]
        write(moments.covariance[i], written[i])
    return FITTED, np.nan, np.nan, log_evidence, log_evidence, False


def log_density(stds: Array) -> float:
    """Return the logarithm of the density of the nuisances' prior at its mean, without 2 pi."""
    log = 0.0
    for std in stds:
        log -= np.log(std)
    return log
