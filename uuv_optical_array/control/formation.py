"""The control law that keeps a follower on station behind the leader, while there is light.

It takes relative pose and rate from the estimator's tracker, subtracts its own command from the
rate, which leaves the leader's motion, combines it with what the leader sends (`told_motion`), and
predicts the pose to the present by that motion and its commands since. It commands the leader's
velocity, plus one proportional to the error of the predicted pose. So nothing lags at a steady
speed or turn of the leader or in a steady current, which looks like a motion of the leader, and
there is no integral to wind up.

The station is a place behind the lamp, on the beam's axis or beside it, and turns with the leader.

While the light is not lost each command keeps a minimum distance to the lamp (`steering`). Its
nearest possible range is that of the predicted or of the newest pose, whichever is less, less
`RANGE_STDS` standard deviations of the newest. So, but for the latency of poses and vehicle, the
minimum is kept while the range errs by no more than `RANGE_STDS` of its published standard
deviations and the leader does not come nearer by itself. A larger error cannot be recognised. A
command of zero is rest in the water: without light a current carries the follower along.

A refused pose does not steer, and if no other comes the follower stops, unless `following` lets it
go on. Beyond the minimum distance a pose is refused if its range may err by half of itself.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.leader.told_motion import ToldMotion, checked_spread
from uuv_optical_array.control.steering import Aim, KeepOff, Steering, bow_to, polar
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.estimation.tracking.measurement import checked_pose
from uuv_optical_array.estimation.tracking.motion import OwnMotion, checked_rate, in_beacon

RANGE_STDS = 3.0  # how far a range may err, in standard deviations
MOST_UNCERTAIN = 0.5  # of a range, that it may err and still steer
MAX_STAMP_S = 9e9  # what fits 64 bits in nanoseconds


class LeaderTrack(NamedTuple):
    """A checked pose, the possible error of its range, m, and the leader's motion."""

    stamp_ns: int
    pose: Array
    margin_m: float
    leader_rate: Array


