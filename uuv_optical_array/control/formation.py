"""The control law that keeps a follower on station behind the leader, while there is light.

It takes relative pose and rate from the estimator's tracker, subtracts its own command from the
rate, which leaves the leader's motion, weighs it with what the leader tells (`told_motion`), and
predicts the pose to the present by that motion and its commands since. It commands the leader's
velocity, plus one proportional to the error of the predicted pose. So nothing lags at a steady
speed or turn of the leader or in a steady current, which looks like a motion of the leader, and
there is no integral to wind up.

The station is a place behind the lamp, on the beam's axis or beside it, and turns with the leader.
Behind a leader that turns fast it sweeps aside faster than a vehicle sways; then the bow turns into
the way, as far as the array still sees the lamp, and surge does what sway cannot.

The follower keeps a minimum distance to the lamp. Its nearest possible range is that of the
predicted or of the newest pose, whichever is less, less `RANGE_STDS` standard deviations of the
newest. For every command while the light is not lost:

- where that range is at or below the minimum, nothing moves the follower towards the lamp,
  whatever the limits of acceleration say, and it backs off;
- above it, the speed lets the follower come to rest before the minimum by braking at
  ``max_acceleration_m_per_s2``, should the leader stop dead;
- and also while the command falls to zero, should the light be lost.

So the minimum is kept, but for the latency of poses and vehicle, while the range errs by no more
than `RANGE_STDS` of its published standard deviations and the leader does not come nearer by
itself. A range that errs by more cannot be recognised. A command of zero is rest in the water:
without light a current carries the follower along.

A refused pose steers nothing, and where no other comes the follower stops, unless `following` lets
it go on. Beyond the minimum a pose is refused whose range may err by half of itself.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.control.leader.told_motion import ToldMotion, checked_spread
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.core.settings import Place, Quantity
from uuv_optical_array.estimation.tracking.measurement import checked_pose
from uuv_optical_array.estimation.tracking.motion import OwnMotion, checked_rate, in_beacon

STATION = Quantity("station in the lamp's frame; x at most -0.5", "m", -50, 50)
RANGE_STDS = 3.0  # how far a range may err, in standard deviations
MOST_UNCERTAIN = 0.5  # of a range, that it may err and still steer
# How far off the lamp the bow turns at most into the way, so that the array sees the lamp, rad, and
# how much sooner than to another heading.
CRAB_RAD, CRAB_GAIN = 0.7, 2.0
MAX_STAMP_S = 9e9  # what fits 64 bits in nanoseconds


@dataclass(frozen=True)
class FormationSettings:
    """Station, gains and limits; ValueError for a station that is not behind the lamp."""

    station_m: Annotated[Place, STATION] = (-4.5, 0.0, 0.0)
    min_distance_m: Annotated[
        float, Quantity("nearest to the lamp; 0 for no minimum", "m", 0, 50)
    ] = 2.0
    position_gain_per_s: Annotated[float, Quantity("speed per position error", "1/s", 0.01, 2)] = (
        0.4
    )
    attitude_gain_per_s: Annotated[
        float, Quantity("turn rate per attitude error", "1/s", 0.01, 2)
    ] = 0.4
    smoothing_s: Annotated[float, Quantity("time constant of the command", "s", 0.01, 10)] = 0.5
    max_surge_m_per_s: Annotated[float, Quantity("fastest surge", "m/s", 0.01, 5)] = 1.4
    max_sway_m_per_s: Annotated[float, Quantity("fastest sway and heave", "m/s", 0.01, 5)] = 1.0
    max_turn_deg_per_s: Annotated[float, Quantity("fastest turn", "deg/s", 0.1, 90)] = 30.0
    max_acceleration_m_per_s2: Annotated[
        float, Quantity("of the commanded speed", "m/s^2", 0.01, 5)
    ] = 1.0
    max_acceleration_deg_per_s2: Annotated[
        float, Quantity("of the commanded turn", "deg/s^2", 0.1, 90)
    ] = 30.0
    light_timeout_s: Annotated[
        float, Quantity("without a pose until the light is lost", "s", 0.1, 60)
    ] = 1.0
    stop_time_s: Annotated[
        float, Quantity("to come to rest in, which caps the approach", "s", 0.1, 60)
    ] = 3.0
    bow_to_lamp: Annotated[
        bool, Quantity("point the bow at the lamp, in place of along the leader's")
    ] = False

    def __post_init__(self) -> None:
        if not self.station_m[0] <= -0.5:
            raise ValueError(
                f"station_m: {list(self.station_m)} is not behind the lamp; "
                "its x must be from -50 to -0.5 m"
            )

    @property
    def blind_s(self) -> float:
        """Time for which a follower would go on at its speed, should the light go out, s."""
        return self.light_timeout_s + self.stop_time_s / 2


class LeaderTrack(NamedTuple):
    """A checked pose, by what its range may err, m, and the leader's motion."""

    stamp_ns: int
    pose: Array
    margin_m: float
    leader_rate: Array


