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

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.docking.motion import (
    MOTION,
    DockingMotion,
    DockingSettings,
    Prior,
)
from uuv_optical_array.estimation.likelihood import log_likelihood
from uuv_optical_array.forward.model import ForwardModel

STEPS = 12  # Gauss-Newton steps that a frame may take
ARRIVED = 5e-3  # gain of the log-posterior below which they end
FREE, GIVE_UP = 1e-2, 1e6  # damping below which a step is free, and beyond which none gains


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
        chosen = settings or DockingSettings()
        nuisance_std = model.scene.prior.nuisance_std()
        self._model, self._names, self._frames = model, tuple(nuisance_std), chosen.frames
        self._motion = DockingMotion(step_s, [*nuisance_std.values()], chosen)
        # What an image sees: pose and settings, but no motion.
        self._seen = np.r_[0:5, MOTION : MOTION + len(nuisance_std)]
        self.reset()

    def reset(self) -> None:
        """Forget the approach: the next images start a new one."""
        self._prior = self._motion.start
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
            self._prior = Prior(
                *(np.repeat(part, len(images), axis=0) for part in self._motion.start)
            )
            self._path = self._prior.mean[:, None].copy()
            self._path[:, 0, :5] = guess
            self._readings = readings
        else:
            ahead, _ = self._motion.moved(self._path[:, -1])
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
        self._prior = Prior(linear.predicted[:, 1], linear.widened[1])
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
        path = self._motion.along(np.asarray(poses, dtype=float))
        light = self._model.light(path[..., :5])
        readings = light.reshape(*path.shape[:2], -1)
        _, gradient, information = self._images(readings, path)
        spreads = self._smoothed(
            path, self._motion.start, gradient, information, np.zeros(1)
        ).spreads
        return np.sqrt(np.diagonal(spreads[:, 0, :5, :5], axis1=1, axis2=2))

    @np.errstate(under="ignore")
    def _refine(self) -> Array:
        """Bring the paths to the most probable ones; return the covariances of their ends."""
        assert self._path is not None
        assert self._readings is not None
        count = len(self._path)
        covariances, damping = np.empty((count, 5, 5)), np.zeros(count)
        cost, gradient, information = self._images(self._readings, self._path)
        cost += self._motion.cost(self._path, self._prior)
        active: NDArray[np.intp] = np.arange(count)
        for _ in range(STEPS):
            path, at = self._path[active], damping[active]
            prior = Prior(*(part[active] for part in self._prior))
            linear = self._smoothed(path, prior, gradient[active], information[active], at)
            trial, free = linear.path, at < FREE
            covariances[active[free]] = linear.spreads[-1][free, :5, :5]
            new = self._images(self._readings[active], trial)
            gain = cost[active] - new[0] - self._motion.cost(trial, prior)
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
        value, score, curvature = log_likelihood(readings, light, self._model.noise)
        gradient = (score[..., None, :] @ jacobian)[..., 0, :]
        information = np.swapaxes(jacobian * curvature[..., None], -1, -2) @ jacobian
        return -value.sum(axis=(1, 2)), gradient, information

    def _smoothed(
        self, path: Array, prior: Prior, gradient: Array, information: Array, damping: Array
    ) -> _Linear:
        """Take a Gauss-Newton step from `path`."""
        count, frames, size = path.shape
        ahead, slopes = self._motion.moved(path[:, :-1])
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
                widened[k] = slope @ spreads[k - 1] @ np.swapaxes(slope, 1, 2) + self._motion.noise
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
