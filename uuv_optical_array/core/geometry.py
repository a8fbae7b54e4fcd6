"""The 5-DOF relative pose: frames, rotations and covariances (REP 103).

Every frame is x forward, y left, z up. A pose is the follower's ``base_link`` in
the leader's ``beacon`` frame, as the row ``(x, y, z, pitch, yaw)`` in metres and
radians; arrays of poses have shape ``(..., 5)``. The attitude is
``Rz(yaw) Ry(pitch) Rx(roll)``; roll is known (0 for level vehicles), never estimated.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

DOF_NAMES = ("x", "y", "z", "pitch", "yaw")
X, Y, Z, PITCH, YAW = range(5)
# Poses and errors are printed and drawn in these units; times IN_DEGREES they are.
DOF_UNITS = ("m", "m", "m", "deg", "deg")

Array = NDArray[np.float64]
IN_DEGREES: Array = np.array([1.0, 1.0, 1.0, *np.degrees([1.0, 1.0])])


def rotation_matrix(pitch: ArrayLike, yaw: ArrayLike, roll: ArrayLike = 0.0) -> Array:
    """Rotation from the turned frame to the frame it was turned in.

    Parameters
    ----------
    pitch, yaw, roll
        Angles in rad, of shapes that broadcast to ``(...)``. Positive pitch lowers
        the bow, positive yaw turns it to port, positive roll lowers the starboard side.

    Returns
    -------
    Array
        ``Rz(yaw) Ry(pitch) Rx(roll)``, shape ``(..., 3, 3)``.
    """
    sin_r, cos_r = np.sin(roll), np.cos(roll)
    sin_p, cos_p = np.sin(pitch), np.cos(pitch)
    sin_y, cos_y = np.sin(yaw), np.cos(yaw)
    sin_p_sin_r, sin_p_cos_r = sin_p * sin_r, sin_p * cos_r
    matrix = np.empty((*np.broadcast(roll, pitch, yaw).shape, 3, 3))
    matrix[..., 0, 0] = cos_y * cos_p
    matrix[..., 0, 1] = cos_y * sin_p_sin_r - sin_y * cos_r
    matrix[..., 0, 2] = cos_y * sin_p_cos_r + sin_y * sin_r
    matrix[..., 1, 0] = sin_y * cos_p
    matrix[..., 1, 1] = sin_y * sin_p_sin_r + cos_y * cos_r
    matrix[..., 1, 2] = sin_y * sin_p_cos_r - cos_y * sin_r
    matrix[..., 2, 0] = -sin_p
    matrix[..., 2, 1] = cos_p * sin_r
    matrix[..., 2, 2] = cos_p * cos_r
    return matrix


def roll_pitch_yaw(matrix: ArrayLike) -> tuple[Array, Array, Array]:
    """Angles of a rotation matrix, the inverse of `rotation_matrix`.

    Parameters
    ----------
    matrix
        Rotation matrices, shape ``(..., 3, 3)``.

    Returns
    -------
    tuple of Array
        Roll, pitch and yaw in rad, shape ``(...)``; pitch in [-pi/2, pi/2].
    """
    m = np.asarray(matrix, dtype=float)
    yaw = np.arctan2(m[..., 1, 0], m[..., 0, 0])
    # What is left when the yaw is undone is a pitch and a roll, with the bow up or down too.
    sin_y, cos_y = np.sin(yaw), np.cos(yaw)
    pitch = np.arctan2(-m[..., 2, 0], cos_y * m[..., 0, 0] + sin_y * m[..., 1, 0])
    roll = np.arctan2(
        sin_y * m[..., 0, 2] - cos_y * m[..., 1, 2], cos_y * m[..., 1, 1] - sin_y * m[..., 0, 1]
    )
    return roll, pitch, yaw


def relative_pose(
    beacon_position: ArrayLike,
    beacon_rotation: ArrayLike,
    follower_position: ArrayLike,
    follower_rotation: ArrayLike,
) -> tuple[Array, float]:
    """Pose of the follower in the beacon frame, from both in one common frame.

    Parameters
    ----------
    beacon_position, follower_position
        Origins in the common frame, m, shape ``(3,)``.
    beacon_rotation, follower_rotation
        Rotations from each frame to the common one, shape ``(3, 3)``.

    Returns
    -------
    pose : Array
        ``(x, y, z, pitch, yaw)`` in m and rad, shape ``(5,)``.
    roll : float
        The roll that completes the attitude, rad.
    """
    to_beacon = np.asarray(beacon_rotation, dtype=float).T
    position = to_beacon @ (np.asarray(follower_position, float) - np.asarray(beacon_position))
    roll, pitch, yaw = roll_pitch_yaw(to_beacon @ np.asarray(follower_rotation, float))
    return np.array([*position, pitch, yaw]), float(roll)


def covariance_5x5(pose: ArrayLike, covariance: ArrayLike) -> Array:
    """Reduce the 6x6 covariance of a ROS pose to the 5 degrees of freedom.

    Parameters
    ----------
    pose
        ``(x, y, z, pitch, yaw)`` in m and rad, shape ``(5,)``.
    covariance
        Of (x, y, z, rotations about the fixed x, y and z axes), shape ``(6, 6)``.

    Returns
    -------
    Array
        Covariance of `pose`, shape ``(5, 5)``.
    """
    yaw = np.asarray(pose, dtype=float)[YAW]
    reduction = np.zeros((5, 6))
    reduction[:3, :3] = np.eye(3)
    reduction[PITCH, 3:5] = -np.sin(yaw), np.cos(yaw)
    reduction[YAW, 5] = 1.0
    return reduction @ np.asarray(covariance, float) @ reduction.T


def turned_about_beam(poses: Array, roll: float) -> Array:
    """Turn level followers about the beam axis until they roll: the light does not change.

    Parameters
    ----------
    poses
        Poses of level followers, m and rad, shape ``(..., 5)``.
    roll
        Angle about the beam, which for small pitch and yaw is the roll it gives, rad.

    Returns
    -------
    Array
        The turned poses, shape ``(..., 5)``.
    """
    if roll == 0:
        return np.asarray(poses, dtype=float)
    turn = rotation_matrix(0.0, 0.0, roll)
    turned = np.empty(poses.shape)
    turned[..., :3] = poses[..., :3] @ turn.T
    _, turned[..., PITCH], turned[..., YAW] = roll_pitch_yaw(
        turn @ rotation_matrix(poses[..., PITCH], poses[..., YAW])
    )
    return turned


def covariance_6x6(pose: ArrayLike, covariance: ArrayLike, roll_std: float) -> Array:
    """Expand a 5-DOF covariance to the 6x6 of a ROS pose.

    The beam is axisymmetric, so turning the whole follower about the beam axis
    changes nothing that can be seen: an uncertain roll moves y, z and the attitude
    together. That rank-one term is added to the mapped 5x5.

    Parameters
    ----------
    pose
        ``(x, y, z, pitch, yaw)`` in m and rad, shape ``(5,)``; abs(yaw) < pi/2, since abeam the
        pitch and the beam have one axis.
    covariance
        Covariance of `pose`, shape ``(5, 5)``, m^2, m rad and rad^2.
    roll_std
        Standard deviation of the roll about the beam axis, rad, > 0.

    Returns
    -------
    Array
        Covariance of (x, y, z, rotations about the fixed x, y and z axes), shape
        ``(6, 6)``; positive definite when `covariance` is.
    """
    _, y, z, _, yaw = np.asarray(pose, dtype=float)
    jacobian = np.zeros((6, 5))
    jacobian[:3, :3] = np.eye(3)
    jacobian[3:5, PITCH] = -np.sin(yaw), np.cos(yaw)
    jacobian[5, YAW] = 1.0
    gauge = np.array([0.0, -z, y, 1.0, 0.0, 0.0])
    mapped = jacobian @ np.asarray(covariance, float) @ jacobian.T
    mapped += roll_std**2 * np.outer(gauge, gauge)
    return (mapped + mapped.T) / 2
