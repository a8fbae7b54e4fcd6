"""A smoother of images for the approach to a lamp that stays where it is, such as a dock's.

What frames have in common is worth more than their poses. Lamp and water stay the same during an
approach, so what is not known of them is estimated once, not in every frame anew; and a vehicle
under way moves along its own heading, so that its path says where it points.

The newest pose is the end of the most probable path through the images so far. A filter would keep
what it made of the first images, far away, where the likelihood bends; here they are looked at
again from nearer by.
"""

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.tracking.docking.motion import (
    DockingMotion,
    DockingSettings,
    StatePrior,
)
from uuv_optical_array.estimation.tracking.docking.path import (
    PathProblem,
    PathState,
    approaches_first,
    approaches_last,
    evaluate,
    filtered,
    refine,
)
from uuv_optical_array.forward.model import ForwardModel


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
        self._model, self._frames = model, chosen.frames
        self._motion = DockingMotion(step_s, [*nuisance_std.values()], chosen)
        self.reset()

    def reset(self) -> None:
        """Forget the approach: the next images start a new one."""
        self._problem: PathProblem | None = None
        self._path: Array = np.empty((0, 0, 0))

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
            start = self._motion.start
            prior = StatePrior(*(np.repeat(part, len(images), axis=0) for part in start))
            self._problem = PathProblem(self._model, self._motion, prior, readings)
            path = prior.mean[:, None].copy()
            path[:, 0, :5] = guess
        else:
            readings = np.concatenate([self._problem.readings, readings], axis=1)
            self._problem = self._problem._replace(readings=readings)
            ahead, _ = self._motion.moved(self._path[:, -1:])
            path = np.concatenate([self._path, ahead], axis=1)
        state: PathState = refine(self._problem, approaches_last(path))
        known = filtered(self._problem, state, np.zeros(len(images)))
        self._path = approaches_first(state.path)
        poses = self._path[:, -1, :5].copy()
        covariances = known.spreads[-1][:, :5, :5]
        if self._path.shape[1] == self._frames:
            # What the oldest image says goes into the prior of the next state.
            prior = StatePrior(known.predicted[:, 1], known.widened[1])
            self._problem = self._problem._replace(
                prior=prior, readings=self._problem.readings[:, 1:]
            )
            self._path = self._path[:, 1:]
        return poses, covariances

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
        readings = self._model.light(path[..., :5]).reshape(*path.shape[:2], -1)
        problem = PathProblem(self._model, self._motion, self._motion.start, readings)
        known = filtered(problem, evaluate(problem, approaches_last(path)), np.zeros(1))
        return np.sqrt(np.diagonal(known.spreads[:, 0, :5, :5], axis1=1, axis2=2))
