"""Where the leader is without a pose to steer by: on as it moved last, corrected by what is seen.

A light that goes behind a cloud is seldom gone. Poses of it may be too uncertain to steer by, and
images without a pose still show where it is brightest. A Kalman filter of the leader's pose and
rate, in a frame that stays in the water, weights each of these by its covariance, and goes on by
the leader's last motion meanwhile. What cannot be the leader by now is another lamp or false, and
changes nothing.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.core.geometry import PITCH, YAW, Array, rotation_matrix, wrapped
from uuv_optical_array.estimation.tracking.motion import in_beacon
from uuv_optical_array.estimation.tracking.track import Outlier

TURN_S = 5.0  # time constant with which a turn ends
MOST_SPEED, MOST_TURN = 2.0, 0.6  # of a leader, m/s and rad/s: beyond them is noise
# Standard deviations of the rate of a leader, m/s and rad/s, and by which it changes in a second:
# leaders that speed up, brake and turn.
RATE_STD = np.repeat([0.5, 0.2], [3, 2])
CHANGE = np.repeat([0.1, 0.05], [3, 2])
KNOWN = 0.3  # share of the former, below which a message determines how the leader goes on
MOST_STEP_S = 5.0  # beyond it a clock was set
ALIKE_S = 1.0  # correlation time of the errors of what is seen
CHANCE = 1e-3  # that the leader is taken for another lamp
LIKELY = 0.05  # that it is farther off than a pose that is surely of it
# Direction of the brightest place at an array's edge, rad, and its standard deviation in the middle
# and at the edge: the beam's slope across the array, and a detector's width.
EDGE_RAD, MIDDLE_STD, EDGE_STD = 0.3, 0.15, 0.45
# Least share of the light that a cloud is assumed to leave, where brightness limits the range.
LEFT_BY_CLOUDS = 0.35


class Glow(NamedTuple):
    """Where an image is brightest.

    - to_port, up: of the array's middle, as shares of its half width, in [-1, 1].
    - peak: its largest reading, in any unit that stays.
    """

    to_port: float
    up: float
    peak: float

    def nearest_m(self, range_m: float, peak: float) -> float:
        """Return how near the lamp may be, m, that was so bright at a range, m.

        Light falls off at least as the square of the range, and `LEFT_BY_CLOUDS` is left of it.
        """
        return range_m * math.sqrt(LEFT_BY_CLOUDS * peak / max(self.peak, 1e-9))


class LeaderMotion:
    """Leader and follower in a frame that stays in the water: that of the lamp, as it began.

    - own: where the follower is by its own motion, m, pitch and yaw, rad, ``(5,)``.
    - place, heading: of the leader, m, ``(3,)``, pitch and yaw, rad, ``(2,)``.
    - speed: in the leader's axes, m/s, ``(3,)``; turn: of pitch and yaw, rad/s, ``(2,)``.
    - covariance: of place, heading, velocity in the water and turn, ``(10, 10)``.
    - unseen_s: time since something of the leader's light was seen, s.
    """

    def __init__(self, now_s: float, pose: Array, covariance: Array) -> None:
        """Begin with a pose and its covariance; of the rate a track that begins knows little."""
        self.own, self._now_s = pose.copy(), now_s
        self.speed: Array = np.zeros(3)
        self.turn: Array = np.zeros(2)
        self.place: Array = np.zeros(3)
        self.heading: Array = np.zeros(2)
        sees = slopes(pose, np.zeros(2))
        self.covariance: Array = np.zeros((10, 10))
        self.covariance[:5, :5] = sees @ covariance @ sees.T
        self.covariance[5:, 5:] = np.diag(np.square(RATE_STD))
        self.unseen_s = self._corrected_s = 0.0

    @property
    def rotation(self) -> Array:
        """Rotation from the leader's axes to the water's, ``(3, 3)``."""
        return rotation_matrix(*self.heading)

    @property
    def pose(self) -> Array:
        """Pose of the follower in the leader's axes, ``(5,)``."""
        place = self.rotation.T @ (self.own[:3] - self.place)
        return wrapped(np.concatenate([place, self.own[3:] - self.heading]))

    @property
    def place_std_m(self) -> float:
        """Largest standard deviation of the place along any line, m."""
        return math.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1])

    def advance(self, now_s: float, twist: Array) -> float:
        """Move on to a time, s, by the follower's own motion, ``(5,)``; return the step, s.

        The leader goes on, and its turn ends slowly. The step is limited, as clocks may be set.
        """
        step_s = min(max(now_s - self._now_s, 0.0), MOST_STEP_S)
        if step_s or now_s < self._now_s - MOST_STEP_S:
            self._now_s = now_s
        self.own = wrapped(self.own + step_s * in_beacon(self.own, twist))
        self.unseen_s += step_s
        self._corrected_s += step_s
        halfway = rotation_matrix(*(self.heading + step_s / 2 * self.turn))
        self.place = self.place + step_s * halfway @ self.speed
        self.heading = wrapped(self.heading + step_s * self.turn, 1)
        self.turn = math.exp(-step_s / TURN_S) * self.turn
        onward = np.eye(10) + step_s * np.eye(10, k=5)
        grown: Array = np.eye(10, 5, -5) + step_s / 2 * np.eye(10, 5)
        grown *= math.sqrt(step_s) * CHANGE
        self.covariance = onward @ self.covariance @ onward.T + grown @ grown.T
        return step_s

    def off(self, pose: Array, covariance: Array) -> tuple[Array, Array]:
        """Return how far a pose's leader is from the expected, ``(5,)``, and its covariance."""
        place, heading = seen_at(self.own, pose)
        sees = slopes(pose, heading)
        off = np.concatenate([place - self.place, wrapped(heading - self.heading, 1)])
        return off, sees @ covariance @ sees.T

    def expects(self, pose: Array, covariance: Array, chance: float = CHANCE) -> bool:
        """Say whether the lamp of a pose may be the leader's, at a significance level."""
        off, spread = self.off(pose, covariance)
        spread = (spread + self.covariance[:5, :5])[:3, :3]
        return plausible(off[:3], spread, chance)

    def in_line(self, pose: Array, covariance: Array, chance: float) -> bool:
        """Say whether it `expects` a pose at any range, such as that of a lamp that dims."""
        spread = covariance.copy()
        spread[:3, :3] += np.outer(pose[:3], pose[:3])
        return self.expects(pose, spread, chance)

    def unlikeliness(self, pose: Array, covariance: Array) -> float:
        """Return twice the negative log-likelihood of a pose of it, up to a constant.

        It compares leaders, each in its own frame.
        """
        off, spread = self.off(pose, covariance)
        spread = spread + self.covariance[:5, :5]
        return float(off @ np.linalg.solve(spread, off) + np.linalg.slogdet(spread)[1])

    def check(self, pose: Array, covariance: Array) -> None:
        """Raise Outlier for a pose that it does not expect."""
        if not self.expects(pose, covariance):
            raise self.outlier(pose)

    def outlier(self, pose: Array) -> Outlier:
        """Return the Outlier for a pose that is not the leader's."""
        return Outlier(
            f"outlier: a lamp {self.off_m(pose):.3g} m from where the leader is expected; "
            "another lamp, or the leader left its way"
        )

    def off_m(self, pose: Array) -> float:
        """Return how far the lamp of a pose is from where the leader's is expected, m."""
        return float(np.linalg.norm(seen_at(self.own, pose)[0] - self.place))

    def see(self, pose: Array, covariance: Array) -> None:
        """Correct by a pose that it `expects`, however uncertain."""
        self._correct(*self.off(pose, covariance), np.eye(5, 10))

    def take(self, off: Array, spread: Array, sees: Array) -> None:
        """Correct by an innovation, ``(m,)``, if it is plausible; arguments as of `_correct`."""
        expected = sees @ self.covariance @ sees.T + spread
        if plausible(off, expected):
            self._correct(off, spread, sees)

    def face(self, glow: Glow) -> None:
        """Correct by where an image is brightest, if the leader may be there."""
        range_m = float(np.linalg.norm(self.place - self.own[:3]))
        line = rotation_matrix(*self.own[3:]) @ rotation_matrix(
            -EDGE_RAD * glow.up, EDGE_RAD * glow.to_port
        )
        across = line[:, 1:].T
        edge = min(max(abs(glow.to_port), abs(glow.up)), 1.0)
        std_m = range_m * (MIDDLE_STD + edge * (EDGE_STD - MIDDLE_STD))
        off = across @ (self.own[:3] - self.place)
        ahead = float(line[:, 0] @ (self.place - self.own[:3])) > 0
        spread = std_m**2 * np.eye(2)
        if ahead:
            self.take(off, spread, across @ np.eye(3, 10))

    def hear(self, twist: Array, covariance: Array) -> bool:
        """Correct by a motion that the leader sends, ``(5,)`` in its axes, and its covariance.

        Return whether the leader's rate is then known.
        """
        speed = np.clip(twist[:3], -MOST_SPEED, MOST_SPEED) - self.speed
        turn = np.clip(twist[3:], -MOST_TURN, MOST_TURN) - self.turn
        in_water = np.eye(5)
        in_water[:3, :3] = self.rotation
        off = in_water @ np.concatenate([speed, turn])
        self._take(off, in_water @ covariance @ in_water.T, np.eye(5, 10, 5))
        stds = np.sqrt(self.covariance.diagonal()[5:])
        return bool((stds <= KNOWN * RATE_STD).all())

    def reaches(self, place: Array, heading: Array) -> bool:
        """Say whether it may plausibly be at a place, m, with a heading, rad."""
        off = np.concatenate([place - self.place, wrapped(heading - self.heading, 1)])
        return plausible(off, self.covariance[:5, :5])

    def _correct(self, off: Array, spread: Array, sees: Array) -> None:
        """Correct by an innovation, ``(m,)``, its covariance and what it sees, ``(m, 10)``."""
        self._take(off, spread * max(ALIKE_S / max(self._corrected_s, 1e-3), 1.0), sees)
        self.unseen_s = self._corrected_s = 0.0

    def _take(self, off: Array, spread: Array, sees: Array) -> None:
        """Correct likewise, by errors that are independent of those before."""
        gain = np.linalg.solve(sees @ self.covariance @ sees.T + spread, sees @ self.covariance).T
        change = gain @ off
        kept = np.eye(10) - gain @ sees
        self.covariance = kept @ self.covariance @ kept.T + gain @ spread @ gain.T
        self.place = self.place + change[:3]
        self.heading = wrapped(self.heading + change[3:5], 1)
        self.speed = self.speed + self.rotation.T @ change[5:8]
        self.turn = self.turn + change[8:]


