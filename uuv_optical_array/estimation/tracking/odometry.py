"""A track as odometry: pose and twist of the follower, with their covariances, as ROS has them."""

from typing import NamedTuple

from uuv_optical_array.core.geometry import Array, body_twist, covariance_6x6
from uuv_optical_array.estimation.tracking.track import POSE, Track


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


def relative_odometry(
    track: Track, aim_covariance: Array, roll: float, roll_std: float
) -> RelativeOdometry:
    """Return a track as odometry.

    Parameters
    ----------
    track
        Of the frame.
    aim_covariance
        Of the pose by the aim of the array, as `Estimator.aim_covariance` has it, shape ``(5, 5)``:
        no frame tells anything of it, and so no track does.
    roll, roll_std
        Of the follower, and its standard deviation, rad.
    """
    joint = track.joint_covariance.copy()
    joint[POSE, POSE] += aim_covariance
    covariance = covariance_6x6(track.pose, joint[POSE, POSE], roll_std)
    return RelativeOdometry(
        track.pose, covariance, *body_twist(track.pose, track.rate, joint, roll)
    )
