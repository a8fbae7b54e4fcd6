"""What a tracker returns: the track, also as odometry, or why a frame is not in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array, body_twist, covariance_6x6

POSE, RATE = slice(0, 5), slice(5, 10)  # of the joint mean and covariance
OwnMotionIs = Literal["told", "not told", "contradicted"]


class Outlier(NoPose):
    """The pose is too far from the track."""


class StampRefused(NoPose):
    """The frame is older than the buffer, or in it already.

    - message: why, its kind before the colon.
    - newest_ns: stamp of the newest frame, ns.
    """

    def __init__(self, message: str, newest_ns: int) -> None:
        super().__init__(message)
        self.newest_ns = newest_ns


class Learnt(NamedTuple):
    """What is known of a constant by now: mean and standard deviation of its offset."""

    mean: float
    std: float


class RangeUse(NamedTuple):
    """What a track made of a range.

    - stamp_ns: of the range, ns.
    - off_m: by how much it was longer than that of the track, m.
    - std_m: standard deviation to expect of that, m.
    - refused: how many in a row were beyond the gate, up to this one; 0 where it was used.
    """

    stamp_ns: int
    off_m: float
    std_m: float
    refused: int


@dataclass(frozen=True)
class Track:
    """The filtered pose and its rate at one instant.

    Parameters
    ----------
    stamp_ns
        The instant, ns: that of the newest frame in the track.
    pose
        ``(x, y, z, pitch, yaw)``, m and rad, shape ``(5,)``; yaw in [-pi, pi].
    rate
        Of `pose`, the commanded motion included, m/s and rad/s, shape ``(5,)``.
    joint_covariance
        Of `pose` and `rate`, shape ``(10, 10)``, positive definite.
    frames
        How many are in the track; 1 where it restarts, with the pose as measured.
    distance
        Mahalanobis distance of the newest frame from its prediction, >= 0.
    constants
        What is known of the scene's constants by now, by dotted name.
    gains
        Relative gain errors of the detectors, as learnt, shape ``(n,)``; ``(0,)``: they are not.
    own_motion
        Whether the follower's commands are known at that instant, or contradicted by the images.
    mismatch
        What would explain best that the frames of the last half minute are not of the scene; empty
        where they may be.
    turn
        Covariance of the roll with the pose, and its variance, ``(6,)``; ``None`` by one lamp.
    range
        What was made of the newest range in the track; ``None`` where there is none.
    """

    stamp_ns: int
    pose: Array
    rate: Array
    joint_covariance: Array
    frames: int
    distance: float
    constants: Mapping[str, Learnt] = field(default_factory=dict)
    gains: Array = field(default_factory=lambda: np.zeros(0))
    own_motion: OwnMotionIs = "not told"
    mismatch: str = ""
    turn: Array | None = None
    range: RangeUse | None = None

    @property
    def covariance(self) -> Array:
        """Covariance of `pose`, shape ``(5, 5)``, positive definite."""
        return self.joint_covariance[POSE, POSE]


class RelativeOdometry(NamedTuple):
    """The follower in ``beacon``, and how it moves.

    - pose: ``(x, y, z, pitch, yaw)``, m and rad, shape ``(5,)``.
    - covariance: of the pose as `geometry.covariance_6x6` has it, shape ``(6, 6)``.
    - twist: linear and angular velocity in the follower's frame, m/s and rad/s, shape ``(6,)``.
    - spread: covariance of `twist`, shape ``(6, 6)``.
    """

    pose: Array
    covariance: Array
    twist: Array
    spread: Array


def relative_odometry(track: Track, roll: float, roll_std: float) -> RelativeOdometry:
    """Return a track of `Pipeline.track` as odometry, by the follower's roll and its std, rad."""
    covariance = covariance_6x6(track.pose, track.covariance, roll_std, track.turn)
    twist, spread = body_twist(track.pose, track.rate, track.joint_covariance, roll)
    return RelativeOdometry(track.pose, covariance, twist, spread)
