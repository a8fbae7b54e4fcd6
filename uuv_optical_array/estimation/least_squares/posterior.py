"""What an image leaves possible: mean and covariance of the pose.

Given the attitude, the other unknowns (the lamp's direction and attenuation, the scene's nuisances)
are nearly Gaussian, however bent or broad the whole posterior is, as an image determines them
directly. So pitch and yaw are integrated on a lattice, and the others at each of its nodes by
Laplace's approximation (nested as by H. Rue, S. Martino and N. Chopin, 2009, J. R. Stat. Soc. B 71,
319).

The lattice is filled outwards from a minimum wherever the posterior is not negligible: over an
ellipse, a banana, or the ring of attitudes that a planar array cannot tell apart. A spacing of 1.5
standard deviations integrates a Gaussian to 1e-4, and its variance to half a percent.

If the posterior is nearly Gaussian in the attitude, too, nine nodes of the Gauss-Hermite rule show
it, and integrate it with a third of the nodes (M. Abramowitz and I. Stegun, *Handbook of
Mathematical Functions*, 1964, 25.4.46). If it is so only across its widest direction, as with a
beam that dims evenly over a range of angles, that direction belongs to all else: the nodes are a
row along the widest one, which may bend. Laplace's approximation of the whole only serves to
compare hypotheses: as a covariance it is overconfident by one lamp, most in bright light.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import PITCH, Array
from uuv_optical_array.core.numerics.elementwise import stack
from uuv_optical_array.core.numerics.linear_algebra import cholesky
from uuv_optical_array.estimation.least_squares.attitude_nodes import (
    Lattice,
    is_row,
    write_covariance,
    write_node,
    write_start,
)
from uuv_optical_array.estimation.least_squares.problem import (
    Problem,
    State,
    evaluate,
)

SPACING = 1.6  # of the lattice, in standard deviations at the minimum
LONGEST = 0.5  # longest step of the lattice, rad: a longer one could miss the posterior
# Largest difference of the posterior's logarithm from a Gaussian's where it counts as Gaussian.
NEARLY = 0.6
ALONG, CORNERS = 2, 4  # of nine nodes: from where on they are along the widest axis, and in corners
MINIMUM: Any = np.int64(0)  # the first node; a NumPy integer, as Numba compiles again for literals
LOG_2PI = math.log(2 * math.pi)
COARSE = 1.8  # spacing, in standard deviations at a node, beyond which the lattice is made finer
WEIGHTY = 4.0  # nodes with a logarithm that far below the largest have to be spaced so
NEGLIGIBLE = 7.5  # nodes farther below it are left out
LEAST_NODES = 5  # with fewer there is no covariance
HALF_WIDTH = 100  # nodes from the minimum to the edge of the map
FINER = 4  # how often the lattice may be made finer or coarser


class PosteriorMoments(NamedTuple):
    """Moments of a posterior.

    - log_weight: logarithm of the integral of the posterior, without constants.
    - mean, covariance: of the pose, m and rad, shapes ``(5,)`` and ``(5, 5)``.
    - nodes: how many nodes of the lattice count.
    """

    log_weight: float
    mean: Array
    covariance: Array
    nodes: int


def basis_of(curvature: Array) -> tuple[Array, float]:
    """Return the steps of a lattice along the axes of a Gaussian, and the logarithm of a cell."""
    half, apart = 0.5 * (curvature[0] + curvature[2]), 0.5 * (curvature[0] - curvature[2])
    turn = np.hypot(apart, curvature[1])
    angle = 0.5 * np.arctan2(curvature[1], apart)
    narrow = SPACING / np.sqrt(half + turn)
    wide = SPACING / np.sqrt(max(half - turn, 1e-12 * half))
    narrow, wide = min(narrow, LONGEST), min(wide, LONGEST)
    basis = np.empty((2, 2))
    basis[0, 0], basis[1, 0] = narrow * np.cos(angle), narrow * np.sin(angle)
    basis[0, 1], basis[1, 1] = -wide * np.sin(angle), wide * np.cos(angle)
    return basis, np.log(narrow * wide)


def fill(problem: Problem, basis: Array, lattice: Lattice) -> tuple[PosteriorMoments, Array]:
    """Sum the posterior over a lattice, outwards from its first node.

    - basis: steps of the lattice in pitch and yaw, by columns, rad, shape ``(2, 2)``.
    - returned moments: per cell of the lattice.
    - returned coarseness: the largest square of each step in standard deviations there, where it
      counts, shape ``(2,)``; negative where there were more nodes than the map has room for.
    """
    logs, most = lattice.logs, len(lattice.logs)
    seen = np.zeros((2 * HALF_WIDTH + 1, 2 * HALF_WIDTH + 1), dtype=np.bool_)
    places, squares = np.empty((most, 2), dtype=np.int64), np.empty((most, 2))
    start = np.empty(lattice.ats.shape[1])
    count, done, overflow = 0, 0, False
    row = is_row(lattice)
    ways = 2 if row else 4
    largest = logs[0]
    place_i, place_j = HALF_WIDTH, HALF_WIDTH
    seen[place_i, place_j] = True
    while True:
        # The newest node; one that is negligible gives its place to the next.
        if logs[count] > largest - NEGLIGIBLE:
            largest = max(largest, logs[count])
            places[count, 0], places[count, 1] = place_i, place_j
            curvatures = lattice.curvatures[count]
            for k in range(2):
                u, v = basis[0, k], basis[1, k]
                square = u * u * curvatures[0] + 2 * u * v * curvatures[1]
                squares[count, k] = square + v * v * curvatures[2]
            count += 1
        # The next neighbour, of a node that counts, which may count too.
        has_next = False
        while not has_next and done < ways * count:
            parent, way = done // ways, done % ways
            done += 1
            if logs[parent] < largest - NEGLIGIBLE:
                continue
            axis, sign = 1 if row else way // 2, 1 - 2 * (way % 2)
            place_i = places[parent, 0] + (sign if axis == 0 else 0)
            place_j = places[parent, 1] + (sign if axis == 1 else 0)
            edge = 2 * HALF_WIDTH
            if not (0 <= place_i <= edge and 0 <= place_j <= edge):
                overflow = True
                continue
            if seen[place_i, place_j]:
                continue
            u, v = sign * basis[0, axis], sign * basis[1, axis]
            expected = logs[parent] + u * lattice.slopes[parent, 0] + v * lattice.slopes[parent, 1]
            expected -= 0.5 * squares[parent, axis]
            if expected < largest - NEGLIGIBLE:
                continue
            seen[place_i, place_j] = True
            write_start(lattice, parent, u, v, start)
            if abs(start[PITCH]) > 0.5 * np.pi:
                continue
            if count == most:
                overflow = True
                continue
            write_node(problem, evaluate(problem, start), lattice, count)
            has_next = True
        if not has_next:
            break
    for i in range(count, most):
        logs[i] = -np.inf
    coarseness = np.zeros(2)
    for k in range(2):
        # Where the slope of the light jumps the posterior is narrower than its curvature says.
        whole, middle, spread = 0.0, 0.0, 0.0
        for i in range(count):
            weight, step = np.exp(logs[i] - largest), places[i, k] - HALF_WIDTH
            whole += weight
            middle += weight * step
            spread += weight * step * step
            if logs[i] > largest - WEIGHTY:
                coarseness[k] = max(coarseness[k], squares[i, k])
        variance = spread / whole - (middle / whole) ** 2
        if k == 1 or not row:
            coarseness[k] = max(coarseness[k], 1 / max(variance, 1e-2))
        if overflow:
            coarseness[k] = -1.0
    if row and count < LEAST_NODES:
        coarseness[1] = max(coarseness[1], 2 * COARSE * COARSE)
    return moments_of(lattice, logs[:count]), coarseness


def moments_of(lattice: Lattice, logs: Array) -> PosteriorMoments:
    """Return the moments of the first m nodes of a lattice, by logarithms of their weights."""
    mean, second = np.zeros(5), np.zeros((5, 5))
    poses, covariances = lattice.poses, lattice.covariances
    whole, nodes, largest = 0.0, 0, logs[0]
    for log in logs:
        largest = max(largest, log)
    for i in range(len(logs)):
        weight = np.exp(logs[i] - largest)
        whole += weight
        if logs[i] > largest - NEGLIGIBLE:
            nodes += 1
        for a in range(5):
            off = poses[i, a] - poses[0, a]
            mean[a] += weight * off
            for b in range(a + 1):
                product = off * (poses[i, b] - poses[0, b])
                second[a, b] += weight * (covariances[i, a, b] + product)
    for a in range(5):
        mean[a] /= whole
        for b in range(a + 1):
            second[a, b] = second[a, b] / whole - mean[a] * mean[b]
            second[b, a] = second[a, b]
    for a in range(5):
        mean[a] += poses[0, a]
    return PosteriorMoments(largest + np.log(whole), mean, second, nodes)


def by_nine_nodes(
    problem: Problem, basis: Array, log_cell: float, lattice: Lattice
) -> PosteriorMoments:
    """Integrate by Gauss and Hermite's rule about the first node.

    Where a logarithm is off by `NEARLY` or more the weight is -inf, with the nodes until then, and
    one is left in the lattice.
    """
    logs, size = np.empty(9), lattice.ats.shape[1]
    start, straight, step = np.empty(size), np.empty(size), np.sqrt(3.0) / SPACING
    one = step * basis[0, 0], step * basis[1, 0]
    other = step * basis[0, 1], step * basis[1, 1]
    logs[0] = np.log(16 / 36)
    # Four along the axes, one after its opposite, then four corners, from the first axis.
    for node in range(1, 9):
        sign, corner = 1 - 2 * ((node - 1) % 2), node > 4
        i = 1 - 2 * ((node - 5) // 2) if corner else (sign if node < 3 else 0)
        j = sign if node > 2 else 0
        parent, alike = MINIMUM, node - 1
        if corner:
            parent, alike = (3 - i) // 2, (7 - j) // 2
            write_start(lattice, parent, j * other[0], j * other[1], start)
            write_start(lattice, MINIMUM, j * other[0], j * other[1], straight)
        else:
            u, v = i * one[0] + j * other[0], i * one[1] + j * other[1]
            write_start(lattice, MINIMUM, u, v, start)
            write_start(lattice, MINIMUM, -u, -v, straight)
        if corner or sign < 0:
            # The prediction is off by as much as at the corresponding node.
            for k in range(size):
                start[k] += lattice.ats[alike, k] - straight[k]
        write_node(problem, evaluate(problem, start), lattice, node)
        over = lattice.logs[node] - lattice.logs[0] + 1.5 * (i * i + j * j)
        if not abs(over) < NEARLY:
            for k in range(1, node + 1):
                lattice.logs[k] = -np.inf
            return PosteriorMoments(-np.inf, np.zeros(5), np.zeros((5, 5)), node - 1)
        logs[node] = over + np.log((1 if corner else 4) / 36)
    moments = moments_of(lattice, logs)
    log_weight = moments.log_weight + lattice.logs[0] + np.log(2 * np.pi / SPACING**2) + log_cell
    return PosteriorMoments(log_weight, moments.mean, moments.covariance, moments.nodes)


def laplace(state: State) -> PosteriorMoments:
    """Return the moments of a posterior by Laplace's approximation about a minimum."""
    factor, covariance = state.information.copy(), np.full((5, 5), np.nan)
    mean = stack(*state.pose)
    if not cholesky(factor):
        return PosteriorMoments(-np.inf, mean, covariance, 0)
    # As of a lattice, whose sum is over the attitude.
    log_weight = state.log_volume - state.cost + LOG_2PI
    for i in range(len(factor)):
        log_weight -= np.log(factor[i, i])
    write_covariance(state.slopes, state.slopes.shape[1], factor, covariance)
    return PosteriorMoments(log_weight, mean, covariance, 0)


