"""The control law that keeps a follower on station behind the leader.

A Kalman filter estimates the relative pose and the leader's twist, a random walk, from the noisy
poses and the follower's commanded motion (Bar-Shalom, Li and Kirubarajan, *Estimation with
Applications to Tracking and Navigation*, 2001, ch. 6). The command is the leader's twist carried
to the station, so nothing lags at a steady speed or turn, plus a correction proportional to the
error. There is no integral to wind up: the filter is told the command as it was limited.

A lateral offset and a turn of the follower move the light across the array alike, so one image
hardly tells them apart: the errors of y and yaw, and of z and pitch, are all but proportional.
The covariance says so, and the motion from image to image decides.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import DOF_NAMES, PITCH, YAW, Array, Y, Z, rotation_matrix
from uuv_optical_array.core.settings import Quantity

# Random walk of the leader's twist per root second: a vehicle turns and speeds up, hardly drifts.
LEADER_WALK = np.array([0.02, 0.008, 0.008, 0.012, 0.012])  # m/s, rad/s
# What the command does not say about the follower's own motion, per root second.
OWN_WALK = np.array([0.02, 0.02, 0.02, 0.005, 0.005])  # m, rad
# Twist of a leader of which nothing is known yet.
LEADER_STD = np.array([0.5, 0.1, 0.1, 0.03, 0.03])  # m/s, rad/s


@dataclass(frozen=True)
class FormationSettings:
    """Station, gains and limits."""

    stand_off_m: Annotated[float, Quantity("station behind the lamp", "m", 0.5, 50)] = 6.0
    position_gain_per_s: Annotated[
        float, Quantity("speed commanded per position error", "1/s", 0.01, 2)
    ] = 0.4
    attitude_gain_per_s: Annotated[
        float, Quantity("turn rate commanded per attitude error", "1/s", 0.01, 2)
    ] = 0.4
    smoothing_s: Annotated[float, Quantity("time constant of the command", "s", 0.01, 10)] = 0.7
    max_surge_m_per_s: Annotated[float, Quantity("fastest surge", "m/s", 0.01, 5)] = 1.0
    max_sway_m_per_s: Annotated[float, Quantity("fastest sway and heave", "m/s", 0.01, 5)] = 0.6
    max_turn_deg_per_s: Annotated[float, Quantity("fastest turn", "deg/s", 0.1, 90)] = 10.0
    max_acceleration_m_per_s2: Annotated[
        float, Quantity("largest change of the commanded speed", "m/s^2", 0.01, 5)
    ] = 0.2
    max_acceleration_deg_per_s2: Annotated[
        float, Quantity("largest change of the commanded turn", "deg/s^2", 0.1, 90)
    ] = 3.0
    light_timeout_s: Annotated[
        float, Quantity("without a pose for longer, the light is lost", "s", 0.1, 60)
    ] = 1.0
    stop_time_s: Annotated[float, Quantity("from lost light to standstill", "s", 0.1, 60)] = 3.0


class FormationController:
    """Keep the stand-off and the leader's attitude, in all 5 degrees of freedom.

    Parameters
    ----------
    settings
        Checked settings.
    """

    def __init__(self, settings: FormationSettings) -> None:
        self._state: Array | None = None  # pose and leader's twist, shape (10,)
        self._covariance: Array = np.zeros((10, 10))
        self._stamp_s = -np.inf
        self._rate: Array = np.zeros(5)  # commanded: surge, sway, heave, pitch rate, yaw rate
        self._cruise: Array = np.zeros(5)  # the last rate commanded in the light
        self._commanded_s: float | None = None
        self.configure(settings)

    def configure(self, settings: FormationSettings) -> None:
        """Use other settings from now on; what was learnt of the leader stays."""
        self._settings = s = settings
        turn, turn_acceleration = np.radians([s.max_turn_deg_per_s, s.max_acceleration_deg_per_s2])
        self._station = np.array([-s.stand_off_m, 0.0, 0.0, 0.0, 0.0])
        self._gain = np.repeat([s.position_gain_per_s, s.attitude_gain_per_s], [3, 2])
        self._max_rate = np.array(
            [s.max_surge_m_per_s, s.max_sway_m_per_s, s.max_sway_m_per_s, turn, turn]
        )
        self._max_slew = np.repeat([s.max_acceleration_m_per_s2, turn_acceleration], [3, 2])
        # Velocity of the station point, and its turn, from the leader's twist: v + w x station.
        self._carry = np.eye(5)
        self._carry[Y, YAW] = -s.stand_off_m
        self._carry[Z, PITCH] = s.stand_off_m

    def update(self, stamp_s: float, pose: ArrayLike, covariance: ArrayLike) -> None:
        """Take a relative pose.

        Parameters
        ----------
        stamp_s
            When its image was taken, s. One farther from the last than ``light_timeout_s``, on
            either side, begins anew: the light was lost, or the clock was reset.
        pose
            ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.
        covariance
            Of `pose`, shape ``(5, 5)``, positive definite.

        Raises
        ------
        ValueError
            For a pose or stamp that is not finite, a covariance that is not positive definite,
            or a stamp that does not advance; the controller is left as it was.
        """
        pose = np.asarray(pose, dtype=float)
        if pose.shape != (5,):
            raise ValueError(f"pose has shape {pose.shape}; give (x, y, z, pitch, yaw)")
        for name, value in zip(("stamp", *DOF_NAMES), (stamp_s, *pose), strict=True):
            if not np.isfinite(value):
                raise ValueError(f"pose: {name} is {value:g}, not finite")
        noise = np.asarray(covariance, dtype=float)
        if noise.shape != (5, 5) or not (np.linalg.eigvalsh(noise) > 0).all():
            raise ValueError("pose: its covariance is not positive definite")
        step_s = stamp_s - self._stamp_s
        if self._state is None or abs(step_s) > self._settings.light_timeout_s:
            self._state = np.concatenate([pose, np.zeros(5)])
            self._covariance[:] = 0.0
            self._covariance[:5, :5] = noise
            self._covariance[5:, 5:] = np.diag(LEADER_STD**2)
            self._cruise = self._rate
        elif step_s <= 0:
            raise ValueError(f"pose: stamp {stamp_s:.3f} s is not after {self._stamp_s:.3f} s")
        else:
            transition = np.eye(10)
            transition[:5, 5:] = -self._carry * step_s
            state = self._ahead(self._state, step_s)
            prior = transition @ self._covariance @ transition.T
            prior += np.diag(np.concatenate([OWN_WALK, LEADER_WALK]) ** 2 * step_s)
            gain = np.linalg.solve(prior[:5, :5] + noise, prior[:5]).T
            self._state = state + gain @ (pose - state[:5])
            self._covariance = prior - gain @ prior[:5]
        self._stamp_s = stamp_s

    def command(self, now_s: float) -> tuple[Array, Array] | None:
        """Return the twist to command.

        Parameters
        ----------
        now_s
            The present, s, on the clock of the stamps.

        Returns
        -------
        tuple of Array, or None
            Linear (m/s) and angular (rad/s) velocity in the follower's frame, shape ``(3,)``
            each; ``None`` before the first pose. When the light is lost it falls linearly to
            zero within ``stop_time_s``.
        """
        if np.isneginf(self._stamp_s):
            return None
        s = self._settings
        elapsed_s = 0.0 if self._commanded_s is None else now_s - self._commanded_s
        self._commanded_s = now_s
        age_s = now_s - self._stamp_s
        # A stamp far in the future is as stale as one long past: the clock was reset.
        dark_s = abs(age_s) - s.light_timeout_s
        if dark_s > 0:
            self._state = None
            self._rate = self._cruise * max(0.0, 1.0 - dark_s / s.stop_time_s)
        elif self._state is not None:
            state = self._ahead(self._state, age_s)
            pose, leader = state[:5], state[5:]
            wanted = self._carry @ leader + self._gain * (self._station - pose)
            wanted[:3] = rotation_matrix(pose[PITCH], pose[YAW]).T @ wanted[:3]
            wanted = np.clip(wanted, -self._max_rate, self._max_rate)
            elapsed_s = min(max(elapsed_s, 0.0), s.light_timeout_s)
            change = (wanted - self._rate) * min(elapsed_s / s.smoothing_s, 1.0)
            slew = self._max_slew * elapsed_s
            self._cruise = self._rate = self._rate + np.clip(change, -slew, slew)
        return self._rate[:3].copy(), np.array([0.0, self._rate[PITCH], self._rate[YAW]])

    def _ahead(self, state: Array, step_s: float) -> Array:
        pose, leader = state[:5], state[5:]
        own = self._rate.copy()
        own[:3] = rotation_matrix(pose[PITCH], pose[YAW]) @ own[:3]
        return np.concatenate([pose + (own - self._carry @ leader) * step_s, leader])