def plausible(off: Array, spread: Array, chance: float = CHANCE) -> bool:
    """Say whether an offset, ``(n,)``, is plausible for a Gaussian, at a significance level."""
    return bool(off @ np.linalg.solve(spread, off) <= chdtri(len(off), chance))


def seen_at(own: Array, pose: Array) -> tuple[Array, Array]:
    """Return place and heading of a leader from which a follower at `own` has a pose."""
    heading = own[3:] - pose[3:]
    return own[:3] - rotation_matrix(*heading) @ pose[:3], heading


def turning(turn: Array, place: Array) -> Array:
    """Return the velocity of a place that turns by a pitch and yaw rate, rad/s, ``(3,)``."""
    pitch, yaw = turn
    x, y, z = place
    return np.array([pitch * z - yaw * y, yaw * x, -pitch * x])


def slopes(pose: Array, heading: Array) -> Array:
    """Return the slopes of a leader's place and heading by a pose of it, ``(5, 5)``."""
    rotation = rotation_matrix(*heading)
    x, y, z = rotation @ pose[:3]
    u, v, _ = rotation[:, 1]  # about which it pitches; level, as it does not roll
    by_pose: Array = np.zeros((5, 5))
    by_pose[:3, :3], by_pose[3:, 3:] = -rotation, -np.eye(2)
    by_pose[:3, PITCH], by_pose[:3, YAW] = (v * z, -u * z, u * y - v * x), (-y, x, 0.0)
    return by_pose
