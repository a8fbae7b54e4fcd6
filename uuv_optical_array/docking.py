"""A smoother of images for the approach to a lamp that stays where it is, such as a dock's.

What frames have in common is worth more than their poses. Lamp and water stay the same during an
approach, so what is not known of them is estimated once, not in every frame anew; and a vehicle
under way moves along its own heading, so that its path says where it points.

The newest pose is the end of the most probable path through the images so far, found by the
iterated Kalman smoother (B. Bell, *The Iterated Kalman Smoother as a Gauss-Newton Method*, 1994)
with the damping of Levenberg and Marquardt (S. Sarkka and L. Svensson, 2020). A filter would keep
what it made of the first images, far away, where the likelihood bends; here they are looked at
again from nearer by.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.image import ForwardModel
from uuv_optical_array.likelihood import log_likelihood
from uuv_optical_array.pose import PITCH, YAW, Array
from uuv_optical_array.quantity import Quantity

# The first pose is known to be behind the lamp, no more.
FIRST_RANGE_M, FIRST_STD = 6.0, np.array([10.0, 5.0, 5.0, 2.0, 2.0])
SPEED, PITCH_RATE, YAW_RATE, MOTION = 5, 6, 7, 8
STEPS = 12  # Gauss-Newton steps that a frame may take
ARRIVED = 5e-3  # gain of the log-posterior below which they end
FREE, GIVE_UP = 1e-2, 1e6  # damping below which a step is free, and beyond which none gains


@dataclass(frozen=True)
class DockingSettings:
    """How the vehicle moves."""

    speed_std_m_per_s: Annotated[
        float, Quantity("speed ahead at the start, about 0", "m/s", 1e-3, 10)
    ] = 1.0
    speed_walk_m_per_s: Annotated[
        float, Quantity("random change of the speed in 1 s", "m/s", 1e-4, 10)
    ] = 0.02
    slip_m: Annotated[float, Quantity("random drift off the heading in 1 s", "m", 1e-4, 10)] = 0.02
    turn_std_deg_per_s: Annotated[
        float, Quantity("turn rate at the start, about 0", "deg/s", 1e-3, 500)
    ] = 5.0
    turn_walk_deg_per_s: Annotated[
        float, Quantity("random change of the turn rate in 1 s", "deg/s", 1e-3, 500)
    ] = 4.0
    frames: Annotated[
        int,
        Quantity("newest frames that are looked at again; older ones are summed up", "", 2, 1e4),
    ] = 100


class _Prior(NamedTuple):
    """What is known of the oldest state kept, before its image."""

    mean: Array  # (n, p)
    covariance: Array  # (n, p, p)


class _Linear(NamedTuple):
    """A Kalman smoother of the problem made linear at a path of k frames."""

    path: Array  # the most probable one, (n, k, p)
    spreads: Array  # covariances given the images up to each frame, (k, n, p, p)
    predicted: Array  # states given the images before each frame, (n, k, p)
    widened: Array  # their covariances, (k, n, p, p)


class DockingSmoother:
    """Estimate the poses of n approaches, image after image.

    The state of a frame is the pose, the speed ahead, the rates of pitch and yaw and the
    scene's uncertain settings (its `prior`), which do not change.

    Parameters
    ----------
    model
        Forward model of the scene.
    step_s
        Time between frames, s, > 0.
    settings
        Checked settings.
    """

    def __init__(
        self, model: ForwardModel, step_s: float, settings: DockingSettings | None = None
    ) -> None:
        s = settings or DockingSettings()
        self._model, self._step_s = model, step_s
        nuisance_std = list(model.scene.prior.nuisance_std().values())
        self._names = tuple(model.scene.prior.nuisance_std())
        size = MOTION + len(nuisance_std)
        # What an image sees: pose and settings, but no motion.
        self._seen = np.r_[0:5, MOTION:size]
        turn, walk = np.radians([s.turn_std_deg_per_s, s.turn_walk_deg_per_s])
        self._frames = s.frames
        first = np.zeros(size)
        first[0] = -FIRST_RANGE_M
        first_std = np.array([*FIRST_STD, s.speed_std_m_per_s, turn, turn, *nuisance_std])
        self._start = _Prior(first[None], np.diag(first_std**2)[None])
        self._noise = np.zeros((size, size))
        position, speed = step_s * s.slip_m**2, step_s * s.speed_walk_m_per_s**2
        self._noise[range(3), range(3)], self._noise[SPEED, SPEED] = position, speed
        # White-noise acceleration of both angles.
        for angle, rate in ((PITCH, PITCH_RATE), (YAW, YAW_RATE)):
            self._noise[np.ix_([angle, rate], [angle, rate])] = walk**2 * np.array(
                [[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]]
            )
        self._noise_precision = np.linalg.inv(self._noise[:MOTION, :MOTION])
        self.reset()

    def reset(self) -> None:
        """Forget the approach: the next images start a new one."""
        self._prior = self._start
        self._path: Array | None = None
        self._readings: Array | None = None

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
        if self._path is None or self._readings is None:
            if guess is None:
                raise ValueError("guess: missing; the first images need poses near theirs")
            self._prior = _Prior(*(np.repeat(part, len(images), axis=0) for part in self._start))
            self._path = self._prior.mean[:, None].copy()
            self._path[:, 0, :5] = guess
            self._readings = readings
        else:
            ahead, _ = self._moved(self._path[:, -1])
            self._path = np.concatenate([self._path, ahead[:, None]], axis=1)
            self._readings = np.concatenate([self._readings, readings], axis=1)
        covariances = self._refine()
        poses = self._path[:, -1, :5].copy()
        if self._path.shape[1] == self._frames:
            self._sum_up_the_oldest()
        return poses, covariances

    def _sum_up_the_oldest(self) -> None:
        """Put what the oldest image says into the prior of the next state."""
        assert self._path is not None
        assert self._readings is not None
        _, gradient, information = self._images(self._readings, self._path)
        free = np.zeros(len(self._path))
        linear = self._smoothed(self._path, self._prior, gradient, information, free)
        self._prior = _Prior(linear.predicted[:, 1], linear.widened[1])
        self._path, self._readings = self._path[:, 1:], self._readings[:, 1:]

    def bound(self, poses: ArrayLike) -> Array:
        """Bound what all images up to each frame can tell, with what is known of the motion.

        The posterior Cramer-Rao bound (P. Tichavsky et al., 1998), made linear at a path.

        Parameters
        ----------
        poses
            True poses, m and rad, shape ``(frames, 5)``, frames >= 2.

        Returns
        -------
        Array
            Least standard deviation of each frame's pose, m and rad, shape ``(frames, 5)``.
        """
        poses = np.asarray(poses, dtype=float)
        path = np.zeros((1, len(poses), self._start.mean.shape[1]))
        path[0, :, :5] = poses
        steps = np.diff(poses, axis=0) / self._step_s
        path[0, :-1, SPEED] = np.linalg.norm(steps[:, :3], axis=1)
        path[0, :-1, PITCH_RATE:MOTION] = steps[:, PITCH:]
        path[0, -1, SPEED:MOTION] = path[0, -2, SPEED:MOTION]
        light = self._model.light(path[..., :5])
        readings = light.reshape(1, len(poses), -1)
        _, gradient, information = self._images(readings, path)
        spreads = self._smoothed(path, self._start, gradient, information, np.zeros(1)).spreads
        return np.sqrt(np.diagonal(spreads[:, 0, :5, :5], axis1=1, axis2=2))

    def _moved(self, states: Array) -> tuple[Array, Array]:
        """Return the states a step later, shape ``(..., p)``, and their derivatives."""
        step_s = self._step_s
        pitch, yaw = (
            states[..., angle] + step_s / 2 * states[..., rate]
            for angle, rate in ((PITCH, PITCH_RATE), (YAW, YAW_RATE))
        )
        sin_p, cos_p, sin_y, cos_y = np.sin(pitch), np.cos(pitch), np.sin(yaw), np.cos(yaw)
        way = step_s * states[..., SPEED, None]
        heading = np.stack([cos_p * cos_y, cos_p * sin_y, -sin_p], axis=-1)
        by_pitch = way * np.stack([-sin_p * cos_y, -sin_p * sin_y, -cos_p], axis=-1)
        by_yaw = way * np.stack([-cos_p * sin_y, cos_p * cos_y, np.zeros_like(yaw)], axis=-1)
        ahead = states.copy()
        ahead[..., :3] += way * heading
        ahead[..., PITCH:SPEED] += step_s * states[..., PITCH_RATE:MOTION]
        size = states.shape[-1]
        slope = np.broadcast_to(np.eye(size), (*states.shape, size)).copy()
        slope[..., :3, PITCH], slope[..., :3, YAW] = by_pitch, by_yaw
        slope[..., :3, SPEED] = step_s * heading
        slope[..., :3, PITCH_RATE] = step_s / 2 * by_pitch
        slope[..., :3, YAW_RATE] = step_s / 2 * by_yaw
        slope[..., PITCH, PITCH_RATE] = slope[..., YAW, YAW_RATE] = step_s
        return ahead, slope

    @np.errstate(under="ignore")
    def _refine(self) -> Array:
        """Bring the paths to the most probable ones; return the covariances of their ends."""
        assert self._path is not None
        assert self._readings is not None
        count = len(self._path)
        covariances, damping = np.empty((count, 5, 5)), np.zeros(count)
        cost, gradient, information = self._images(self._readings, self._path)
        cost += self._motion_cost(self._path, self._prior)
        active: NDArray[np.intp] = np.arange(count)
        for _ in range(STEPS):
            path, at = self._path[active], damping[active]
            prior = _Prior(*(part[active] for part in self._prior))
            linear = self._smoothed(path, prior, gradient[active], information[active], at)
            trial, free = linear.path, at < FREE
            covariances[active[free]] = linear.spreads[-1][free, :5, :5]
            new = self._images(self._readings[active], trial)
            gain = cost[active] - new[0] - self._motion_cost(trial, prior)
            better = gain > 0
            taken = active[better]
            self._path[taken] = trial[better]
            cost[taken] -= gain[better]
            gradient[taken], information[taken] = new[1][better], new[2][better]
            damping[active] = np.where(better, at * 0.1 * (at > 1e-4), np.maximum(10 * at, FREE))
            # Only an undamped step proves that nothing is to gain.
            arrived = (np.abs(gain) < ARRIVED) & free | (damping[active] > GIVE_UP)
            active = active[~arrived]
            if not len(active):
                break
        return covariances

    def _images(self, readings: Array, path: Array) -> tuple[Array, Array, Array]:
        """Return the images' negative log-likelihood, gradient of its opposite and information."""
        offsets = {name: path[..., MOTION + i] for i, name in enumerate(self._names)}
        light, jacobian = self._model.linearised(path[..., :5], 0.0, offsets)
        variance, slope = self._model.variance(light)
        value, score, curvature = log_likelihood(
            readings, light, variance, slope, self._model.limits
        )
        gradient = (score[..., None, :] @ jacobian)[..., 0, :]
        information = np.swapaxes(jacobian * curvature[..., None], -1, -2) @ jacobian
        return -value.sum(axis=1), gradient, information

    def _motion_cost(self, path: Array, prior: _Prior) -> Array:
        """Return the negative log-prior of paths, without constants, shape ``(n,)``."""
        first = (path[:, 0] - prior.mean)[..., None]
        begun = (np.swapaxes(first, 1, 2) @ np.linalg.solve(prior.covariance, first))[:, 0, 0]
        ahead, _ = self._moved(path[:, :-1])
        off = (path[:, 1:] - ahead)[..., :MOTION]
        walked = np.einsum("nki,ij,nkj->n", off, self._noise_precision, off)
        return 0.5 * (begun + walked)

    def _smoothed(
        self, path: Array, prior: _Prior, gradient: Array, information: Array, damping: Array
    ) -> _Linear:
        """Take a Gauss-Newton step from `path`."""
        count, frames, size = path.shape
        ahead, slopes = self._moved(path[:, :-1])
        means, predicted = np.empty_like(path), np.empty_like(path)
        spreads = np.empty((frames, count, size, size))
        widened = np.empty_like(spreads)
        diagonal, seen = np.arange(size), self._seen
        for k in range(frames):
            if k == 0:
                predicted[:, 0], widened[0] = prior
            else:
                slope = slopes[:, k - 1]
                off = means[:, k - 1] - path[:, k - 1]
                predicted[:, k] = ahead[:, k - 1] + (slope @ off[..., None])[..., 0]
                widened[k] = slope @ spreads[k - 1] @ np.swapaxes(slope, 1, 2) + self._noise
            joint = np.linalg.inv(widened[k])
            pull = (joint @ (predicted[:, k] - path[:, k])[..., None])[..., 0]
            pull[:, seen] += gradient[:, k]
            joint[:, seen[:, None], seen] += information[:, k]
            joint[:, diagonal, diagonal] *= 1 + damping[:, None]
            spreads[k] = np.linalg.inv(joint)
            means[:, k] = path[:, k] + (spreads[k] @ pull[..., None])[..., 0]
        smoothed = means.copy()
        for k in range(frames - 2, -1, -1):
            # The gain is spread slope' widened^-1.
            off = np.linalg.solve(
                widened[k + 1], (smoothed[:, k + 1] - predicted[:, k + 1])[..., None]
            )
            back = np.swapaxes(slopes[:, k], 1, 2) @ off
            smoothed[:, k] += (spreads[k] @ back)[..., 0]
        # What does not change is known best at the end.
        smoothed[..., MOTION:] = smoothed[:, -1:, MOTION:]
        return _Linear(smoothed, spreads, predicted, widened)
