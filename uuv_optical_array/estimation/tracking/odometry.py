"""A track as odometry: pose and twist of the follower, with their covariances, as ROS has them."""

from typing import NamedTuple

from uuv_optical_array.core.geometry import Array, body_twist, covariance_6x6
from uuv_optical_array.estimation.tracking.track import Track


class RelativeOdometry(NamedTuple):
    """The follower in ``beacon``, and how it moves.

    Parameters
    ----------
    pose
        ``(x, y, z, pitch, yaw)``, m and rad, shape ``(5,)``.
    covariance
        Of the pose as `geometry.covariance_6x6` has it, shape ``(6, 6)``.
    twist
        Linear and angular velocity in the follower's frame, m/s and rad/s, shape ``(6,)``.
    spread
        Covariance of `twist`, shape ``(6, 6)``.
    """

    pose: Array
    covariance: Array
    twist: Array
    spread: Array


def relative_odometry(track: Track, roll: float, roll_std: float) -> RelativeOdometry:
    """Return a track as odometry.

    Parameters
    ----------
    track
        Of the frame, as `enter.entered` has it.
    roll, roll_std
        Of the follower, and its standard deviation, rad.
    """
    covariance = covariance_6x6(track.pose, track.covariance, roll_std)
    twist, spread = body_twist(track.pose, track.rate, track.joint_covariance, roll)
    return RelativeOdometry(track.pose, covariance, twist, spread)
