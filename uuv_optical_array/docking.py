"""A filter of images for the approach to a lamp that stays where it is.

What frames have in common is worth more than their poses. Lamp and water stay the same during an
approach, so they are part of the state, not of every frame anew; and a vehicle under way moves
along its own heading, so its path says where it points. The state is kept in the chart, in which
an image is nearly linear, and each image is taken in by Gauss-Newton steps on its exact
likelihood (B. Bell and F. Cathey, *The Iterated Kalman Filter Update as a Gauss-Newton Method*,
1993).
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.chart import Chart
from uuv_optical_array.image import ForwardModel
from uuv_optical_array.likelihood import log_likelihood
from uuv_optical_array.pose import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.quantity import Quantity

# In the chart, at the start: so wide that the first image decides.
FIRST_STD = 3.0
STEPS = 8  # Gauss-Newton steps that an image may take
ARRIVED = 1e-4  # Newton decrement below which they end
DIFFERENCE = 1e-4  # step of the central differences, m and rad
MAX_DECREMENT = 12.5  # longest step: five standard deviations


@dataclass(frozen=True)
class DockingSettings:
    """How the vehicle moves."""

    speed_std_m_per_s: Annotated[
        float, Quantity("speed ahead at the start, about 0", "m/s", 1e-3, 10)
    ] = 1.0
    speed_walk_m_per_s: Annotated[
        float, Quantity("random change of the speed in 1 s", "m/s", 1e-4, 10)
    ] = 0.02
    slip_m: Annotated[
        float, Quantity("random drift off the heading in 1 s", "m", 1e-5, 10)
    ] = 0.02
    turn_std_deg_per_s: Annotated[
        float, Quantity("turn rate at the start, about 0", "deg/s", 1e-3, 500)
    ] = 5.0
    turn_walk_deg_per_s: Annotated[
        float, Quantity("random change of the turn rate in 1 s", "deg/s", 1e-3, 500)
    ] = 4.0


class DockingFilter:
    """Filter the images of n approaches at once.

    The state is the chart's five coordinates, the scene's uncertain settings (its `prior`), the
    speed ahead and the rates of pitch and yaw.

    Parameters
    ----------
    model
        Forward model of the scene.
    settings
        Checked settings.
    """

    def __init__(self, model: ForwardModel, settings: DockingSettings | None = None) -> None:
        self.model = model
        self.settings = s = settings or DockingSettings()
        stds = model.scene.prior.nuisance_std()
        self._names = tuple(stds)
        self._moving = 5 + len(stds)  # where speed and rates begin
        self._chart = Chart(
            model.array.positions.mean(axis=0),
            float(np.radians(model.scene.lamp.beam_sigma_deg)),
            model.scene.effects.get("attenuation", {}).get("k_per_m", 0.0),
        )
        turn = np.radians(s.turn_std_deg_per_s)
        first = [FIRST_STD] * 5 + list(stds.values()) + [s.speed_std_m_per_s, turn, turn]
        self._first = np.diag(np.square(first))
        walk = np.radians(s.turn_walk_deg_per_s)
        self._walk = np.square([s.slip_m] * 3 + [s.speed_walk_m_per_s, walk, walk])
        self._mean: Array | None = None

    def reset(self) -> None:
        """Forget the approach: the next images start a new one."""
        self._mean = None

    def update(
        self, images: ArrayLike, step_s: float, guess: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Take the next image of each approach.

        Parameters
        ----------
        images
            Readings in counts, finite, shape ``(n, side, side)``.
        step_s
            Time since the images before, s, > 0; not used at the start.
        guess
            Poses near those of the first images, such as an `Estimator` finds, m and rad, shape
            ``(n, 5)``; needed at the start only.

        Returns
        -------
        poses : Array
            Mean of what is possible, m and rad, shape ``(n, 5)``.
        covariances : Array
            Shape ``(n, 5, 5)``.

        Raises
        ------
        ValueError
            At the start, without a guess.
        """
        readings = np.asarray(images, dtype=float)
        readings = readings.reshape(len(readings), -1)
        if self._mean is None:
            if guess is None:
                raise ValueError("guess: missing; the first images need poses near theirs")
            self._mean = np.zeros((len(readings), len(self._first)))
            self._mean[:, :5] = self._chart.from_pose(np.asarray(guess, dtype=float), 0.0)
            self._covariance = np.broadcast_to(self._first, (len(readings), *self._first.shape))
        else:
            self._predict(step_s)
        self._take(readings)
        return self._poses()

    def _predict(self, step_s: float) -> None:
        assert self._mean is not None
        state, at = self._mean, self._moving
        size = state.shape[1]
        # What the motion depends on: the chart, speed and rates, and the drift along three axes.
        motion = np.concatenate(
            [state[:, :5], state[:, at:], np.zeros((len(state), 3))], axis=1
        )
        nudges = DIFFERENCE * np.eye(11)
        moved = self._moved(
            np.concatenate([motion[None], motion + nudges[:, None], motion - nudges[:, None]]),
            step_s,
        )
        slopes = np.moveaxis(moved[1:12] - moved[12:], 0, -1) / (2 * DIFFERENCE)
        ahead = np.broadcast_to(np.eye(size), (len(state), size, size)).copy()
        ahead[:, :5, :5], ahead[:, :5, at:] = slopes[..., :5], slopes[..., 5:8]
        noise = np.zeros((len(state), size, 6))
        noise[:, :5, :3] = slopes[..., 8:]
        noise[:, at:, 3:] = np.eye(3)
        spread = (noise * (self._walk * step_s)) @ np.swapaxes(noise, 1, 2)
        self._covariance = ahead @ self._covariance @ np.swapaxes(ahead, 1, 2) + spread
        self._mean = state.copy()
        self._mean[:, :5] = moved[0]

    def _moved(self, motion: Array, step_s: float) -> Array:
        """Return the chart's coordinates a step later, shape ``(..., 5)``."""
        poses, _, _ = self._chart.to_pose(motion[..., :5], 0.0)
        turn = step_s * motion[..., 6:8]
        # The chord of an arc points where the vehicle does half-way.
        middle = poses[..., PITCH:] + turn / 2
        heading = rotation_matrix(middle[..., 0], middle[..., 1])[..., 0]
        poses[..., :3] += step_s * motion[..., 5, None] * heading + motion[..., 8:]
        poses[..., PITCH:] += turn
        return self._chart.from_pose(poses, 0.0)

    @np.errstate(under="ignore")
    def _take(self, readings: Array) -> None:
        """Bring the state to the most probable one after the readings."""
        assert self._mean is not None
        prior, state = self._mean, self._mean.copy()
        precision = np.linalg.inv(self._covariance)
        cost, gradient, information = self._evaluate(readings, state, prior, precision)
        damping = np.zeros(len(state))
        diagonal = np.arange(state.shape[1])
        for _ in range(STEPS):
            damped = information.copy()
            damped[:, diagonal, diagonal] *= 1 + damping[:, None]
            step = np.linalg.solve(damped, gradient[..., None])[..., 0]
            decrement = 0.5 * (gradient * step).sum(axis=1)
            if (decrement < ARRIVED).all():
                break
            step *= np.minimum(1.0, np.sqrt(MAX_DECREMENT / np.maximum(decrement, 1e-300)))[:, None]
            new = self._evaluate(readings, state + step, prior, precision)
            better = new[0] <= cost
            state[better] += step[better]
            for mine, other in zip((cost, gradient, information), new, strict=True):
                mine[better] = other[better]
            damping = np.where(better, damping * 0.1, np.maximum(10 * damping, 1e-2))
        self._mean, self._covariance = state, np.linalg.inv(information)

    def _evaluate(
        self, readings: Array, state: Array, prior: Array, precision: Array
    ) -> tuple[Array, Array, Array]:
        """Return negative log-posterior, gradient of its opposite, and information."""
        lamp, axis, by_chart = self._chart.to_lamp(state[:, :5], 0.0)
        offsets = {name: state[:, 5 + i] for i, name in enumerate(self._names)}
        light, by_lamp = self.model.linearised_by_lamp(lamp, axis, offsets)
        variance, slope = self.model.variance(light)
        value, score, curvature = log_likelihood(
            readings, light, variance, slope, self.model.limits
        )
        jacobian = np.concatenate([by_lamp[..., :6] @ by_chart, by_lamp[..., 6:]], axis=-1)
        off = state - prior
        pull = (precision @ off[..., None])[..., 0]
        gradient, information = -pull, precision.copy()
        seen = self._moving
        gradient[:, :seen] += (score[:, None, :] @ jacobian)[:, 0, :]
        information[:, :seen, :seen] += (
            np.swapaxes(jacobian * curvature[..., None], 1, 2) @ jacobian
        )
        return 0.5 * (off * pull).sum(axis=1) - value, gradient, information

    def _poses(self) -> tuple[Array, Array]:
        """Carry mean and covariance from the chart to the pose, by cubature."""
        assert self._mean is not None
        root = np.linalg.cholesky(self._covariance[:, :5, :5])
        points = np.sqrt(5.0) * np.concatenate([np.eye(5), -np.eye(5)])
        coordinates = self._mean[None, :, :5] + np.moveaxis(points @ np.swapaxes(root, 1, 2), 1, 0)
        poses, _, _ = self._chart.to_pose(coordinates, 0.0)
        mean = poses.mean(axis=0)
        off = poses - mean
        return mean, np.einsum("kni,knj->nij", off, off) / len(poses)
