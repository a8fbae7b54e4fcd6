"""A smoother of images for the approach to a lamp that stays where it is, such as a dock's.

Lamp and water do not change during an approach, so their uncertain settings are estimated once for
all frames; and a vehicle under way moves along its own heading, so that its path tells its
attitude. The newest pose is the end of the most probable path through the images so far. A filter
would keep its linearisation of the first images, taken far away where the likelihood is most
curved; here they are linearised again as the path gets better known.

The path is found by the iterated Kalman smoother (B. Bell, *The Iterated Kalman Smoother as a
Gauss-Newton Method*, 1994) with the damping of Levenberg and Marquardt (S. Sarkka and L. Svensson,
2020): each step filters and smooths the problem linearised about the path.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import PITCH, YAW, Array
from uuv_optical_array.core.numerics.gauss_newton import minimiser
from uuv_optical_array.estimation.information.likelihood import log_likelihood
from uuv_optical_array.forward.model import ForwardModel

# The first pose is known to be behind the lamp, no more.
FIRST_RANGE_M, FIRST_STD = 6.0, np.array([10.0, 5.0, 5.0, 2.0, 2.0])
# A state is the pose, these three, and from `CONSTANTS` on the offsets of the uncertain settings.
SPEED, PITCH_RATE, YAW_RATE, CONSTANTS = 5, 6, 7, 8
MAX_STEPS = 12
CONVERGED = 5e-3  # decrement of the negative log-posterior below which a step is the last


@dataclass(frozen=True)
class DockingSettings:
    """How the vehicle moves.

    Parameters
    ----------
    speed_std_m_per_s, turn_std_deg_per_s
        Standard deviations of the speed ahead and of each turn rate at the start, about 0.
    speed_walk_m_per_s, turn_walk_deg_per_s
        Random change of speed and turn rates in 1 s.
    slip_m
        Random drift off the heading in 1 s, m.
    frames
        How many of the newest frames are linearised again, >= 2; older ones are summed up.
    """

    speed_std_m_per_s: float = 1.0
    speed_walk_m_per_s: float = 0.02
    slip_m: float = 0.02
    turn_std_deg_per_s: float = 5.0
    turn_walk_deg_per_s: float = 4.0
    frames: int = 100


class StatePrior(NamedTuple):
    """Mean, shape ``(n, p)``, and covariance, shape ``(n, p, p)``, of n first states."""

    mean: Array
    covariance: Array


class DockingMotion:
    """The motion of vehicles from frame to frame, and what is known of it without images.

    Parameters
    ----------
    step_s
        Time between frames, s, > 0.
    constant_std
        Standard deviations of the constant offsets, about 0.
    settings
        How the vehicle moves.

    Attributes
    ----------
    start
        Prior of the first state of one approach.
    noise
        Covariance that a step adds, shape ``(p, p)``.
    """

    def __init__(
        self, step_s: float, constant_std: Sequence[float], settings: DockingSettings
    ) -> None:
        s, size = settings, CONSTANTS + len(constant_std)
        self.step_s = step_s
        turn, walk = np.radians([s.turn_std_deg_per_s, s.turn_walk_deg_per_s])
        mean = np.zeros(size)
        mean[0] = -FIRST_RANGE_M
        std = np.array([*FIRST_STD, s.speed_std_m_per_s, turn, turn, *constant_std])
        self.start = StatePrior(mean[None], np.diag(std**2)[None])
        self.noise = np.zeros((size, size))
        self.noise[range(3), range(3)] = step_s * s.slip_m**2
        self.noise[SPEED, SPEED] = step_s * s.speed_walk_m_per_s**2
        # White-noise acceleration of both angles.
        for angle, rate in ((PITCH, PITCH_RATE), (YAW, YAW_RATE)):
            self.noise[np.ix_([angle, rate], [angle, rate])] = walk**2 * np.array(
                [[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]]
            )
        self._precision = np.linalg.inv(self.noise[:CONSTANTS, :CONSTANTS])

    def predict(self, states: Array) -> tuple[Array, Array]:
        """Return the states one step later, shape ``(..., p)``, and their derivatives."""
        step_s = self.step_s
        pitch, yaw = (
            states[..., angle] + step_s / 2 * states[..., rate]
            for angle, rate in ((PITCH, PITCH_RATE), (YAW, YAW_RATE))
        )
        sin_p, cos_p, sin_y, cos_y = np.sin(pitch), np.cos(pitch), np.sin(yaw), np.cos(yaw)
        way = step_s * states[..., SPEED, None]
        heading = np.stack([cos_p * cos_y, cos_p * sin_y, -sin_p], axis=-1)
        by_pitch = way * np.stack([-sin_p * cos_y, -sin_p * sin_y, -cos_p], axis=-1)
        by_yaw = way * np.stack([-cos_p * sin_y, cos_p * cos_y, np.zeros_like(yaw)], axis=-1)
        later = states.copy()
        later[..., :3] += way * heading
        later[..., PITCH:SPEED] += step_s * states[..., PITCH_RATE:CONSTANTS]
        size = states.shape[-1]
        slope = np.broadcast_to(np.eye(size), (*states.shape, size)).copy()
        slope[..., :3, PITCH], slope[..., :3, YAW] = by_pitch, by_yaw
        slope[..., :3, SPEED] = step_s * heading
        slope[..., :3, PITCH_RATE] = step_s / 2 * by_pitch
        slope[..., :3, YAW_RATE] = step_s / 2 * by_yaw
        slope[..., PITCH, PITCH_RATE] = slope[..., YAW, YAW_RATE] = step_s
        return later, slope

    def cost(self, path: Array, prior: StatePrior) -> Array:
        """Return the negative log-prior of paths ``(n, k, p)``, without constants, ``(n,)``."""
        off = (path[:, 0] - prior.mean)[..., None]
        first = (np.swapaxes(off, 1, 2) @ np.linalg.solve(prior.covariance, off))[:, 0, 0]
        later, _ = self.predict(path[:, :-1])
        steps = (path[:, 1:] - later)[..., :CONSTANTS]
        return 0.5 * (first + np.einsum("nki,ij,nkj->n", steps, self._precision, steps))

    def along(self, poses: Array) -> Array:
        """Return the states along poses ``(frames, 5)``, shape ``(1, frames, p)``."""
        path = np.zeros((1, len(poses), len(self.noise)))
        path[0, :, :5] = poses
        rates = np.diff(poses, axis=0) / self.step_s
        path[0, :-1, SPEED] = np.linalg.norm(rates[:, :3], axis=1)
        path[0, :-1, PITCH_RATE:CONSTANTS] = rates[:, PITCH:]
        path[0, -1, SPEED:CONSTANTS] = path[0, -2, SPEED:CONSTANTS]
        return path


class PathProblem(NamedTuple):
    """The images of n approaches of k frames: finite readings, shape ``(n, k, side * side)``."""

    model: ForwardModel
    motion: DockingMotion
    prior: StatePrior
    readings: Array


class PathState(NamedTuple):
    """The posterior at one path of each approach; `minimiser` wants their axis last.

    Parameters
    ----------
    cost
        Negative log-posterior, without constants, shape ``(n,)``.
    path
        States of p numbers, shape ``(k, p, n)``.
    gradient, information
        Of each image's log-likelihood by pose and constants (s in all), shapes ``(k, s, n)`` and
        ``(k, s, s, n)``; the information is that of Gauss-Newton.
    motion_cost
        Share of the motion in the cost, shape ``(n,)``.
    """

    cost: Array
    path: Array
    gradient: Array
    information: Array
    motion_cost: Array


class FilteredPath(NamedTuple):
    """A Kalman filter of the problem linearised about a path.

    Parameters
    ----------
    means, covariances
        Of the states given the images up to each frame, shapes ``(n, k, p)`` and ``(k, n, p, p)``.
    predicted, predicted_covariances
        The same given the images before each frame.
    slopes
        Of each state by the one before it, shape ``(n, k - 1, p, p)``.
    decrement
        Fall of the cost that the quadratic model promises, shape ``(n,)``.
    """

    means: Array
    covariances: Array
    predicted: Array
    predicted_covariances: Array
    slopes: Array
    decrement: Array


@np.errstate(under="ignore")
def evaluate(problem: PathProblem, at: Array) -> PathState:
    """Return the posterior at paths, shape ``(k, p, n)``, with derivatives."""
    path, model = np.moveaxis(at, -1, 0), problem.model
    offsets = {
        name: path[..., CONSTANTS + i] for i, name in enumerate(model.scene.prior.nuisance_std())
    }
    light, jacobian = model.linearised(path[..., :5], 0.0, offsets)
    values, scores, curvatures = log_likelihood(problem.readings, light, model.noise)
    gradient = (scores[..., None, :] @ jacobian)[..., 0, :]
    information = np.swapaxes(jacobian * curvatures[..., None], -1, -2) @ jacobian
    motion_cost = problem.motion.cost(path, problem.prior)
    cost = motion_cost - values.sum(axis=(1, 2))
    gradient, information = np.moveaxis(gradient, 0, -1), np.moveaxis(information, 0, -1)
    return PathState(cost, at, gradient, information, motion_cost)


@np.errstate(under="ignore")
def _filtered(problem: PathProblem, state: PathState, damping: Array) -> FilteredPath:
    """Filter the problem linearised about the paths of a state; damping as in `minimiser`."""
    motion = problem.motion
    path, gradient, information = (
        np.moveaxis(part, -1, 0) for part in (state.path, state.gradient, state.information)
    )
    count, frames, size = path.shape
    later, slopes = motion.predict(path[:, :-1])
    means, predicted = np.empty_like(path), np.empty_like(path)
    covariances, predicted_covariances = np.empty((2, frames, count, size, size))
    diagonal, observed = np.arange(size), np.r_[0:5, CONSTANTS:size]
    decrement = state.motion_cost.copy()
    for k in range(frames):
        if k == 0:
            predicted[:, 0], predicted_covariances[0] = problem.prior
        else:
            slope = slopes[:, k - 1]
            off = means[:, k - 1] - path[:, k - 1]
            predicted[:, k] = later[:, k - 1] + (slope @ off[..., None])[..., 0]
            predicted_covariances[k] = (
                slope @ covariances[k - 1] @ np.swapaxes(slope, 1, 2) + motion.noise
            )
        precision = np.linalg.inv(predicted_covariances[k])
        off = predicted[:, k] - path[:, k]
        pull = (precision @ off[..., None])[..., 0]
        decrement -= 0.5 * (pull * off).sum(axis=1)
        pull[:, observed] += gradient[:, k]
        precision[:, observed[:, None], observed] += information[:, k]
        precision[:, diagonal, diagonal] *= 1 + damping[:, None]
        covariances[k] = np.linalg.inv(precision)
        step = (covariances[k] @ pull[..., None])[..., 0]
        decrement += 0.5 * (pull * step).sum(axis=1)
        means[:, k] = path[:, k] + step
    return FilteredPath(means, covariances, predicted, predicted_covariances, slopes, decrement)


@np.errstate(under="ignore")
def _smoothed(filtered: FilteredPath) -> Array:
    """Return the most probable paths given all images, shape ``(n, k, p)``."""
    path = filtered.means.copy()
    for k in range(path.shape[1] - 2, -1, -1):
        # The gain is covariance slope' predicted_covariance^-1.
        off = (path[:, k + 1] - filtered.predicted[:, k + 1])[..., None]
        off = np.linalg.solve(filtered.predicted_covariances[k + 1], off)
        back = np.swapaxes(filtered.slopes[:, k], 1, 2) @ off
        path[:, k] += (filtered.covariances[k] @ back)[..., 0]
    # The constants are known best at the end.
    path[..., CONSTANTS:] = path[:, -1:, CONSTANTS:]
    return path


def propose(problem: PathProblem, state: PathState, damping: Array) -> tuple[Array, Array]:
    """Return the damped Gauss-Newton step from each path, and its decrement."""
    filtered = _filtered(problem, state, damping)
    return np.moveaxis(_smoothed(filtered), 0, -1), filtered.decrement


# Moves paths, shape ``(k, p, n)``, to where they are most probable nearby.
refine = minimiser(evaluate, propose, CONVERGED, MAX_STEPS)


class DockingSmoother:
    """Estimate the poses of n approaches, image after image.

    The state of a frame is the pose, the speed ahead, the rates of pitch and yaw and the constant
    offsets of the scene's uncertain settings (its `prior`).

    Parameters
    ----------
    model
        Forward model of the scene.
    step_s
        Time between frames, s, > 0.
    settings
        How the vehicle moves.

    Attributes
    ----------
    path
        States of the frames that are linearised again, shape ``(n, k, p)``.
    """

    def __init__(
        self, model: ForwardModel, step_s: float, settings: DockingSettings | None = None
    ) -> None:
        settings = settings or DockingSettings()
        nuisance_std = model.scene.prior.nuisance_std()
        self._model, self._frames = model, settings.frames
        self._motion = DockingMotion(step_s, [*nuisance_std.values()], settings)
        self.reset()

    def reset(self) -> None:
        """Forget the approach: the next images start a new one."""
        self._problem: PathProblem | None = None
        self.path: Array = np.empty((0, 0, 0))

    def update(self, images: ArrayLike, guess: ArrayLike | None = None) -> tuple[Array, Array]:
        """Take the next image of each approach.

        Parameters
        ----------
        images
            Readings in counts, finite, shape ``(n, side, side)``.
        guess
            Poses near those of the first images, such as an `Estimator` finds, m and rad, shape
            ``(n, 5)``; needed at the start only.

        Returns
        -------
        poses : Array
            Of these images, m and rad, shape ``(n, 5)``.
        covariances : Array
            Shape ``(n, 5, 5)``.

        Raises
        ------
        ValueError
            At the start, without a guess.
        """
        images = np.asarray(images, dtype=float)
        readings = images.reshape(len(images), 1, -1)
        if self._problem is None:
            if guess is None:
                raise ValueError("guess: missing; the first images need poses near theirs")
            prior = StatePrior(*(np.repeat(part, len(images), 0) for part in self._motion.start))
            problem = PathProblem(self._model, self._motion, prior, readings)
            path = prior.mean[:, None].copy()
            path[:, 0, :5] = guess
        else:
            readings = np.concatenate([self._problem.readings, readings], axis=1)
            problem = self._problem._replace(readings=readings)
            path = np.concatenate([self.path, self._motion.predict(self.path[:, -1:])[0]], axis=1)
        state: PathState = refine(problem, np.moveaxis(path, 0, -1))
        filtered = _filtered(problem, state, np.zeros(len(images)))
        self.path = np.moveaxis(state.path, -1, 0)
        poses, covariances = self.path[:, -1, :5].copy(), filtered.covariances[-1][:, :5, :5]
        if self.path.shape[1] == self._frames:
            # The information of the oldest image goes into the prior of the next state.
            prior = StatePrior(filtered.predicted[:, 1], filtered.predicted_covariances[1])
            problem = problem._replace(prior=prior, readings=problem.readings[:, 1:])
            self.path = self.path[:, 1:]
        self._problem = problem
        return poses, covariances

    def bound(self, poses: ArrayLike) -> Array:
        """Bound the errors from all images up to each frame and the motion.

        The posterior Cramer-Rao bound (P. Tichavsky et al., 1998), linearised along a path.

        Parameters
        ----------
        poses
            True poses, m and rad, shape ``(frames, 5)``, frames >= 2.

        Returns
        -------
        Array
            Least standard deviation of each frame's pose, m and rad, shape ``(frames, 5)``.
        """
        path = self._motion.along(np.asarray(poses, dtype=float))
        readings = self._model.light(path[..., :5]).reshape(*path.shape[:2], -1)
        problem = PathProblem(self._model, self._motion, self._motion.start, readings)
        state = evaluate(problem, np.moveaxis(path, 0, -1))
        covariances = _filtered(problem, state, np.zeros(1)).covariances
        return np.sqrt(np.diagonal(covariances[:, 0, :5, :5], axis1=1, axis2=2))
