"""A smoother of images for the approach to a lamp that stays where it is, such as a dock's.

Lamp and water do not change during an approach, so their uncertain settings are estimated once for
all frames; and a vehicle moves along its heading, so that its path determines its attitude. The
newest pose ends the most probable path, fitted again with every image by damped Gauss-Newton steps:
a filter would keep its linearisation of the first, far images, where the likelihood is most curved.
"""

from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import PITCH, YAW, Array
from uuv_optical_array.core.numerics.gauss_newton import minimiser
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.forward.model import ForwardModel

# The first pose is known to be behind the lamp, no more; and speed ahead and turn rates, 5 deg/s.
FIRST_RANGE_M = 6.0
FIRST_STD = np.array([10.0, 5.0, 5.0, 2.0, 2.0, 1.0, *np.radians([5.0, 5.0])])
# A state is the pose and these; a path is all frames' states, then offsets of uncertain settings.
SPEED, PITCH_RATE, YAW_RATE, STATE = 5, 6, 7, 8
TINY = 1e-30
MAX_STEPS = 12
CONVERGED = 5e-3  # decrement of the negative log-posterior below which a step is the last


def predict(states: Array, step_s: float) -> tuple[Array, Array]:
    """Return the states one step later, shape ``(..., 8)``, and their derivatives."""

    def later(states: Any) -> Any:
        turns = step_s * states[..., PITCH_RATE:]
        pitch, yaw = np.moveaxis(states[..., PITCH:SPEED] + turns / 2, -1, 0)
        cosine = np.cos(pitch)
        heading = np.stack([cosine * np.cos(yaw), cosine * np.sin(yaw), -np.sin(pitch)], axis=-1)
        change = step_s * states[..., SPEED, None] * heading, turns, 0 * states[..., SPEED:]
        return states + np.concatenate(change, axis=-1)

    # Complex steps give derivatives to rounding (W. Squire and G. Trapp, 1998).
    stepped = later(states[..., None, :] + 1j * TINY * np.eye(STATE))
    return later(states), np.swapaxes(stepped.imag / TINY, -1, -2)


class Motion:
    """The prior of a path: its first state, its steps and the offsets of the scene's settings.

    Walks and slip are sigmas in 1 s, those of a vehicle that holds its speed and does not drift.
    """

    def __init__(
        self,
        model: ForwardModel,
        step_s: float,
        *,
        speed_walk_m_per_s: float = 0.005,
        slip_m: float = 0.005,
        turn_walk_deg_per_s: float = 4.0,
    ) -> None:
        self.model, self.step_s = model, step_s
        self.first = np.array([-FIRST_RANGE_M, *np.zeros(STATE - 1)])
        self.first_precision = FIRST_STD**-2.0
        self.offset_precision = np.array([*model.scene.prior.nuisance_std().values()]) ** -2.0
        slip, speed = slip_m**2, speed_walk_m_per_s**2
        noise = step_s * np.diag([slip, slip, slip, 0.0, 0.0, speed, 0.0, 0.0])
        # White-noise acceleration of both angles.
        for turned in ([PITCH, PITCH_RATE], [YAW, YAW_RATE]):
            powers = [[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]]
            noise[np.ix_(turned, turned)] = np.radians(turn_walk_deg_per_s) ** 2 * np.array(powers)
        self.step_precision = np.linalg.inv(noise)


class PathProblem(NamedTuple):
    """The images of n approaches of k frames: finite readings, shape ``(n, k, side * side)``."""

    motion: Motion
    readings: Array


class PathState(NamedTuple):
    """The posterior at the path of each of n approaches; `minimiser` wants their axis last."""

    cost: Array  # negative log-posterior without constants, (n,)
    path: Array  # m numbers, (m, n)
    gradient: Array  # of the log-posterior, (m, n)
    information: Array  # by Gauss-Newton, (m, m, n)