def integrate(problem: Problem, minimum: State, lattice: Lattice) -> PosteriorMoments:
    """Integrate the posterior that is connected with a minimum of the cost, over nodes.

    The weight is -inf where the image leaves no finite posterior.
    """
    write_node(problem, minimum, lattice, MINIMUM)
    if not np.isfinite(lattice.logs[0]):
        return PosteriorMoments(-np.inf, np.zeros(5), np.zeros((5, 5)), 0)
    basis, log_cell = basis_of(lattice.curvatures[0])
    # Only a beam of several Gaussians dims so evenly that a long and bent ridge is left.
    ridge = problem.frame.gaussians.shape[1] > 1
    longest = max(np.hypot(basis[0, 0], basis[1, 0]), np.hypot(basis[0, 1], basis[1, 1]))
    # The posterior of a planar array may go on in a ring.
    if problem.frame.share == 0 and (ridge or longest < LONGEST):
        near = by_nine_nodes(problem, basis, log_cell, lattice)
        if np.isfinite(near.log_weight):
            return near
        if ridge and ALONG <= near.nodes < CORNERS:
            narrow = np.hypot(basis[0, 0], basis[1, 0])
            lattice.across[0], lattice.across[1] = basis[0, 0] / narrow, basis[1, 0] / narrow
            write_node(problem, minimum, lattice, MINIMUM)
            row = refined(problem, basis, log_cell + 0.5 * LOG_2PI - np.log(narrow), lattice)
            if np.isfinite(row.log_weight):
                return row
            lattice.across[0], lattice.across[1] = 0.0, 0.0
            write_node(problem, minimum, lattice, MINIMUM)
    return refined(problem, basis, log_cell, lattice)


def refined(
    problem: Problem, first_basis: Array, log_cell: float, lattice: Lattice
) -> PosteriorMoments:
    """Integrate over a lattice that is made finer, or coarser, from its first basis on."""
    basis = first_basis.copy()
    moments, coarseness = fill(problem, basis, lattice)
    for _ in range(FINER):
        # Of too many nodes: a coarser lattice is less exact, and none is no answer.
        overflow = coarseness[0] < 0
        if not (overflow or max(coarseness[0], coarseness[1]) > COARSE * COARSE):
            break
        for k in range(2):
            longer = 1.5 if overflow else 1.0
            if coarseness[k] > COARSE * COARSE:
                longer = max(SPACING / np.sqrt(coarseness[k]), 1 / 3)
            basis[0, k] *= longer
            basis[1, k] *= longer
            log_cell += np.log(longer)
        moments, coarseness = fill(problem, basis, lattice)
    log_weight = moments.log_weight + log_cell if moments.nodes >= LEAST_NODES else -np.inf
    return PosteriorMoments(log_weight, moments.mean, moments.covariance, moments.nodes)
