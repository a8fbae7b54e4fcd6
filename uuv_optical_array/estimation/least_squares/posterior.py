"""What an image leaves possible: mean and covariance of the pose.

Given the attitude, all else (where the lamp is seen, how much its light is attenuated, and the
scene's nuisances) is nearly Gaussian, however bent or broad the whole posterior is: these are what
an image tells directly. So pitch and yaw are integrated on a lattice, and at each of its nodes all
else by Laplace's approximation (as in the nested Laplace approximations of H. Rue, S. Martino and
N. Chopin, 2009, J. R. Stat. Soc. B 71, 319).

The lattice is filled outwards from a minimum, node by node, wherever the posterior is not
negligible: over an ellipse, a banana, or the ring of attitudes that a planar array cannot tell
apart. A sum over a lattice whose spacing is 1.5 standard deviations integrates a Gaussian to 1e-4,
and its variance to half a percent.
"""

from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import PITCH, YAW, Array
from uuv_optical_array.core.linear_algebra import cholesky, solve_lower, solve_upper
from uuv_optical_array.estimation.least_squares.coordinates import to_lamp
from uuv_optical_array.estimation.least_squares.problem import Problem, State, evaluate

SPACING = 1.5  # of the lattice, in standard deviations at the minimum
COARSE = 1.8  # spacing in standard deviations anywhere that asks for a finer lattice
WEIGHTY = 4.0  # below the largest weight's logarithm, down to where that is asked
NEGLIGIBLE = 8.5  # below it, from where nodes are left out
MOST_NODES = 1200
HALF_WIDTH = 100  # nodes from the minimum to the edge of the map
FINER = 4  # times the lattice may be made finer
# Decrement that all else may still have at a node; Laplace's approximation takes it into account.
SETTLED = 0.3
CORRECTIONS = 12  # steps of all else at a node


class Node(NamedTuple):
    """The posterior at one attitude, all else integrated.

    Parameters
    ----------
    log_weight
        Logarithm of the probability density of the attitude, without constants.
    decrement
        Of what is left of the way to the conditional mean.
    at
        Coordinates and nuisances of that mean, shape ``(p,)``.
    moved
        How the conditional mean of all else moves with pitch and yaw, shape ``(p, 2)``; 1 for
        pitch and yaw themselves.
    gradient, information
        Of the logarithm of the density by pitch and yaw, in Gauss and Newton's approximation, shape
        ``(2,)`` and ``(2, 2)``.
    pose, covariance
        Conditional mean and covariance of the pose, shapes ``(5,)`` and ``(5, 5)``.
    """

    log_weight: float
    decrement: float
    at: Array
    moved: Array
    gradient: Array
    information: Array
    pose: Array
    covariance: Array


class Moments(NamedTuple):
    """Moments of a posterior.

    Parameters
    ----------
    log_weight
        Logarithm of the integral of the posterior, without constants.
    mean, covariance
        Of the pose, m and rad, shapes ``(5,)`` and ``(5, 5)``.
    nodes
        How many nodes of the lattice count.
    """

    log_weight: float
    mean: Array
    covariance: Array
    nodes: int


def node_at(problem: Problem, start: Array) -> Node:
    """Integrate all else at the attitude of a place near the conditional mean."""
    state = evaluate(problem, start)
    node = integrated(problem, state)
    damping = 0.0
    for _ in range(CORRECTIONS):
        if not node.decrement > SETTLED:
            break
        ahead = evaluate(problem, state.at + rest_of_the_way(problem, state, damping))
        if ahead.cost - ahead.log_volume < state.cost - state.log_volume:
            state = ahead
            node = integrated(problem, state)
            damping *= 0.1
        else:
            damping = max(10 * damping, 0.1)
    return node


def rest_of_the_way(problem: Problem, state: State, damping: float) -> Array:
    """Return a damped Gauss-Newton step towards the conditional mean, shape ``(p,)``."""
    factor, step = state.information.copy(), state.gradient.copy()
    step[:5] += state.log_volume_slopes
    for i in range(len(step)):
        factor[i, i] *= 1 + damping
    for held in (PITCH, YAW):
        step[held] = 0.0
        factor[held, :] = 0.0
        factor[:, held] = 0.0
        factor[held, held] = 1.0
    if cholesky(factor):
        solve_lower(factor, step)
        solve_upper(factor, step)
    excess = 1.0
    for i in range(len(step)):
        excess = max(excess, abs(step[i]) / problem.reach[i])
    return step / excess


