"""The 5-DOF relative pose: frames, rotations and covariances (REP 103).

Every frame is x forward, y left, z up. A pose is the follower's ``base_link`` in the leader's
``beacon`` frame, as the row ``(x, y, z, pitch, yaw)`` in metres and radians; arrays of poses have
shape ``(..., 5)``. The attitude is ``Rz(yaw) Ry(pitch) Rx(roll)``; roll is given.
"""

import math
from typing import Any

import numpy as np
from numpy import arctan2, hypot
from numpy.typing import ArrayLike, NDArray

from uuv_optical_array.core.numerics.elementwise import cos, law, sin

DOF_NAMES = ("x", "y", "z", "pitch", "yaw")
X, Y, Z, PITCH, YAW = range(5)
# Units in which poses and errors are printed and drawn, after multiplication by IN_DEGREES.
DOF_UNITS = ("m", "m", "m", "deg", "deg")

Array = NDArray[np.float64]
IN_DEGREES: Array = np.array([1.0, 1.0, 1.0, *np.degrees([1.0, 1.0])])
# Half a turn about x: from forward, left, up to forward, right, down, and back.
FLU_FRD: Array = np.array([1.0, -1.0, -1.0])


@law
def rotation(pitch: Any, yaw: Any, roll: Any) -> tuple[tuple[Any, Any, Any], ...]:
    """Return the rows of `rotation_matrix`, of numbers or arrays alike."""
    sin_r, cos_r = sin(roll), cos(roll)
    sin_p, cos_p = sin(pitch), cos(pitch)
    sin_y, cos_y = sin(yaw), cos(yaw)
    return (
        (
            cos_y * cos_p,
            cos_y * sin_p * sin_r - sin_y * cos_r,
            cos_y * sin_p * cos_r + sin_y * sin_r,
        ),
        (
            sin_y * cos_p,
            sin_y * sin_p * sin_r + cos_y * cos_r,
            sin_y * sin_p * cos_r - cos_y * sin_r,
        ),
        (-sin_p, cos_p * sin_r, cos_p * cos_r),
    )


@law
def dot(a: Any, b: Any) -> Any:
    """Return the scalar product of two vectors, three components each."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@law
def in_body(rows: Any, vector: Any) -> tuple[Any, Any, Any]:
    """Return in ``base_link`` a vector of ``beacon``, by the rows of `rotation`."""
    ahead, aside, above = rows
    return (
        dot((ahead[0], aside[0], above[0]), vector),
        dot((ahead[1], aside[1], above[1]), vector),
        dot((ahead[2], aside[2], above[2]), vector),
    )


@law
def lamp_in_body(pose: Any, roll: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """Return position, m, and unit vector along the beam of the lamp in ``base_link``."""
    rows = rotation(pose[PITCH], pose[YAW], roll)
    x, y, z = in_body(rows, (pose[X], pose[Y], pose[Z]))
    u, v, w = rows[0]
    return -x, -y, -z, -u, -v, -w


@law
def pitched(seen: Any, roll: Any) -> tuple[Any, Any, Any]:
    """Return the slope by the pitch of a vector, three components, in the body's frame."""
    # A turn of the body about u changes a fixed vector by -u x; pitch turns about Rx(-roll) y.
    sin_r, cos_r = sin(roll), cos(roll)
    return -(seen[1] * sin_r + seen[2] * cos_r), seen[0] * sin_r, seen[0] * cos_r


def write_lamp_slopes(pose: Any, roll: Any, lamp: Any, slopes: Any) -> None:
    """Write the slopes of `lamp_in_body`, the `lamp`, by the pose, given as zeros, (6, 5, ...)."""
    rows = rotation(pose[PITCH], pose[YAW], roll)
    place = pitched((lamp[0], lamp[1], lamp[2]), roll)
    axis = pitched((lamp[3], lamp[4], lamp[5]), roll)
    for i in range(3):
        for j in range(3):
            slopes[i, j] = -rows[j][i]
        # Yaw turns about the beacon's z.
        slopes[i, YAW] = rows[1][i] * pose[X] - rows[0][i] * pose[Y]
        slopes[3 + i, YAW] = rows[1][i]
        slopes[i, PITCH], slopes[3 + i, PITCH] = place[i], axis[i]


def rotation_matrix(pitch: ArrayLike, yaw: ArrayLike, roll: ArrayLike = 0.0) -> Array:
    """Rotation ``Rz(yaw) Ry(pitch) Rx(roll)`` from the turned frame to the original one.

    Angles broadcast to ``(...)``; the result has shape ``(..., 3, 3)``. Positive pitch lowers the
    bow, positive yaw turns it to port, positive roll lowers the starboard side.
    """
    if isinstance(pitch, float) and isinstance(yaw, float) and isinstance(roll, float):
        # For one pose in a tenth of the time.
        return np.array(rotation(pitch, yaw, roll))
    angles = [np.asarray(angle, dtype=float) for angle in (pitch, yaw, roll)]
    matrix = np.empty((*np.broadcast(*angles).shape, 3, 3))
    for i, row in enumerate(rotation(*angles)):
        for j, entry in enumerate(row):
            matrix[..., i, j] = entry
    return matrix