class FormationController:
    """Keep station and the leader's attitude, no nearer than the minimum distance.

    - leader: its motion, as it sends it and as the light shows it.
    """

    def __init__(self, settings: FormationSettings) -> None:
        self.leader = ToldMotion()
        self._own = OwnMotion()  # the commands
        self._newest: LeaderTrack | None = None
        self._track: LeaderTrack | None = None  # the newest that was not refused
        self._lit = False  # whether it steers: else the light is lost
        self._commanded_ns: int | None = None
        self._rate: Array = np.zeros(5)  # commanded: surge, sway, heave, pitch rate, yaw rate
        self._cruise: Array = np.zeros(5)  # the last rate commanded in the light
        self.configure(settings)

    def configure(self, settings: FormationSettings) -> None:
        """Use other settings from now on; what is known of the leader stays."""
        self._settings = s = settings
        self._steering = Steering(s)
        self._station = np.array([*s.station_m, 0.0, 0.0])
        self._timeout_ns = round(s.light_timeout_s * 1e9)

    def update(
        self,
        stamp_s: float,
        pose: ArrayLike,
        covariance: ArrayLike,
        rate: ArrayLike,
        rate_covariance: ArrayLike | None = None,
    ) -> None:
        """Take a relative pose and its rate.

        - stamp_s: when its image was taken, s. One farther from the last than ``light_timeout_s``,
          on either side, begins anew: the light was lost, or the clock was reset.
        - pose: ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.
        - covariance: of `pose`, shape ``(5, 5)``, positive definite.
        - rate: of `pose`, the follower's own motion included, m/s and rad/s, shape ``(5,)``.
        - rate_covariance: of `rate`, shape ``(5, 5)``, positive definite, which weights it against
          the motion that the leader sends; ``None``: it counts alone.
        - NoPose: for a pose beyond the minimum whose range is too uncertain.
        - ValueError: for what is not finite, out of bounds or not positive definite, and a stamp
          that does not advance; the controller is left as it was.
        """
        stamp_ns = nanoseconds("pose: stamp", stamp_s)
        pose, _ = checked_pose(pose, covariance)
        rate = checked_rate("rate", rate)
        spread = None if rate_covariance is None else checked_spread(rate_covariance)
        before = self._newest
        if before and 0 <= before.stamp_ns - stamp_ns <= self._timeout_ns:
            newest_s = before.stamp_ns * 1e-9
            raise ValueError(f"pose: stamp {stamp_s:.3f} s is not after {newest_s:.3f} s")
        range_m, away = polar(pose[:3])
        along = away @ np.asarray(covariance, dtype=float)[:3, :3] @ away
        margin_m = RANGE_STDS * math.sqrt(along)
        shown = leader_rate = rate - in_beacon(pose, self._own.twist(stamp_ns))
        if spread is not None:
            leader_rate = self.leader.fused(stamp_s, pose, shown, spread)
        new = self._newest = LeaderTrack(stamp_ns, pose, margin_m, leader_rate)
        if range_m > self._settings.min_distance_m and margin_m >= MOST_UNCERTAIN * range_m:
            raise NoPose(
                f"too uncertain: the range of {range_m:.3g} m has a standard deviation of "
                f"{margin_m / RANGE_STDS:.3g} m"
            )
        self._track, self._lit = new, True
        if spread is not None:
            self.leader.light(stamp_s, pose, shown, spread)
        self._cruise = self._rate  # so that a stale pose does not restore the old speed

    def command(self, now_s: float) -> tuple[Array, Array] | None:
        """Return the twist to command at the present, s, on the clock of the stamps.

        It is in the follower's frame, m/s and rad/s, shape ``(3,)`` each; ``None`` before a pose.
        Once the light is lost it falls linearly to zero. ValueError for a time that is not finite.
        """
        now_ns = nanoseconds("now_s", now_s)
        if self._track is None:
            return None
        s = self._settings
        elapsed_s = self._elapsed_s(now_ns)
        # A stamp far in the future is as stale as one long past: the clock was reset.
        dark_s = abs(now_ns - self._track.stamp_ns) * 1e-9 - s.light_timeout_s
        if dark_s > 0:
            self._lit = False
            self._rate = self._cruise * max(0.0, 1.0 - dark_s / s.stop_time_s)
        elif self._lit:
            self._cruise = self._rate = self._steered(self._track, now_ns, elapsed_s)
        else:
            self._cruise = self._rate  # the clock was set back in the dark: slow down from here
        return self._commanding(now_ns)

    def seen(self, now_s: float) -> LeaderTrack | None:
        """Return the pose that steers at a time, s; ``None`` where the light is lost."""
        if self._track is None or not self._lit:
            return None
        age_ns = abs(nanoseconds("now_s", now_s) - self._track.stamp_ns)
        return self._track if age_ns <= self._timeout_ns else None

    @property
    def last(self) -> LeaderTrack | None:
        """The pose that steered last."""
        return self._track

    def off(self, stamp_s: float, pose: Array) -> Array:
        """Return how far a pose is from the prediction of the last one that steered, ``(5,)``."""
        if self._track is None:
            raise ValueError("off: no pose has steered yet")
        return pose - self._predicted(self._track, nanoseconds("stamp_s", stamp_s))

    def drive(self, now_s: float, aim: Aim) -> tuple[Array, Array]:
        """Return the twist to command at the present, s, within all limits, as `command` does."""
        now_ns = nanoseconds("now_s", now_s)
        self._rate = self._steering.rate(aim, self._rate, self._elapsed_s(now_ns))
        return self._commanding(now_ns)

    def _elapsed_s(self, now_ns: int) -> float:
        """Return the time since the last command, s, from 0 to the light's timeout."""
        elapsed_s = 0.0 if self._commanded_ns is None else (now_ns - self._commanded_ns) * 1e-9
        self._commanded_ns = now_ns
        return min(max(elapsed_s, 0.0), self._settings.light_timeout_s)

    def _commanding(self, now_ns: int) -> tuple[Array, Array]:
        self._own.command(now_ns, self._rate)
        self._own.forget(now_ns - 2 * self._timeout_ns)
        return self._rate[:3].copy(), np.array([0.0, self._rate[PITCH], self._rate[YAW]])

    def _steered(self, track: LeaderTrack, now_ns: int, elapsed_s: float) -> Array:
        """Return the rate to command in the light, a time after the last command, s."""
        pose = self._predicted(track, max(now_ns, track.stamp_ns))  # of a stamp yet to come: now
        to_body = rotation_matrix(pose[PITCH], pose[YAW]).T
        range_m, away = polar(to_body @ pose[:3])
        nearest_m = min(range_m, float(np.linalg.norm(track.pose[:3]))) - track.margin_m
        drift = float(away @ (to_body @ track.leader_rate[:3]))
        lamps = [KeepOff(self._settings.room_m(nearest_m), away, drift)]
        aim = Aim(self._goal(pose) - pose, -track.leader_rate, to_body, lamps)
        return self._steering.rate(aim, self._rate, elapsed_s)

    def _predicted(self, track: LeaderTrack, now_ns: int) -> Array:
        """Return the pose at a later stamp, by the leader's motion and the commands since."""
        return (
            track.pose
            + (now_ns - track.stamp_ns) * 1e-9 * track.leader_rate
            + in_beacon(track.pose, self._own.displacement(track.stamp_ns, now_ns))
        )

    def _goal(self, pose: Array) -> Array:
        """Return the goal as seen from a pose, ``(5,)``: the station with the wanted heading."""
        if not self._settings.bow_to_lamp:
            return self._station
        return np.array([*self._station[:3], *bow_to(-pose[:3])])


def nanoseconds(name: str, seconds: float) -> int:
    """Return a time in ns; ValueError for one that is not finite or too far off."""
    if not abs(seconds) <= MAX_STAMP_S:
        raise ValueError(f"{name} is {seconds:g} s; give seconds within +-{MAX_STAMP_S:g}")
    return round(seconds * 1e9)