def integrated(problem: Problem, state: State) -> Node:
    """Integrate all but the attitude by Laplace's approximation about a state."""
    size = len(state.at)
    rest = size - 2
    # All else first, then the attitude.
    order = np.empty(size, dtype=np.int64)
    for i in range(rest):
        order[i] = i if i < PITCH else i + 2
    order[rest], order[rest + 1] = PITCH, YAW
    factor, pull, ahead = np.empty((size, size)), np.empty(rest), np.empty(2)
    for i in range(size):
        k = order[i]
        slope = state.gradient[k]
        if k < 5:
            slope += state.log_volume_slopes[k]
        if i < rest:
            pull[i] = slope
        else:
            ahead[i - rest] = slope
        for j in range(i + 1):
            factor[i, j] = state.information[k, order[j]]
    at, moved = state.at.copy(), np.zeros((size, 2))
    gradient, information = np.zeros(2), np.zeros((2, 2))
    covariance, pose = np.zeros((5, 5)), state.pose.copy()
    if not cholesky(factor):
        return Node(-np.inf, 0.0, at, moved, gradient, information, pose, covariance)
    log_weight = state.log_volume - state.cost
    for i in range(rest):
        log_weight -= np.log(factor[i, i])
    # The lower left of the factor is B' L^-T, and the lower right that of what is left.
    solve_lower(factor, pull)
    decrement = 0.5 * (pull * pull).sum()
    # Far from the mean the model of second order promises what is not there.
    log_weight += min(decrement, SETTLED)
    column = np.empty(rest)
    for a in range(2):
        gradient[a] = ahead[a]
        for k in range(rest):
            gradient[a] -= factor[rest + a, k] * pull[k]
            column[k] = -factor[rest + a, k]
        for b in range(2):
            for k in range(min(a, b) + 1):
                information[a, b] += factor[rest + a, rest + k] * factor[rest + b, rest + k]
        solve_upper(factor, column)
        for i in range(rest):
            moved[order[i], a] = column[i]
        moved[PITCH + a, a] = 1.0
    solve_upper(factor, pull)
    excess = 1.0
    for i in range(rest):
        excess = max(excess, abs(pull[i]) / problem.reach[order[i]])
    for i in range(rest):
        at[order[i]] += pull[i] / excess
    _, components, _ = to_lamp(problem.frame, at, problem.roll)
    for i in range(5):
        pose[i] = components[i]
    # Of the pose: its slopes by where the lamp is and how bright, times the root of their
    # covariance.
    spread = np.zeros((5, rest))
    for i in range(5):
        for k in range(3):
            spread[i, k] = state.pose_slopes[i, k]
        solve_lower(factor, spread[i])
    for i in range(5):
        for j in range(i + 1):
            for k in range(rest):
                covariance[i, j] += spread[i, k] * spread[j, k]
            covariance[j, i] = covariance[i, j]
    return Node(log_weight, decrement, at, moved, gradient, information, pose, covariance)


def basis_of(information: Array, round_shape: bool) -> tuple[Array, float]:
    """Return the steps of a lattice along the axes of a Gaussian, and the logarithm of a cell.

    Parameters
    ----------
    information
        Of the Gaussian, positive definite, shape ``(2, 2)``.
    round_shape
        Whether both steps are to be as long as the shorter one.
    """
    half = 0.5 * (information[0, 0] + information[1, 1])
    apart = 0.5 * (information[0, 0] - information[1, 1])
    turn = np.hypot(apart, information[0, 1])
    angle = 0.5 * np.arctan2(information[0, 1], apart)
    narrow = SPACING / np.sqrt(half + turn)
    wide = SPACING / np.sqrt(max(half - turn, 1e-12 * half))
    # Half a radian is as far as a lattice of attitudes can step and still see anything.
    narrow, wide = min(narrow, 0.5), min(wide, 0.5)
    if round_shape:
        wide = narrow
    basis = np.empty((2, 2))
    basis[0, 0], basis[1, 0] = narrow * np.cos(angle), narrow * np.sin(angle)
    basis[0, 1], basis[1, 1] = -wide * np.sin(angle), wide * np.cos(angle)
    return basis, np.log(narrow * wide)


