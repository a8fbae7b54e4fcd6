"""Roll, pitch and yaw to quaternion and back, for ROS messages."""

from collections.abc import Iterable
from math import cos, sin

from uuv_optical_array.core.geometry import roll_pitch_yaw as angles_of_matrix


def quaternion_xyzw(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of ``Rz(yaw) Ry(pitch) Rx(roll)``; angles in rad."""
    (sin_r, cos_r), (sin_p, cos_p), (sin_y, cos_y) = (
        (sin(angle / 2), cos(angle / 2)) for angle in map(float, (roll, pitch, yaw))
    )
    return (
        sin_r * cos_p * cos_y - cos_r * sin_p * sin_y,
        cos_r * sin_p * cos_y + sin_r * cos_p * sin_y,
        cos_r * cos_p * sin_y - sin_r * sin_p * cos_y,
        cos_r * cos_p * cos_y + sin_r * sin_p * sin_y,
    )


def roll_pitch_yaw(quaternion_xyzw: Iterable[float]) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in rad of a unit quaternion (x, y, z, w)."""
    x, y, z, w = map(float, quaternion_xyzw)
    matrix = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    roll, pitch, yaw = map(float, angles_of_matrix(matrix))
    return roll, pitch, yaw
