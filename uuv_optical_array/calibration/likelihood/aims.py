"""The pose from where lamp and array, if they pointed exactly, would give the same light.

Turns are finite, where `geometry.turned_about_lamp` and `geometry.turned_on_mount` are small.
"""

import numpy as np

from uuv_optical_array.core.geometry import (
    PITCH,
    YAW,
    Array,
    X,
    Y,
    Z,
    roll_pitch_yaw,
    rotation_matrix,
)

TURN = 5  # about the beacon's x, beside the pose


def appearing(poses: Array, rolls: Array, aims: Array, bow_m: float) -> tuple[Array, Array, Array]:
    """Return the poses and rolls at which lamp and array would give this light if they aimed.

    The aims are pitch and yaw, rad, of the lamp in ``beacon`` and of the array on its mount, which
    is `bow_m` ahead of ``base_link``, for all poses, ``(4,)``, or for each, ``(m, 4)``. Slopes
    ``(m, 6, 10)`` lead from those of the light by the returned poses and a turn of the follower
    about the beacon's x to those by the given poses, rolls and aims. The follower's bow is not
    abeam.
    """
    lamp_pitch, lamp_yaw, pitch, yaw = aims.T
    to_lamp = np.swapaxes(rotation_matrix(lamp_pitch, lamp_yaw), -1, -2)
    mount = rotation_matrix(pitch, yaw)
    body, ahead = rotation_matrix(poses[:, PITCH], poses[:, YAW], rolls), np.array([bow_m, 0, 0])
    given = poses[:, :3]
    bow = given + body @ ahead
    place = bow - body @ mount @ ahead
    roll, *attitude = roll_pitch_yaw(to_lamp @ body @ mount)
    seen = np.column_stack([(to_lamp @ place[..., None])[..., 0], *attitude])
    # Each angle turns the array about an axis through a point, all in the beacon.
    turns = [
        (np.dstack([_axes(poses[:, YAW]), body[..., :1]]), given),
        (-_axes(lamp_yaw), np.zeros(3)),
        (body @ _axes(yaw), bow),
    ]
    motion = np.zeros((len(poses), 2, 3, 10))  # shift and turn
    motion[:, 0, :, :3] = np.eye(3)
    for columns, (axes, pivot) in zip((slice(3, 6), slice(6, 8), slice(8, 10)), turns, strict=True):
        u, v, w = np.moveaxis(axes, -2, 0)
        x, y, z = (place - pivot).T[..., None]
        turned = v * z - w * y, w * x - u * z, u * y - v * x
        motion[:, 0, :, columns] = np.stack(turned, axis=1)
        motion[:, 1, :, columns] = axes
    return seen, roll, _by_motion(seen) @ (to_lamp[..., None, :, :] @ motion).reshape(-1, 6, 10)


def _axes(yaw: Array | float) -> Array:
    """Return the axes about which pitch and yaw turn, shape ``(..., 3, 2)``."""
    axes = np.zeros((*np.shape(yaw), 3, 2))
    axes[..., X, 0], axes[..., Y, 0], axes[..., Z, 1] = -np.sin(yaw), np.cos(yaw), 1.0
    return axes


def _by_motion(poses: Array) -> Array:
    """Return how slopes by a pose give those by a shift and a turn of the body, ``(m, 6, 6)``."""
    # The last slope by a pose is that of a turn of all about the beacon's x, which does not change
    # the light of a lamp at its origin; that by a turn of the body about x follows.
    _, y, z, _, yaw = poses.T
    slopes = np.zeros((len(poses), 6, 6))
    slopes[:, :3, :3] = np.eye(3)
    slopes[:, Y, 3], slopes[:, Z, 3], slopes[:, TURN, 3] = z, -y, 1.0
    slopes[:, :, 4] = slopes[:, :, 3] * np.tan(yaw)[:, None]
    slopes[:, PITCH, 4] = 1 / np.cos(yaw)
    slopes[:, YAW, 5] = 1.0
    return slopes
