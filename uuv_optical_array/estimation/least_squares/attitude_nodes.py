"""The posterior at one attitude, a node of the lattice of `posterior`.

Pitch and yaw are given there, and the other unknowns, three coordinates and the nuisances, are
nearly Gaussian: Laplace's approximation about their conditional mean integrates them. Of nodes in a
row, a direction of pitch and yaw across it belongs to the other unknowns.
"""

from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import PITCH, YAW, Array
from uuv_optical_array.core.numerics.elementwise import law, zeros
from uuv_optical_array.core.numerics.linear_algebra import cholesky, solve_lower, solve_upper
from uuv_optical_array.estimation.least_squares.problem import (
    MAX_STEP,
    VOLUME,
    Problem,
    State,
    evaluate,
    longest_step,
    propose,
)
from uuv_optical_array.estimation.unknowns.coordinates import to_lamp

MOST_NODES = 400  # of a lattice
# Decrement that may be left at a node; Laplace's approximation takes it into account.
SETTLED = 0.3
UNSETTLED = 3.0  # decrement at a node beyond which the approximation is not valid
CORRECTIONS = 12  # most steps of the other unknowns at a node


class Lattice(NamedTuple):
    """The posterior at m attitudes, the other unknowns integrated.

    - logs: logarithm of the attitude's density, without constants, ``(m,)``; -inf: no node.
    - ats: coordinates and nuisances of the conditional mean, shape ``(m, p)``.
    - moved: slopes of `ats` by pitch and yaw, shape ``(m, 2, p)``.
    - slopes: of `logs` by pitch and yaw, shape ``(m, 2)``.
    - curvatures: their negative second derivatives, Gauss-Newton's: pitch, both, yaw, ``(m, 3)``.
    - poses, covariances: of the pose at the attitude, shapes ``(m, 5)`` and ``(m, 5, 5)``.
    - across: direction in pitch and yaw that belongs to all else, of length one, ``(2,)``; 0: none.
    """

    logs: Array
    ats: Array
    moved: Array
    slopes: Array
    curvatures: Array
    poses: Array
    covariances: Array
    across: Array


def new_lattice(size: int) -> Lattice:
    """Return a lattice without nodes, for p coordinates and nuisances."""
    return Lattice(
        np.full(MOST_NODES, -np.inf),
        np.empty((MOST_NODES, size)),
        np.empty((MOST_NODES, 2, size)),
        np.empty((MOST_NODES, 2)),
        np.empty((MOST_NODES, 3)),
        np.empty((MOST_NODES, 5)),
        np.empty((MOST_NODES, 5, 5)),
        np.zeros(2),
    )


@law
def is_row(lattice: Lattice) -> bool:
    """Say whether the nodes of a lattice are in a row, across which all else is integrated, too."""
    return bool(lattice.across[0] != 0 or lattice.across[1] != 0)


def write_start(lattice: Lattice, node: int, pitch: float, yaw: float, start: Array) -> None:
    """Predict coordinates and nuisances at an attitude so far from a node's, rad."""
    moved = lattice.moved[node]
    for i in range(len(start)):
        start[i] = lattice.ats[node, i] + (pitch * moved[0, i] + yaw * moved[1, i])


def write_node(problem: Problem, state: State, lattice: Lattice, node: int) -> None:
    """Integrate the other unknowns at the attitude of a state near their conditional mean."""
    decrement = integrate_rest(problem, state, lattice, node)
    damping = 0.0
    for _ in range(CORRECTIONS):
        if not decrement > SETTLED:
            break
        there = lattice.ats[node] if damping == 0 else rest_of_the_way(problem, state, damping)
        ahead = evaluate(problem, there)
        if ahead.cost - ahead.log_volume < state.cost - state.log_volume:
            state = ahead
            decrement = integrate_rest(problem, state, lattice, node)
            damping *= 0.1
        else:
            damping = max(10 * damping, 0.1)
    if decrement > UNSETTLED:
        lattice.logs[node] = -np.inf


def rest_of_the_way(problem: Problem, state: State, damping: float) -> Array:
    """Return where a damped step towards the conditional mean leads, shape ``(p,)``."""
    gradient, information = state.gradient.copy(), state.information.copy()
    for i in range(5):
        gradient[i] += state.slopes[VOLUME, i]
    for i in (PITCH, YAW):
        gradient[i] = 0.0
        for j in range(len(gradient)):
            information[i, j] = information[j, i] = 0.0
        information[i, i] = 1.0
    held = State(
        state.cost, state.at, gradient, information, state.pose, state.log_volume, state.slopes
    )
    there, _ = propose(problem, held, damping)
    return there


@law
def ordered(place: int, rest: int) -> int:
    """Return the coordinate at a place in the order with the attitude last."""
    if place >= rest:
        return place - rest + PITCH
    return place if place < PITCH else place + 2