class KeepOff(NamedTuple):
    """A lamp to keep off.

    - nearest_m: how near it may be, m.
    - away: unit vector from it, in the follower's axes, shape ``(3,)``.
    - drift: by which it makes the range grow, m/s.
    """

    nearest_m: float
    away: Array
    drift: float = 0.0


class Aim(NamedTuple):
    """What to steer to.

    - error: from the follower to the goal, m and rad, shape ``(5,)``.
    - speed: of the goal, m/s and rad/s, shape ``(5,)``, in the axes of `error`.
    - to_body: rotation from these axes to the follower's, shape ``(3, 3)``.
    - lamps: to keep off; the last one counts most.
    """

    error: Array
    speed: Array
    to_body: Array
    lamps: Sequence[KeepOff]


class FormationController:
    """Keep station and the leader's attitude; none nearer than the minimum distance is reached.

    - leader: its motion, as it is told and as the light shows it.
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
        turn, turn_acceleration = np.radians([s.max_turn_deg_per_s, s.max_acceleration_deg_per_s2])
        self._station = np.array([*s.station_m, 0.0, 0.0])
        self._gain = np.repeat([s.position_gain_per_s, s.attitude_gain_per_s], [3, 2])
        self._max_rate = np.array(
            [s.max_surge_m_per_s, s.max_sway_m_per_s, s.max_sway_m_per_s, turn, turn]
        )
        self._max_slew = np.repeat([s.max_acceleration_m_per_s2, turn_acceleration], [3, 2])
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
        - rate_covariance: of `rate`, shape ``(5, 5)``, positive definite, by which it is weighed
          with what the leader tells of its motion; ``None``: it counts alone.
        - NoPose: for a pose beyond the minimum whose range may err by itself.
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
        self._cruise = self._rate  # lest a stale pose bring the old speed back

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
        """Return how far a pose is from where the last one that steered leads by then, ``(5,)``."""
        if self._track is None:
            raise ValueError("off: no pose has steered yet")
        return pose - self._predicted(self._track, nanoseconds("stamp_s", stamp_s))

    def drive(self, now_s: float, aim: Aim) -> tuple[Array, Array]:
        """Return the twist to command at the present, s, within all limits, as `command` does."""
        now_ns = nanoseconds("now_s", now_s)
        self._rate = self._driven(aim, self._elapsed_s(now_ns))
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
        lamps = [KeepOff(nearest_m, away, drift)]
        aim = Aim(self._goal(pose) - pose, -track.leader_rate, to_body, lamps)
        return self._driven(aim, elapsed_s)

    def _predicted(self, track: LeaderTrack, now_ns: int) -> Array:
        """Return the pose at a later stamp, by the leader's motion and the commands since."""
        return (
            track.pose
            + (now_ns - track.stamp_ns) * 1e-9 * track.leader_rate
            + in_beacon(track.pose, self._own.displacement(track.stamp_ns, now_ns))
        )

    def _goal(self, pose: Array) -> Array:
        """Return the pose to take, as seen from one, ``(5,)``: the station, facing the way told."""
        if not self._settings.bow_to_lamp:
            return self._station
        return np.array([*self._station[:3], *bow_to(-pose[:3])])

    def _driven(self, aim: Aim, elapsed_s: float) -> Array:
        """Return the rate towards a goal, a time after the last command, s."""
        error, speed, to_body, lamps = aim
        wanted = self._gain * error + speed
        wanted[:3] = to_body @ wanted[:3]
        crab = self._crab(wanted[:2], -lamps[0].away, float(error[YAW])) if lamps else 0.0
        if crab:
            wanted[YAW] = CRAB_GAIN * self._gain[YAW] * (error[YAW] + crab) + speed[YAW]
        wanted = np.clip(wanted, -self._max_rate, self._max_rate)
        change = (wanted - self._rate) * min(elapsed_s / self._settings.smoothing_s, 1.0)
        slew = self._max_slew * elapsed_s
        rate: Array = self._rate + np.clip(change, -slew, slew)
        for lamp in lamps:
            rate[:3] = self._kept_off(rate[:3], *lamp, float(slew[0]))
        return rate

    def _crab(self, velocity: Array, to_lamp: Array, turn: float) -> float:
        """Return by how much to turn the bow into a wanted velocity that is faster than the sway.

        - velocity: surge and sway, m/s, ``(2,)``; to_lamp: ``(3,)``; both as the bow is now.
        - turn: to the heading that is wanted, rad.
        - returned: from that heading, rad; 0 where no turn that keeps the lamp in sight helps.
        """
        speed, most = math.hypot(*velocity), self._settings.max_sway_m_per_s
        way = math.remainder(math.atan2(velocity[1], velocity[0]) - turn, 2 * math.pi)
        if speed * abs(math.sin(way)) <= most:
            return 0.0
        lamp = math.remainder(math.atan2(to_lamp[1], to_lamp[0]) - turn, 2 * math.pi)
        crab = math.copysign(abs(way) - math.asin(most / speed), way)
        crab = min(max(crab, min(lamp - CRAB_RAD, 0.0)), max(lamp + CRAB_RAD, 0.0))
        return crab if abs(math.sin(way - crab)) < abs(math.sin(way)) else 0.0

    def _kept_off(
        self, velocity: Array, nearest_m: float, away: Array, drift: float, slew: float
    ) -> Array:
        """Return the velocity nearest to one wanted that keeps the minimum distance, m/s.

        `away` points from the lamp, as `velocity` in the follower's frame. By `drift` the leader
        makes the range grow, m/s; `slew` is how much the speed of backing off may, m/s.
        """
        s = self._settings
        if s.min_distance_m == 0:
            return velocity
        spare_m = nearest_m - s.min_distance_m
        if spare_m > 0:
            braking = math.sqrt(2 * s.max_acceleration_m_per_s2 * spare_m)
            allowed = min(spare_m / s.blind_s, braking)
        else:
            allowed = s.position_gain_per_s * spare_m
        allowed += min(drift, 0.0)  # a leader that comes nearer
        # Backing off gains speed as any motion does.
        allowed = max(allowed, min(-float(away @ self._rate[:3]), 0.0) - slew)
        # Straight away from the lamp, within the limits of all axes.
        fastest = float(np.min(self._max_rate[:3] / np.maximum(np.abs(away), 1e-9)))
        allowed = max(allowed, -fastest)
        closing = -float(away @ velocity)
        if closing <= allowed:
            return velocity
        # Within a box and on one side of a plane the nearest is off by some multiple of the plane's
        # normal, cut to the box. Closing in is linear in it but where an axis reaches its limit.
        most = self._max_rate[:3]
        of = np.abs(away) > 1e-9
        shifts = np.append(0.0, (np.copysign(most, away) - velocity)[of] / away[of])
        shifts = np.sort(np.maximum(shifts, 0.0))
        cut = np.clip(velocity + shifts[:, None] * away, -most, most)
        shift = np.interp(-allowed, cut @ away, shifts)
        return np.asarray(np.clip(velocity + shift * away, -most, most))


def bow_to(way: Array) -> tuple[float, float]:
    """Return the pitch and yaw, rad, at which the bow points along a way, shape ``(3,)``."""
    return -math.atan2(way[2], math.hypot(way[0], way[1])), math.atan2(way[1], way[0])


def polar(place: Array) -> tuple[float, Array]:
    """Return the range of a place, m, and the unit vector to it; astern where it is the origin."""
    range_m = float(np.linalg.norm(place))
    return range_m, place / range_m if range_m > 0 else np.array([-1.0, 0.0, 0.0])


def nanoseconds(name: str, seconds: float) -> int:
    """Return a time in ns; ValueError for one that is not finite or too far off."""
    if not abs(seconds) <= MAX_STAMP_S:
        raise ValueError(f"{name} is {seconds:g} s; give seconds within +-{MAX_STAMP_S:g}")
    return round(seconds * 1e9)