def fill(problem: Problem, basis: Array, seed: Node) -> tuple[Moments, Array]:
    """Sum the posterior over a lattice, outwards from a node.

    Parameters
    ----------
    problem
        The posterior.
    basis
        Steps of the lattice in pitch and yaw, by columns, rad, shape ``(2, 2)``.
    seed
        The node to start from.

    Returns
    -------
    moments
        Per cell of the lattice.
    coarseness
        The largest square of each step in standard deviations there, where it counts, shape
        ``(2,)``; negative where there were more nodes than the map has room for.
    """
    size = len(seed.at)
    seen = np.zeros((2 * HALF_WIDTH + 1, 2 * HALF_WIDTH + 1), dtype=np.bool_)
    places = np.empty((MOST_NODES, 2), dtype=np.int64)
    logs, poses = np.empty(MOST_NODES), np.empty((MOST_NODES, 5))
    covariances, squares = np.empty((MOST_NODES, 5, 5)), np.empty((MOST_NODES, 2))
    ats, moveds = np.empty((MOST_NODES, size)), np.empty((MOST_NODES, size, 2))
    gradients, informations = np.empty((MOST_NODES, 2)), np.empty((MOST_NODES, 2, 2))
    count, done, overflow = 0, 0, False
    largest = seed.log_weight
    node, place_i, place_j = seed, HALF_WIDTH, HALF_WIDTH
    seen[place_i, place_j] = True
    while True:
        if node.log_weight > largest - NEGLIGIBLE:
            largest = max(largest, node.log_weight)
            places[count, 0], places[count, 1] = place_i, place_j
            logs[count], poses[count], covariances[count] = (
                node.log_weight,
                node.pose,
                node.covariance,
            )
            ats[count], moveds[count] = node.at, node.moved
            gradients[count], informations[count] = node.gradient, node.information
            for k in range(2):
                u, v = basis[0, k], basis[1, k]
                squares[count, k] = (
                    u * u * node.information[0, 0]
                    + 2 * u * v * node.information[0, 1]
                    + v * v * node.information[1, 1]
                )
            count += 1
        # The next neighbour, of a node that counts, which may count too.
        found = False
        while not found and done < 4 * count:
            parent, way = done // 4, done % 4
            done += 1
            if logs[parent] < largest - NEGLIGIBLE:
                continue
            axis, sign = way // 2, 1 - 2 * (way % 2)
            place_i = places[parent, 0] + (sign if axis == 0 else 0)
            place_j = places[parent, 1] + (sign if axis == 1 else 0)
            edge = 2 * HALF_WIDTH
            if not (0 <= place_i <= edge and 0 <= place_j <= edge):
                overflow = True
                continue
            if seen[place_i, place_j]:
                continue
            u, v = sign * basis[0, axis], sign * basis[1, axis]
            expected = logs[parent] + u * gradients[parent, 0] + v * gradients[parent, 1]
            expected -= 0.5 * squares[parent, axis]
            if expected < largest - NEGLIGIBLE:
                continue
            seen[place_i, place_j] = True
            start = ats[parent] + u * moveds[parent, :, 0] + v * moveds[parent, :, 1]
            if abs(start[PITCH]) > 0.5 * np.pi:
                continue
            if count == MOST_NODES:
                overflow = True
                continue
            node = node_at(problem, start)
            found = True
        if not found:
            break
    mean, second, whole = np.zeros(5), np.zeros((5, 5)), 0.0
    coarseness, middle, spread = np.zeros(2), np.zeros(2), np.zeros(2)
    nodes = 0
    for i in range(count):
        weight = np.exp(logs[i] - largest)
        whole += weight
        if logs[i] > largest - NEGLIGIBLE:
            nodes += 1
        for k in range(2):
            if logs[i] > largest - WEIGHTY:
                coarseness[k] = max(coarseness[k], squares[i, k])
            step = places[i, k] - HALF_WIDTH
            middle[k] += weight * step
            spread[k] += weight * step * step
        for a in range(5):
            off = poses[i, a] - seed.pose[a]
            mean[a] += weight * off
            for b in range(5):
                product = off * (poses[i, b] - seed.pose[b])
                second[a, b] += weight * (covariances[i, a, b] + product)
    for a in range(5):
        mean[a] /= whole
    for a in range(5):
        for b in range(5):
            second[a, b] = second[a, b] / whole - mean[a] * mean[b]
    for k in range(2):
        # Where the slope of the light jumps the posterior is narrower than its curvature says.
        variance = spread[k] / whole - (middle[k] / whole) ** 2
        coarseness[k] = max(coarseness[k], 1 / max(variance, 1e-2))
    if overflow:
        coarseness[:] = -1.0
    return Moments(largest + np.log(whole), mean + seed.pose, second, nodes), coarseness


def integrate(problem: Problem, minimum: Array) -> Moments:
    """Integrate the posterior that is connected with a minimum.

    Parameters
    ----------
    problem
        The posterior.
    minimum
        Coordinates and nuisances of a minimum of the cost, shape ``(p,)``.

    Returns
    -------
    Moments
        With a weight of -inf where the image leaves no finite posterior.
    """
    seed = node_at(problem, minimum)
    if not np.isfinite(seed.log_weight):
        return Moments(-np.inf, seed.pose, seed.covariance, 0)
    basis, log_cell = basis_of(seed.information, problem.frame.share > 0)
    moments, coarseness = fill(problem, basis, seed)
    for _ in range(FINER):
        if coarseness[0] < 0:
            # Too many nodes: a coarser lattice is less exact, and none is no answer.
            basis *= 1.5
            log_cell += 2 * np.log(1.5)
        elif max(coarseness[0], coarseness[1]) > COARSE * COARSE:
            for k in range(2):
                if coarseness[k] > COARSE * COARSE:
                    shorter = max(SPACING / np.sqrt(coarseness[k]), 1 / 3)
                    basis[:, k] *= shorter
                    log_cell += np.log(shorter)
        else:
            break
        moments, coarseness = fill(problem, basis, seed)
    return Moments(moments.log_weight + log_cell, moments.mean, moments.covariance, moments.nodes)