def integrate_rest(problem: Problem, state: State, lattice: Lattice, node: int) -> float:
    """Integrate all but the attitude by Laplace's approximation about a state.

    Return the decrement: how much less the cost would be at the conditional mean.
    """
    size = len(state.at)
    rest, slopes = size - 2, state.slopes
    factor, vectors = zeros(size, size, state.cost), zeros(3, size, state.cost)
    pull, column = vectors[0, :rest], vectors[1, :rest]
    at, moved, curvatures = lattice.ats[node], lattice.moved[node], lattice.curvatures[node]
    for i in range(size):
        k = ordered(i, rest)
        slope = state.gradient[k]
        if k < 5:
            slope += slopes[VOLUME, k]
        vectors[0, i] = slope
        for j in range(i + 1):
            factor[i, j] = state.information[k, ordered(j, rest)]
        at[i] = state.at[i]
    if not cholesky(factor):
        lattice.logs[node] = -np.inf
        return 0.0
    log_weight = state.log_volume - state.cost
    for i in range(rest):
        log_weight -= np.log(factor[i, i])
    # The lower left of the factor is B' L^-T, and the lower right that of what is left.
    solve_lower(factor, pull)
    decrement = 0.0
    for i in range(rest):
        decrement += 0.5 * pull[i] * pull[i]
    # Far from the mean the model of second order is not valid.
    lattice.logs[node] = log_weight + min(decrement, SETTLED)
    for a in range(2):
        slope = vectors[0, rest + a]
        for k in range(rest):
            slope -= factor[rest + a, k] * pull[k]
            column[k] = -factor[rest + a, k]
        lattice.slopes[node, a] = slope
        solve_upper(factor, column)
        for i in range(rest):
            moved[a, ordered(i, rest)] = column[i]
        moved[a, PITCH + a], moved[a, YAW - a] = 1.0, 0.0
    u, v, w = factor[rest, rest], factor[rest + 1, rest], factor[rest + 1, rest + 1]
    curvatures[0], curvatures[1], curvatures[2] = u * u, u * v, v * v + w * w
    solve_upper(factor, pull)
    excess = 1.0
    for i in range(rest):
        excess = max(excess, abs(pull[i]) / longest_step(problem, ordered(i, rest)))
    for i in range(rest):
        at[ordered(i, rest)] += pull[i] / excess
    # At an attitude the pose follows where the lamp is and how bright.
    coordinates = rest - len(problem.nuisance_mean)
    write_covariance(slopes, coordinates, factor[:rest], lattice.covariances[node])
    if is_row(lattice):
        decrement += integrate_across(slopes, lattice, node)
    _, pose, _ = to_lamp(problem.frame, at, problem.roll)
    for i in range(5):
        lattice.poses[node, i] = pose[i]
    return decrement


def integrate_across(pose_slopes: Array, lattice: Lattice, node: int) -> float:
    """Integrate a node across the row that it is of, as `integrate_rest` does all else."""
    m, n = lattice.across[0], lattice.across[1]
    moved, slopes, curvatures = lattice.moved[node], lattice.slopes[node], lattice.curvatures[node]
    at, covariance, turned = lattice.ats[node], lattice.covariances[node], np.zeros(5)
    u, v, w = curvatures[0], curvatures[1], curvatures[2]
    known = m * m * u + 2 * m * n * v + n * n * w
    ratio = (m * n * (u - w) + (n * n - m * m) * v) / known
    pull = (m * slopes[0] + n * slopes[1]) / known
    slope = n * slopes[0] - m * slopes[1] - ratio * pull * known
    own = n * n * u - 2 * m * n * v + m * m * w - ratio * ratio * known
    decrement = 0.5 * pull * pull * known
    lattice.logs[node] += min(decrement, SETTLED) - 0.5 * np.log(known)
    pull /= max(1.0, abs(pull) / MAX_STEP)
    for i in range(moved.shape[1]):
        off = m * moved[0, i] + n * moved[1, i]
        along = n * moved[0, i] - m * moved[1, i] - ratio * off
        at[i] += pull * off
        moved[0, i], moved[1, i] = n * along, -m * along
        for k in range(5):
            turned[k] += pose_slopes[k, i] * off if i < 5 else 0.0
    for k in range(5):
        for i in range(5):
            covariance[k, i] += turned[k] * turned[i] / known
    slopes[0], slopes[1] = n * slope, -m * slope
    curvatures[0], curvatures[1], curvatures[2] = n * n * own, -m * n * own, m * m * own
    return decrement


def write_covariance(
    pose_slopes: Array, coordinates: int, factor: Array, covariance: Array
) -> None:
    """Write the covariance of the pose by its slopes and the factor of the information.

    - coordinates: how many of these are unknown, the first ones of the information.
    """
    count = len(factor)
    spread = zeros(5, count, factor[0, 0])
    for i in range(5):
        for k in range(coordinates):
            spread[i, k] = pose_slopes[i, k]
        solve_lower(factor, spread[i])
        for j in range(i + 1):
            shared = 0.0
            for k in range(count):
                shared += spread[i, k] * spread[j, k]
            covariance[i, j] = covariance[j, i] = shared
