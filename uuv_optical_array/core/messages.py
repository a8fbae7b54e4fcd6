"""Contents of messages, for ROS and for the reader and the writer of bags.

Messages from outside are checked. Ours have the constants below, unless a parameter says otherwise.
"""

from collections.abc import Sequence
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.geometry import FLU_FRD, Array
from uuv_optical_array.core.settings import Quantity

BEACON_FRAME, FOLLOWER_FRAME = "leader/beacon", "base_link_by_light"
BEACON_POSITION = Quantity("position of the lamp in the leader's base_link", "m", -100, 100)
ROLL_STD_RAD = 0.02
MAX_LENGTH_ERROR = 1e-2  # of a quaternion, by rounding
MAX_POSITION_M = 1e8  # beyond any place on Earth in any of its grids
# Faster than any underwater vehicle, m/s and rad/s: such numbers have other units.
MAX_TWIST = np.repeat([10.0, 6.0], 3)
NED, FRD = "_ned", "_frd"
Axes: TypeAlias = Literal["flu", "frd"]  # of an odometry, see `odometry_pose`


class Refused(ValueError):
    """A message that must not be used; the text gives the reason, its kind before the colon."""


def stamp_ns(header: Any) -> int:
    """Return the stamp of a ``std_msgs/Header`` in ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


class Readout(Protocol):
    """The part of `ArraySettings` that images are read by."""

    @property
    def detectors_per_side(self) -> int:
        """Rows and columns."""

    @property
    def wiring(self) -> Sequence[int] | None:
        """For each detector the place of its reading, in reading order; ``None``: its own."""


def in_place(pixels: Array, wiring: Sequence[int] | None) -> Array:
    """Return the images, ``(lamps side, side)``, of readings in the order of the wires."""
    if wiring is None:
        return pixels
    return pixels.reshape(-1, len(wiring))[:, list(wiring)].reshape(pixels.shape)


def as_wired(image: Array, wiring: Sequence[int] | None) -> Array:
    """Return the readings of an image in the order of the wires, the inverse of `in_place`."""
    if wiring is None:
        return image
    pixels = np.empty_like(image)
    pixels.reshape(-1, len(wiring))[:, list(wiring)] = image.reshape(-1, len(wiring))
    return pixels


def image_from_message(message: Any, array: Readout, lamps: int = 1) -> Array:
    """Unpack a mono16 ``sensor_msgs/Image`` of counts, whatever its padding and byte order.

    The readings are in place, ``(lamps side, side)``. Refused for another encoding, size or length.
    """
    side = array.detectors_per_side
    rows = lamps * side
    if message.encoding not in ("mono16", "16UC1"):
        raise Refused(f"wrong encoding: {message.encoding!r}, not mono16")
    if (message.height, message.width) != (rows, side):
        raise Refused(
            f"wrong size: {message.height} x {message.width}, but the scene has {rows} x {side}"
        )
    if message.step < 2 * side or message.step % 2:
        raise Refused(f"wrong step: {message.step} bytes a row, not {2 * side}")
    if len(message.data) != message.step * rows:
        raise Refused(
            f"truncated: {len(message.data)} bytes of data, but {rows} rows of {message.step}"
        )
    pixels = np.frombuffer(message.data, dtype=">u2" if message.is_bigendian else "<u2")
    return in_place(pixels.reshape(rows, -1)[:, :side].astype(float), array.wiring)


def checked_pose(pose: Any) -> tuple[Array, Array]:
    """Unpack a ``geometry_msgs/Pose``: position, m, shape ``(3,)``, and attitude, x y z w."""
    position = np.array([pose.position.x, pose.position.y, pose.position.z])
    if not np.isfinite(position).all():
        raise Refused(f"not finite: position {position.tolist()}")
    if (np.abs(position) > MAX_POSITION_M).any():
        raise Refused(
            f"out of bounds: position {position.tolist()}, not within +-{MAX_POSITION_M:g} m"
        )
    return position, checked_quaternion(pose.orientation)


def checked_quaternion(attitude: Any) -> Array:
    """Unpack a ``geometry_msgs/Quaternion`` as x, y, z, w of length 1, shape ``(4,)``."""
    quaternion = np.array([attitude.x, attitude.y, attitude.z, attitude.w])
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1) <= MAX_LENGTH_ERROR:
        raise Refused(
            f"bad attitude: quaternion {quaternion.tolist()} has length {length:g}, not 1"
        )
    return quaternion / length


def up_of_odometry(message: Any) -> Array | None:
    """Return where the world's up is in the axes of REP 103 of the body, a unit vector, ``(3,)``.

    ``None``: it is not given, as an attitude that was left out is all 0 or none. Frames whose names
    end with ``_ned`` or ``_frd`` have their z down.
    """
    attitude = message.pose.pose.orientation
    if (attitude.x, attitude.y, attitude.z) == (0.0, 0.0, 0.0) and attitude.w in (0.0, 1.0):
        return None
    rotation = Rotation.from_quat(checked_quaternion(attitude))
    up = rotation.inv().apply([0.0, 0.0, signs(message.header.frame_id)[2]])
    return np.asarray(up * signs(message.child_frame_id)[:3])


def odometry_pose(message: Any, axes: Axes = "flu") -> tuple[Array, Array]:
    """Unpack position, m, shape ``(3,)``, and attitude, x y z w, shape ``(4,)``, in REP 103's axes.

    The message's are ``flu``, which is REP 103, or ``frd``, aerospace: forward, right, down in NED.
    """
    position, quaternion = checked_pose(message.pose.pose)
    if axes == "frd":  # half a turn about x, of the world and of the body
        position = position * FLU_FRD
        quaternion = quaternion * [*FLU_FRD, 1]
    return position, quaternion


def signs(frame: str) -> Array:
    """Return the signs of a linear and an angular vector in the axes of a frame, shape ``(6,)``."""
    down = frame.endswith((NED, FRD))
    return np.tile(FLU_FRD, 2) if down else np.ones(6)


def twist_from_message(message: Any) -> tuple[Array, Array]:
    """Unpack linear, m/s, and angular velocity, rad/s, each of shape ``(3,)``."""
    return checked_twist(message.twist, message.header.frame_id)


def checked_twist(twist: Any, frame: str) -> tuple[Array, Array]:
    """Unpack a ``geometry_msgs/Twist`` in the axes of a frame, as `twist_from_message` does."""
    linear, angular = twist.linear, twist.angular
    values = np.array([linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])
    if not np.isfinite(values).all():
        raise Refused(f"not finite: twist {values.tolist()}")
    if (np.abs(values) > MAX_TWIST).any():
        speed, turn = MAX_TWIST[[0, 3]]
        raise Refused(
            f"out of bounds: twist {values.tolist()}, not within +-{speed:g} m/s and "
            f"+-{turn:g} rad/s"
        )
    values *= signs(frame)
    return values[:3], values[3:]