@np.errstate(under="ignore")
def evaluate(problem: PathProblem, at: Array) -> PathState:
    """Return the posterior at paths, shape ``(m, n)``, with derivatives."""
    motion, readings = problem
    model = motion.model
    runs, frames = readings.shape[:2]
    path, size = at.T, len(at)
    states, offsets = np.split(path, [STATE * frames], axis=1)
    states = states.reshape(runs, frames, STATE)
    names = model.scene.prior.nuisance_std()
    spread = {name: np.repeat(offsets[:, i, None], frames, 1) for i, name in enumerate(names)}
    light, jacobian = model.linearised(states[..., :5], 0.0, spread)
    values, scores, curvatures = log_likelihood(readings, light, model.noise)
    image_gradient = (scores[..., None, :] @ jacobian)[..., 0, :]
    image_information = np.swapaxes(jacobian * curvatures[..., None], -1, -2) @ jacobian
    later, slopes = predict(states[:, :-1], motion.step_s)
    first, steps = states[:, 0] - motion.first, states[:, 1:] - later
    cost = (first**2 @ motion.first_precision + offsets**2 @ motion.offset_precision) / 2
    cost += (steps @ motion.step_precision * steps).sum(axis=(1, 2)) / 2 - values.sum(axis=(1, 2))
    gradient, information = np.zeros((runs, size)), np.zeros((runs, size, size))
    gradient[:, :STATE] = -first * motion.first_precision
    information[:, range(STATE), range(STATE)] = motion.first_precision
    constants = np.arange(STATE * frames, size)
    gradient[:, constants] = -offsets * motion.offset_precision
    information[:, constants, constants] = motion.offset_precision
    for k in range(frames):
        seen = np.r_[STATE * k : STATE * k + 5, constants]
        gradient[:, seen] += image_gradient[:, k]
        information[:, seen[:, None], seen] += image_information[:, k]
    # A step is the later state less what the earlier one predicts.
    by_both = np.concatenate([-slopes, np.broadcast_to(np.eye(STATE), slopes.shape)], axis=-1)
    weighted = np.swapaxes(by_both, -1, -2) @ motion.step_precision
    for k in range(frames - 1):
        both = slice(STATE * k, STATE * (k + 2))
        gradient[:, both] -= (weighted[:, k] @ steps[:, k, :, None])[..., 0]
        information[:, both, both] += weighted[:, k] @ by_both[:, k]
    return PathState(cost, at, gradient.T, np.moveaxis(information, 0, -1))


def propose(problem: PathProblem, state: PathState, damping: Array) -> tuple[Array, Array]:
    """Return the damped Gauss-Newton step from each path, and its decrement."""
    information = np.moveaxis(state.information, -1, 0).copy()
    diagonal = np.arange(len(state.path))
    information[:, diagonal, diagonal] *= 1 + damping[:, None]
    step = np.linalg.solve(information, state.gradient.T[..., None])[..., 0].T
    return state.path + step, (state.gradient * step).sum(axis=0) / 2


# Moves paths, shape ``(m, n)``, to where they are most probable nearby.
refine = minimiser(evaluate, propose, CONVERGED, MAX_STEPS)


def smoothed(motion: Motion, images: Array, first: Array) -> tuple[Array, Array, Array]:
    """Estimate the newest pose of n approaches after each of k images, counts, ``(n, k, ...)``.

    The search begins at poses near the first ones, ``(n, 5)``. Returned are poses, ``(n, k, 5)``,
    their covariances, and the most probable paths, ``(n, m)``.
    """
    runs, frames = images.shape[:2]
    readings = images.reshape(runs, frames, -1)
    poses, covariances = np.empty((runs, frames, 5)), np.empty((runs, frames, 5, 5))
    path: Array = np.zeros((runs, STATE + len(motion.offset_precision)))
    path[:, :5] = first
    for k in range(frames):
        end = STATE * k
        if k:
            later, _ = predict(path[:, end - STATE : end], motion.step_s)
            path = np.concatenate([path[:, :end], later, path[:, end:]], axis=1)
        state: PathState = refine(PathProblem(motion, readings[:, : k + 1]), path.T)
        path, newest = state.path.T, slice(end, end + 5)
        poses[:, k], covariances[:, k] = path[:, newest], _covariance(state, newest)
    return poses, covariances, path


def bound(motion: Motion, poses: Array) -> Array:
    """Bound the errors, m and rad, ``(frames, 5)``, by all images up to each and the motion.

    The posterior Cramer-Rao bound (P. Tichavsky et al., 1998), linearised along the true poses.
    """
    states = states_along(poses, motion.step_s)
    readings = motion.model.light(states[None, :, :5]).reshape(1, len(states), -1)
    variances = np.empty((len(states), 5))
    for k in range(len(states)):
        at = np.append(states[: k + 1], np.zeros(len(motion.offset_precision)))[:, None]
        state = evaluate(PathProblem(motion, readings[:, : k + 1]), at)
        variances[k] = _covariance(state, slice(STATE * k, STATE * k + 5))[0].diagonal()
    return np.sqrt(variances)


def states_along(poses: Array, step_s: float) -> Array:
    """Return the states along poses ``(frames, 5)``, shape ``(frames, 8)``."""
    states = np.zeros((len(poses), STATE))
    states[:, :5] = poses
    rates = np.diff(poses, axis=0) / step_s
    states[:-1, SPEED] = np.linalg.norm(rates[:, :3], axis=1)
    states[:-1, PITCH_RATE:] = rates[:, PITCH:]
    states[-1, SPEED:] = states[-2, SPEED:]
    return states


def _covariance(state: PathState, part: slice) -> Array:
    """Return the covariance of a part of the paths, shape ``(n, p, p)``."""
    unit = np.eye(len(state.path))[None, :, part]
    return np.asarray(np.linalg.solve(np.moveaxis(state.information, -1, 0), unit)[:, part])