def roll_pitch_yaw(matrix: ArrayLike) -> tuple[Array, Array, Array]:
    """Roll, pitch in [-pi/2, pi/2] and yaw, rad, of rotation matrices, shape ``(..., 3, 3)``."""
    ahead, aside, above = np.asarray(matrix, dtype=float).T  # columns, components first
    yaw = np.arctan2(ahead[1], ahead[0])
    # Without the yaw a pitch and a roll remain, also with the bow straight up or down.
    sin_y, cos_y = np.sin(yaw), np.cos(yaw)
    pitch = np.arctan2(-ahead[2], cos_y * ahead[0] + sin_y * ahead[1])
    roll = np.arctan2(sin_y * above[0] - cos_y * above[1], cos_y * aside[1] - sin_y * aside[0])
    return roll.T, pitch.T, yaw.T


def relative_pose(
    beacon_position: Array,
    beacon_rotation: Array,
    follower_position: Array,
    follower_rotation: Array,
) -> tuple[Array, Any]:
    """Pose, shape ``(..., 5)``, and roll, ``(...)``, of the follower in the beacon frame.

    Origins are in a common frame, m, shape ``(..., 3)``; rotations are from each frame to it,
    ``(..., 3, 3)``.
    """
    to_beacon = np.swapaxes(beacon_rotation, -1, -2)
    place = to_beacon @ (follower_position - beacon_position)[..., None]
    roll, pitch, yaw = roll_pitch_yaw(to_beacon @ follower_rotation)
    return np.concatenate([place[..., 0], pitch[..., None], yaw[..., None]], axis=-1), roll


def covariance_5x5(pose: ArrayLike, covariance: ArrayLike) -> Array:
    """Reduce the covariance of a ROS pose, (x, y, z, turns about the fixed axes), to 5 DOF."""
    yaw = np.asarray(pose, dtype=float)[YAW]
    reduction = np.zeros((5, 6))
    reduction[:3, :3] = np.eye(3)
    reduction[PITCH, 3:5] = -np.sin(yaw), np.cos(yaw)
    reduction[YAW, 5] = 1.0
    return reduction @ np.asarray(covariance, float) @ reduction.T


def wrapped(state: Array, angle: int = YAW) -> Array:
    """Bring one angle of a state, rad, to [-pi, pi], in place, and return the state."""
    state[angle] = math.remainder(state[angle], 2 * math.pi)
    return state


@law
def turned_components(
    x: Any, y: Any, z: Any, pitch: Any, yaw: Any, roll: Any
) -> tuple[Any, Any, Any, Any, Any]:
    """As `turned_about_beam`, for the components of a pose, numbers or arrays."""
    sin_r, cos_r = sin(roll), cos(roll)
    ahead, aside, above = rotation(pitch, yaw, 0.0)
    forward_y = cos_r * aside[0] - sin_r * above[0]
    forward_z = sin_r * aside[0] + cos_r * above[0]
    level = hypot(ahead[0], forward_y)
    turned = arctan2(forward_y, ahead[0])
    return x, cos_r * y - sin_r * z, sin_r * y + cos_r * z, arctan2(-forward_z, level), turned


def body_twist(
    pose: ArrayLike, rate: ArrayLike, covariance: ArrayLike, roll: float
) -> tuple[Array, Array]:
    """Return the twist in the follower's frame, and its covariance, of a pose that changes.

    The covariances are of pose and rate, shape ``(10, 10)``, and of linear and angular velocity,
    ``(6, 6)``. An error of the roll, which is taken as constant, changes nothing, as follower and
    velocity turn about the beam together; the variance of its rate is that of the faster turn.
    """
    _, _, _, pitch, yaw = np.asarray(pose, dtype=float)
    rate = np.asarray(rate, dtype=float)
    to_body = rotation_matrix(pitch, yaw, roll).T
    sin_p, cos_p, sin_r, cos_r = np.sin(pitch), np.cos(pitch), np.sin(roll), np.cos(roll)
    by_rate = np.zeros((6, 5))
    by_rate[:3, :3] = to_body
    by_rate[3:, 3] = 0.0, cos_r, -sin_r
    by_rate[3:, 4] = -sin_p, sin_r * cos_p, cos_r * cos_p
    twist = by_rate @ rate
    by_pose = np.zeros((6, 5))
    by_pose[:3, PITCH] = pitched(twist[:3], roll)
    by_pose[3:, PITCH] = rate[YAW] * np.array([-cos_p, -sin_r * sin_p, -cos_r * sin_p])
    (u, v, w), (a, b, c) = twist[:3], to_body[:, Z]
    by_pose[:3, YAW] = v * c - w * b, w * a - u * c, u * b - v * a
    slopes = np.hstack([by_pose, by_rate])
    covariance = np.asarray(covariance, dtype=float)
    spread = slopes @ covariance @ slopes.T
    spread[3, 3] += covariance[8:, 8:].diagonal().max()
    return twist, (spread + spread.T) / 2


