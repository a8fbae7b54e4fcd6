"""Roll, pitch and yaw to quaternion and back, for ROS messages."""

try:
    from tf_transformations import euler_from_quaternion, quaternion_from_euler
except ImportError:  # no ROS installation: the library under tf_transformations
    from transforms3d.euler import euler2quat, quat2euler

    def quaternion_from_euler(roll, pitch, yaw):
        """Return x, y, z, w, as tf_transformations does."""
        w, x, y, z = euler2quat(roll, pitch, yaw)
        return x, y, z, w

    def euler_from_quaternion(quaternion):
        """Return roll, pitch and yaw of x, y, z, w, as tf_transformations does."""
        x, y, z, w = quaternion
        return quat2euler((w, x, y, z))


def quaternion_xyzw(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of ``Rz(yaw) Ry(pitch) Rx(roll)``; angles in rad."""
    x, y, z, w = quaternion_from_euler(roll, pitch, yaw)
    return float(x), float(y), float(z), float(w)


def roll_pitch_yaw(quaternion_xyzw) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in rad of a unit quaternion (x, y, z, w)."""
    roll, pitch, yaw = euler_from_quaternion(quaternion_xyzw)
    return float(roll), float(pitch), float(yaw)
