"""How a vehicle under way moves: along its own heading, with slip, at a speed that wanders."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import PITCH, YAW, Array
from uuv_optical_array.core.settings import Quantity

# The first pose is known to be behind the lamp, no more.
FIRST_RANGE_M, FIRST_STD = 6.0, np.array([10.0, 5.0, 5.0, 2.0, 2.0])
# A state: the pose, these, and what does not change.
SPEED, PITCH_RATE, YAW_RATE, MOTION = 5, 6, 7, 8


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


class StatePrior(NamedTuple):
    """What is known of the oldest state kept, before its image.

    Parameters
    ----------
    mean, covariance
        Of n approaches, shapes ``(n, p)`` and ``(n, p, p)``.
    """

    mean: Array
    covariance: Array


class DockingMotion:
    """The states of approaches from frame to frame, and what is known of them without images.

    Parameters
    ----------
    step_s
        Time between frames, s, > 0.
    constant_std
        Standard deviations of what does not change, about 0.
    settings
        Checked settings.

    Attributes
    ----------
    start
        What is known of the first state, for one approach.
    noise
        Covariance that a step adds, shape ``(p, p)``.
    seen
        The numbers of a state that an image depends on: the pose and what does not change.
    """

    def __init__(
        self, step_s: float, constant_std: Sequence[float], settings: DockingSettings
    ) -> None:
        s, size = settings, MOTION + len(constant_std)
        self.step_s, self.seen = step_s, np.r_[0:5, MOTION:size]
        turn, walk = np.radians([s.turn_std_deg_per_s, s.turn_walk_deg_per_s])
        first = np.zeros(size)
        first[0] = -FIRST_RANGE_M
        first_std = np.array([*FIRST_STD, s.speed_std_m_per_s, turn, turn, *constant_std])
        self.start = StatePrior(first[None], np.diag(first_std**2)[None])
        self.noise = np.zeros((size, size))
        position, speed = step_s * s.slip_m**2, step_s * s.speed_walk_m_per_s**2
        self.noise[range(3), range(3)], self.noise[SPEED, SPEED] = position, speed
        # White-noise acceleration of both angles.
        for angle, rate in ((PITCH, PITCH_RATE), (YAW, YAW_RATE)):
            self.noise[np.ix_([angle, rate], [angle, rate])] = walk**2 * np.array(
                [[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]]
            )
        self._precision = np.linalg.inv(self.noise[:MOTION, :MOTION])

    def moved(self, states: Array) -> tuple[Array, Array]:
        """Return the states a step later, shape ``(..., p)``, and their derivatives."""
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

    def cost(self, path: Array, prior: StatePrior) -> Array:
        """Return the negative log-prior of paths, without constants, shape ``(n,)``.

        Parameters
        ----------
        path
            Shape ``(n, k, p)``.
        prior
            Of the first states.
        """
        first = (path[:, 0] - prior.mean)[..., None]
        begun = (np.swapaxes(first, 1, 2) @ np.linalg.solve(prior.covariance, first))[:, 0, 0]
        ahead, _ = self.moved(path[:, :-1])
        off = (path[:, 1:] - ahead)[..., :MOTION]
        walked = np.einsum("nki,ij,nkj->n", off, self._precision, off)
        return 0.5 * (begun + walked)

    def along(self, poses: Array) -> Array:
        """Return the states of a path of poses, shape ``(1, frames, p)``, by its steps."""
        path = np.zeros((1, len(poses), len(self.noise)))
        path[0, :, :5] = poses
        steps = np.diff(poses, axis=0) / self.step_s
        path[0, :-1, SPEED] = np.linalg.norm(steps[:, :3], axis=1)
        path[0, :-1, PITCH_RATE:MOTION] = steps[:, PITCH:]
        path[0, -1, SPEED:MOTION] = path[0, -2, SPEED:MOTION]
        return path
