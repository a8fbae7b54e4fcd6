"""The most probable path of a vehicle through the images of an approach.

It is found by the iterated Kalman smoother (B. Bell, *The Iterated Kalman Smoother as a
Gauss-Newton Method*, 1994) with the damping of Levenberg and Marquardt (S. Sarkka and L. Svensson,
2020): each step filters and smooths the problem made linear at the path.
"""

from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.gauss_newton import minimiser
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.estimation.tracking.docking.motion import MOTION, DockingMotion, StatePrior
from uuv_optical_array.forward.model import ForwardModel

MOST_STEPS = 12
ARRIVED = 5e-3  # decrement of the negative log-posterior from which a step is the last


class PathProblem(NamedTuple):
    """The images of n approaches, k each.

    Parameters
    ----------
    model, motion
        Of the scene and of the vehicle; a state is the pose, its motion and the offsets of the
        scene's uncertain settings, which `motion` takes for constant.
    prior
        Of the first state of each approach.
    readings
        Counts, finite, shape ``(n, k, side * side)``.
    """

    model: ForwardModel
    motion: DockingMotion
    prior: StatePrior
    readings: Array


class PathState(NamedTuple):
    """The posterior at one path of each approach; `gauss_newton.minimiser` wants their axis last.

    Parameters
    ----------
    cost
        Negative log-posterior, without constants, shape ``(n,)``.
    path
        States of p numbers, shape ``(k, p, n)``.
    gradient, information
        Of each image's log-likelihood, by pose and settings (s in all), shapes ``(k, s, n)`` and
        ``(k, s, s, n)``; the information is that of Gauss-Newton.
    motion_cost
        What the motion adds to the cost, shape ``(n,)``.
    """

    cost: Array
    path: Array
    gradient: Array
    information: Array
    motion_cost: Array


class FilteredPath(NamedTuple):
    """A Kalman filter of the problem made linear at a path.

    Parameters
    ----------
    means, spreads
        States and their covariances given the images up to each frame, shapes ``(n, k, p)`` and
        ``(k, n, p, p)``.
    predicted, widened
        The same given the images before each frame.
    slopes
        Of each state by the one before it, shape ``(n, k - 1, p, p)``.
    decrement
        How far the cost falls, by its model of second order, shape ``(n,)``.
    """

    means: Array
    spreads: Array
    predicted: Array
    widened: Array
    slopes: Array
    decrement: Array


def approaches_last(array: Array) -> Array:
    """Move the axis of the approaches from the first place to the last."""
    return np.moveaxis(array, 0, -1)


def approaches_first(array: Array) -> Array:
    """Move the axis of the approaches from the last place to the first."""
    return np.moveaxis(array, -1, 0)


@np.errstate(under="ignore")
def evaluate(problem: PathProblem, at: Array) -> PathState:
    """Return the posterior at paths, shape ``(k, p, n)``, with derivatives."""
    path, model = approaches_first(at), problem.model
    offsets = {
        name: path[..., MOTION + i] for i, name in enumerate(model.scene.prior.nuisance_std())
    }
    light, jacobian = model.linearised(path[..., :5], 0.0, offsets)
    values, scores, curvatures = log_likelihood(problem.readings, light, model.noise)
    gradient = (scores[..., None, :] @ jacobian)[..., 0, :]
    information = np.swapaxes(jacobian * curvatures[..., None], -1, -2) @ jacobian
    motion_cost = problem.motion.cost(path, problem.prior)
    cost = motion_cost - values.sum(axis=(1, 2))
    return PathState(cost, at, approaches_last(gradient), approaches_last(information), motion_cost)


@np.errstate(under="ignore")
def filtered(problem: PathProblem, state: PathState, damping: Array) -> FilteredPath:
    """Filter the problem made linear at the paths of a state.

    Parameters
    ----------
    problem, state
        As `evaluate` has them.
    damping
        Relative weight of staying at the path, >= 0, shape ``(n,)``.
    """
    motion, path = problem.motion, approaches_first(state.path)
    gradient, information = approaches_first(state.gradient), approaches_first(state.information)
    count, frames, size = path.shape
    ahead, slopes = motion.moved(path[:, :-1])
    means, predicted = np.empty_like(path), np.empty_like(path)
    spreads, widened = np.empty((2, frames, count, size, size))
    diagonal, seen = np.arange(size), motion.seen
    decrement = state.motion_cost.copy()
    for k in range(frames):
        if k == 0:
            predicted[:, 0], widened[0] = problem.prior
        else:
            slope = slopes[:, k - 1]
            off = means[:, k - 1] - path[:, k - 1]
            predicted[:, k] = ahead[:, k - 1] + (slope @ off[..., None])[..., 0]
            widened[k] = slope @ spreads[k - 1] @ np.swapaxes(slope, 1, 2) + motion.noise
        joint = np.linalg.inv(widened[k])
        ahead_of_path = predicted[:, k] - path[:, k]
        pull = (joint @ ahead_of_path[..., None])[..., 0]
        decrement -= 0.5 * (pull * ahead_of_path).sum(axis=1)
        pull[:, seen] += gradient[:, k]
        joint[:, seen[:, None], seen] += information[:, k]
        joint[:, diagonal, diagonal] *= 1 + damping[:, None]
        spreads[k] = np.linalg.inv(joint)
        step = (spreads[k] @ pull[..., None])[..., 0]
        decrement += 0.5 * (pull * step).sum(axis=1)
        means[:, k] = path[:, k] + step
    return FilteredPath(means, spreads, predicted, widened, slopes, decrement)


@np.errstate(under="ignore")
def smoothed(found: FilteredPath) -> Array:
    """Return the most probable paths of filtered ones, shape ``(n, k, p)``."""
    path = found.means.copy()
    for k in range(path.shape[1] - 2, -1, -1):
        # The gain is spread slope' widened^-1.
        off = path[:, k + 1] - found.predicted[:, k + 1]
        off = np.linalg.solve(found.widened[k + 1], off[..., None])
        back = np.swapaxes(found.slopes[:, k], 1, 2) @ off
        path[:, k] += (found.spreads[k] @ back)[..., 0]
    # What does not change is known best at the end.
    path[..., MOTION:] = path[:, -1:, MOTION:]
    return path


def propose(problem: PathProblem, state: PathState, damping: Array) -> tuple[Array, Array]:
    """Return the damped Gauss-Newton step from each path, and its decrement."""
    found = filtered(problem, state, damping)
    return approaches_last(smoothed(found)), found.decrement


# Moves paths, shape ``(k, p, n)``, to where they are most probable nearby.
refine = minimiser(evaluate, propose, ARRIVED, MOST_STEPS)