def pose_rate(pose: ArrayLike, twist: ArrayLike, roll: float) -> Array:
    """Return a pose's rate by its twist: the inverse of `body_twist`, for abs(pitch) < pi/2."""
    _, _, _, pitch, yaw = np.asarray(pose, dtype=float)
    *linear, _, about_y, about_z = np.asarray(twist, dtype=float)
    sin_r, cos_r = np.sin(roll), np.cos(roll)
    pitch_rate = cos_r * about_y - sin_r * about_z
    yaw_rate = (sin_r * about_y + cos_r * about_z) / np.cos(pitch)
    return np.array([*rotation_matrix(pitch, yaw, roll) @ linear, pitch_rate, yaw_rate])


def turned_on_mount(pose: Array, roll: float, bow_m: float) -> Array:
    """Return the slope of a pose, as it appears, by turns of the array on its mount, ``(5, 2)``.

    The array turns in pitch and yaw about a point `bow_m` ahead of ``base_link``.
    """
    pitch, yaw = float(pose[PITCH]), float(pose[YAW])
    # The array stays in place, so the vehicle appears to swing about it.
    swing = [(bow_m * above, -bow_m * aside) for _, aside, above in rotation(pitch, yaw, roll)]
    sin_r, cos_r, level = math.sin(roll), math.cos(roll), max(math.cos(pitch), 1e-6)
    return np.array([*swing, (cos_r, -sin_r), (sin_r / level, cos_r / level)])


def turned_about_lamp(pose: Array) -> Array:
    """Return the slope of a pose, as it appears, by turns of the lamp's axis, shape ``(5, 2)``.

    The lamp turns in pitch and yaw of the beacon, so all that it lights appears to turn back.
    """
    x, y, z, pitch, yaw = map(float, pose)
    by_pitch = (-z, 0.0, x, -math.cos(yaw), -math.tan(pitch) * math.sin(yaw))
    return np.array([by_pitch, (y, -x, 0.0, 0.0, -1.0)]).T


def turned_with_beam(poses: Array) -> Array:
    """Return the slope of poses ``(..., 5)`` by a turn of the follower about the beacon's x."""
    _, y, z, pitch, yaw = poses.T
    return np.array([0 * y, -z, y, -np.sin(yaw), np.tan(pitch) * np.cos(yaw)]).T


def turned_about_beam(poses: Array, roll: float) -> Array:
    """Turn level followers, ``(..., 5)``, about the beam axis by an angle, rad, until they roll.

    This leaves the light unchanged; for small pitch and yaw the angle is the roll.
    """
    poses = np.asarray(poses, dtype=float)
    if roll == 0:
        return poses
    x, y, z, pitch, yaw = np.moveaxis(poses, -1, 0)
    return np.stack(turned_components(x, y, z, pitch, yaw, roll), axis=-1)


def rolled(pose: Array, roll: float, angle: float) -> tuple[Array, float]:
    """Return pose ``(5,)`` and roll of a follower after a turn about the beacon's x, rad."""
    sin_a, cos_a = math.sin(angle), math.cos(angle)
    turn = np.array([(1.0, 0.0, 0.0), (0.0, cos_a, -sin_a), (0.0, sin_a, cos_a)])
    roll_after, pitch, yaw = roll_pitch_yaw(turn @ np.array(rotation(pose[PITCH], pose[YAW], roll)))
    return np.array([*(turn @ pose[:3]), pitch, yaw]), float(roll_after)


def covariance_6x6(
    pose: ArrayLike, covariance: ArrayLike, roll_std: float, turn: Array | None = None
) -> Array:
    """Expand a 5-DOF covariance to that of a ROS pose, shape ``(6, 6)``.

    The beam of one lamp is axisymmetric, so that an uncertain roll, by its standard deviation about
    the beam, rad, turns y, z and the attitude together: a term of rank one. Several lamps show
    the roll, whatever was known of it: `turn` is its covariance with the pose, and its variance,
    ``(6,)``. Abeam the pitch and the beam have one axis, so abs(yaw) < pi/2.
    """
    _, y, z, pitch, yaw = np.asarray(pose, dtype=float).tolist()
    sin_y, cos_y = math.sin(yaw), math.cos(yaw)
    jacobian, joint = np.eye(6), np.zeros((6, 6))
    joint[:5, :5] = covariance
    if turn is not None:
        by_roll = 0.0, 0.0, 0.0, cos_y * math.cos(pitch), sin_y * math.cos(pitch), -math.sin(pitch)
        joint[5], joint[:, 5] = turn, turn
    else:
        by_roll = 0.0, -z, y, 1.0, 0.0, 0.0
        joint[5, 5] = roll_std**2
    jacobian[:, 5] = by_roll
    jacobian[3:, PITCH:5] = (-sin_y, 0.0), (cos_y, 0.0), (0.0, 1.0)
    mapped = jacobian @ joint @ jacobian.T
    return (mapped + mapped.T) / 2
