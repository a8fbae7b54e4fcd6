"""The control law that keeps a follower on station behind the leader.

A tracker that is told each command as it was limited estimates the relative pose and its rate. The
command is changed by the rate that is missing: one proportional to the error, less the present
one. So nothing lags at a steady speed or turn of the leader or in a steady current, which the
tracker cannot tell from it, and there is no integral to wind up.

The station is a place behind the lamp, on the beam's axis or beside it. It turns with the leader.

A lateral offset and a turn of the follower move the light across the array alike, so one image
hardly tells them apart: the errors of y and yaw, and of z and pitch, are all but proportional.
The covariance says so, and the motion from image to image decides.

The follower keeps a minimum distance to the lamp. The nearest that it may be is the range of the
track or that of the newest pose, whichever is less, less `RANGE_STDS` standard deviations of that
pose: those of the track are smaller, but an error that all poses share does not average out. A
pose that is refused counts as measured. For every command while there is a track:

- where the nearest is at or below the minimum, nothing moves the follower towards the lamp,
  whatever the limits of acceleration say, and it backs off;
- above it, the speed is such that the follower comes to rest before the minimum, should the
  leader stop dead, by braking at ``max_acceleration_m_per_s2``;
- and such that it does so too, should the light be lost, while the command falls to zero.

So the follower does not go nearer than the minimum while the range errs by no more than
`RANGE_STDS` of its published standard deviations and the leader does not come nearer by itself,
but for the latency of the poses and of the vehicle. A range that errs by more than it says cannot
be known to err. A command of zero is rest in the water: without light a current carries the
follower along.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix
from uuv_optical_array.core.settings import Place, Quantity
from uuv_optical_array.estimation.tracking.motion import RandomMotion
from uuv_optical_array.estimation.tracking.settings import GateProbability, TrackerSettings
from uuv_optical_array.estimation.tracking.track import Outlier, StampRefused
from uuv_optical_array.estimation.tracking.tracker import Tracker

# Random walk of the leader's twist per root second: a vehicle turns and speeds up, hardly drifts.
LEADER_WALK = np.array([0.02, 0.008, 0.008, 0.012, 0.012])  # m/s, rad/s
# What the command does not say about the follower's own motion, per root second.
OWN_WALK = np.array([0.02, 0.012, 0.012, 0.003, 0.003])  # m, rad
# Twist of a leader of which nothing is known yet.
LEADER_STD = np.array([0.5, 0.1, 0.1, 0.03, 0.03])  # m/s, rad/s
RANGE_STDS = 3.0  # how far a range may err, in standard deviations
MAX_STAMP_S = 9e9  # what fits 64 bits in nanoseconds


@dataclass(frozen=True)
class FormationSettings:
    """Station, gains and limits; ValueError for a station that is not behind the lamp."""

    station_m: Annotated[
        Place, Quantity("station in the lamp's frame; x at most -0.5", "m", -50, 50)
    ] = (-6.0, 0.0, 0.0)
    min_distance_m: Annotated[
        float, Quantity("nearest to the lamp that it goes; 0 for no minimum", "m", 0, 50)
    ] = 2.0
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
    gate_probability: GateProbability = TrackerSettings.gate_probability

    def __post_init__(self) -> None:
        if not self.station_m[0] <= -0.5:
            raise ValueError(
                f"station_m: {list(self.station_m)} is not behind the lamp; "
                "its x must be from -50 to -0.5 m"
            )


class FormationController:
    """Keep the station and the leader's attitude, in all 5 degrees of freedom.

    Parameters
    ----------
    settings
        Checked settings. A station nearer than the minimum distance is not reached.
    """

    def __init__(self, settings: FormationSettings) -> None:
        self._tracker = Tracker(TrackerSettings())
        self._seen_ns: int | None = None  # stamp of the newest pose that steers
        self._lit = False  # whether there is a track to steer by
        self._doubted = False  # whether a pose was refused and the track not confirmed since
        # Of the newest pose, refused or not: its stamp, and the nearest that it may be.
        self._measured_ns, self._nearest_m = 0, math.inf
        self._margin_m = 0.0  # by which the range of the newest pose in the track may err
        self._commanded_ns: int | None = None
        self._rate: Array = np.zeros(5)  # commanded: surge, sway, heave, pitch rate, yaw rate
        self._cruise: Array = np.zeros(5)  # the last rate commanded in the light
        self.configure(settings)

    def configure(self, settings: FormationSettings) -> None:
        """Use other settings from now on; what was learnt of the leader stays."""
        self._settings = s = settings
        turn, turn_acceleration = np.radians([s.max_turn_deg_per_s, s.max_acceleration_deg_per_s2])
        self._station = np.array([*s.station_m, 0.0, 0.0])
        self._gain = np.repeat([s.position_gain_per_s, s.attitude_gain_per_s], [3, 2])
        self._max_rate = np.array(
            [s.max_surge_m_per_s, s.max_sway_m_per_s, s.max_sway_m_per_s, turn, turn]
        )
        self._max_slew = np.repeat([s.max_acceleration_m_per_s2, turn_acceleration], [3, 2])
        # Poses come in order, and no covariance is published that a common error would widen.
        self._tracker.configure(
            TrackerSettings(
                common_share=0.0,
                gate_probability=s.gate_probability,
                reset_after_s=s.light_timeout_s,
                buffer_s=0.0,
                command_timeout_s=60.0,  # each holds until the next
            ),
            _leader_motion(s.station_m),
        )

    def update(self, stamp_s: float, pose: ArrayLike, covariance: ArrayLike) -> None:
        """Take a relative pose.

        Parameters
        ----------
        stamp_s
            When its image was taken, s. One farther from the last than ``light_timeout_s``, on
            either side, begins anew: the light was lost, or the clock was reset. Where poses
            were refused before, the new track steers once `TrackerSettings.reacquire_frames`
            poses agree; until then there is no light.
        pose
            ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.
        covariance
            Of `pose`, shape ``(5, 5)``, positive definite.

        Raises
        ------
        Outlier
            For a pose beyond the gate. It steers nothing unless others confirm it; nearer than
            ``min_distance_m`` it keeps the follower from closing in until the next pose.
        ValueError
            For a pose or stamp that is not finite or out of bounds, a covariance that is not
            positive definite, or a stamp that does not advance; the controller is left as it was.
        """
        stamp_ns = _nanoseconds("pose: stamp", stamp_s)
        if self._commanded_ns is None:
            self._tracker.command(stamp_ns, self._rate)
        try:
            track = self._tracker.update(stamp_ns, pose, covariance)
        except StampRefused as reason:
            newest_s = reason.newest_ns * 1e-9
            raise ValueError(f"pose: stamp {stamp_s:.3f} s is not after {newest_s:.3f} s") from None
        except Outlier:
            range_m, _ = _polar(np.asarray(pose, dtype=float)[:3])
            near = range_m < self._settings.min_distance_m
            self._measured_ns, self._nearest_m = stamp_ns, range_m if near else math.inf
            self._doubted = True
            raise
        range_m, away = _polar(np.asarray(pose, dtype=float)[:3])
        variance = float(away @ np.asarray(covariance, dtype=float)[:3, :3] @ away)
        self._margin_m = RANGE_STDS * math.sqrt(variance)
        self._measured_ns, self._nearest_m = stamp_ns, range_m - self._margin_m
        anew = track.frames == 1 or not self._lit
        self._doubted &= track.frames < TrackerSettings.reacquire_frames
        if self._doubted and anew:
            self._lit = False
            return
        if anew:
            self._cruise = self._rate
        self._seen_ns, self._lit = track.stamp_ns, True

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

        Raises
        ------
        ValueError
            For a present that is not finite.
        """
        if self._seen_ns is None:
            return None
        s, now_ns = self._settings, _nanoseconds("now_s", now_s)
        elapsed_s = 0.0 if self._commanded_ns is None else (now_ns - self._commanded_ns) * 1e-9
        self._commanded_ns = now_ns
        # A stamp far in the future is as stale as one long past: the clock was reset.
        dark_s = abs(now_ns - self._seen_ns) * 1e-9 - s.light_timeout_s
        if dark_s > 0:
            if self._lit:
                self._tracker.reset()
                self._lit = False
            measured_s = abs(now_ns - self._measured_ns) * 1e-9
            near = s.min_distance_m > 0 and self._nearest_m <= s.min_distance_m
            if near and measured_s <= s.light_timeout_s:
                # Unconfirmed as it is, it tells no direction to back off.
                self._cruise = self._cruise * [0.0, 0.0, 0.0, 1.0, 1.0]
            self._rate = self._cruise * max(0.0, 1.0 - dark_s / s.stop_time_s)
        elif self._lit:
            # A stamp a little in the future is taken for the present.
            track = self._tracker.predict(max(now_ns, self._seen_ns))
            missing = self._gain * (self._station - track.pose) - track.rate
            to_body = rotation_matrix(track.pose[PITCH], track.pose[YAW]).T
            missing[:3] = to_body @ missing[:3]
            wanted = np.clip(self._rate + missing, -self._max_rate, self._max_rate)
            elapsed_s = min(max(elapsed_s, 0.0), s.light_timeout_s)
            change = (wanted - self._rate) * min(elapsed_s / s.smoothing_s, 1.0)
            slew = self._max_slew * elapsed_s
            rate = self._rate + np.clip(change, -slew, slew)
            place, drift = to_body @ track.pose[:3], to_body @ track.rate[:3] - self._rate[:3]
            rate[:3] = self._kept_off(rate[:3], place, drift, float(slew[0]))
            self._cruise = self._rate = rate
        else:
            # The clock was set back in the dark: from here it slows down anew.
            self._cruise = self._rate
        self._tracker.command(now_ns, self._rate)
        return self._rate[:3].copy(), np.array([0.0, self._rate[PITCH], self._rate[YAW]])

    def _kept_off(self, velocity: Array, place: Array, drift: Array, slew: float) -> Array:
        """Return a velocity that keeps the minimum distance, m/s, shape ``(3,)``.

        `velocity` is the one wanted, `place` the follower as seen from the lamp (m) and `drift`
        what the leader adds to its motion (m/s), all in the follower's frame; `slew` is how much
        the speed of backing off may grow, m/s.
        """
        s = self._settings
        if s.min_distance_m == 0:
            return velocity
        range_m, away = _polar(place)
        room = min(range_m - self._margin_m, self._nearest_m) - s.min_distance_m
        if room > 0:
            blind_s = s.light_timeout_s + s.stop_time_s / 2  # of the speed, once the light is lost
            allowed = min(room / blind_s, math.sqrt(2 * s.max_acceleration_m_per_s2 * room))
        else:
            allowed = s.position_gain_per_s * room
        allowed += min(float(away @ drift), 0.0)  # a leader that comes nearer
        # Backing off gains speed as any motion does.
        allowed = max(allowed, min(-float(away @ self._rate[:3]), 0.0) - slew)
        # Straight away from the lamp, as fast as the slowest axis lets it.
        fastest = float(np.min(self._max_rate[:3] / np.maximum(np.abs(away), 1e-9)))
        allowed = max(allowed, -fastest)
        closing = -float(away @ velocity)
        if closing <= allowed:
            return velocity
        # Between two velocities within the limits of all axes lie only such.
        share = (closing - allowed) / (closing + fastest)
        return velocity + share * (fastest * away - velocity)


def _polar(place: Array) -> tuple[float, Array]:
    """Return the range of a place, m, and the unit vector to it; astern where it is the origin."""
    range_m = float(np.linalg.norm(place))
    return range_m, place / range_m if range_m > 0 else np.array([-1.0, 0.0, 0.0])


def _nanoseconds(name: str, seconds: float) -> int:
    if not math.isfinite(seconds):
        raise ValueError(f"{name} is {seconds:g}, not finite; give seconds")
    if abs(seconds) > MAX_STAMP_S:
        raise ValueError(
            f"{name} is {seconds:g} s, out of bounds; give seconds within +-{MAX_STAMP_S:g}"
        )
    return round(seconds * 1e9)


def _leader_motion(station_m: Place) -> RandomMotion:
    """Return the random motion of the station, carried by the leader's twist: v + w x station."""
    carry = np.eye(5)
    carry[:3, PITCH] = np.cross([0.0, 1.0, 0.0], station_m)
    carry[:3, YAW] = np.cross([0.0, 0.0, 1.0], station_m)
    return RandomMotion(carry * LEADER_STD, carry * LEADER_WALK, np.diag(OWN_WALK))
