"""Between arrays and ROS messages; every message from outside is checked here.

Inside of the package all axes are those of REP 103. A frame whose name ends in ``_ned`` or ``_frd``
has forward (or north), right (or east) and down: here its messages get half a turn about x.
"""

import math
import re
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any

import numpy as np
from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, Imu, PointCloud2, PointField, Range
from std_msgs.msg import Header

from uuv_optical_array.core.geometry import PITCH, YAW, Array, pose_rate, rotation_matrix
from uuv_optical_array.core.geometry import roll_pitch_yaw as angles_of_matrix
from uuv_optical_array.core.messages import (
    FRD,
    NED,
    Refused,
    checked_pose,
    checked_quaternion,
    checked_twist,
    signs,
    stamp_ns,
)
from uuv_optical_array.estimation.signature.features import FEATURE_NAMES
from uuv_optical_array.nodes.shared.attitude import quaternion_xyzw, roll_pitch_yaw

_POINT_BYTES = 8 * len(FEATURE_NAMES)
MAX_ROLL_VARIANCE = 1.0  # rad^2; a roll that is known no better is not known
MAX_RANGE_M = 1000.0  # of simulated ranges
MAX_COVARIANCE = 1e12  # beyond any sea, m^2, m rad or rad^2


def body_beside(parent: str, body: str) -> str:
    """Return the name of a body's frame whose axes go with those of the frame it is placed in."""
    down = parent.endswith((NED, FRD)) and not body.endswith((NED, FRD))
    return body + FRD if down else body


def not_finite(message: Any) -> str:
    """Return where in a ROS message a number is not finite; empty where all are."""
    if isinstance(message, PointCloud2):  # of `features_to_message`
        return "" if np.isfinite(np.frombuffer(message.data, dtype="<f8")).all() else "data"
    numbers, arrays, messages = _places(message.__class__)
    for name, get in numbers:
        if not math.isfinite(get(message)):
            return name
    for name, get in arrays:
        if not np.isfinite(get(message)).all():
            return name
    for name, get in messages:
        for part in get(message):
            if where := not_finite(part):
                return f"{name}.{where}"
    return ""


@cache
def _places(message_type: Any) -> list[list[tuple[str, Callable[[Any], Any]]]]:
    """Return where floats, arrays of them and lists of messages are, and what gets them."""
    places: list[list[str]] = [[], [], []]
    usual = message_type()
    for name, kind in message_type.get_fields_and_field_types().items():
        several = kind[-1] in "]>"
        if "/" in kind and not several:
            for names, inner in zip(places, _places(getattr(usual, name).__class__), strict=True):
                names += [f"{name}.{place}" for place, _ in inner]
        elif re.search("/|double|float", kind):
            places[2 if "/" in kind else several].append(name)
    return [[(name, attrgetter(name)) for name in names] for names in places]


class StampOrder:
    """Let stamps only move forward, but let a stream restart.

    A stamp that is not later than the newest is refused. Only if two in a row advance, more than
    `RESTART_NS` behind the newest, was the clock set back, or the newest wrong: the stream
    restarts. A stamp `AHEAD_NS` ahead of a given clock is refused, too, if the one before was not.
    """

    RESTART_NS, AHEAD_NS = 500_000_000, 300_000_000

    def __init__(self) -> None:
        self._ahead = True
        self._newest_ns: int | None = None
        self._far_behind_ns: int | None = None  # the stamp before, where it was that

    def check_fresh(self, header: Header, now_ns: float) -> None:
        """Refuse a stamp that is the newest again, or leaps ahead of a clock; let a late one be."""
        stamp = stamp_ns(header)
        self._check_clock(stamp, now_ns)
        if stamp == self._newest_ns:
            raise self._not_later(stamp)

    def set_back(self, header: Header, late_ns: int) -> bool:
        """Say whether the stream restarts with a stamp that may be late, by so much, ns.

        The first that is farther behind, of the two that it takes, is refused.
        """
        stamp, newest, behind = stamp_ns(header), self._newest_ns, self._far_behind_ns
        if newest is None or newest - stamp <= max(late_ns, self.RESTART_NS):
            return False
        self._far_behind_ns = stamp
        if behind is None or stamp <= behind:
            raise self._not_later(stamp)
        self._newest_ns = behind
        return True

    def check(self, header: Header, now_ns: float | None = None) -> None:
        """Refuse a stamp that does not advance, or leaps ahead of a clock."""
        stamp, newest, behind = stamp_ns(header), self._newest_ns, self._far_behind_ns
        if now_ns is not None:
            self._check_clock(stamp, now_ns)
        far = newest is not None and newest - stamp > self.RESTART_NS
        anew = far and behind is not None and stamp > behind
        if newest is None or stamp > newest or anew:
            self._newest_ns, self._far_behind_ns = stamp, None
            return
        self._far_behind_ns = stamp if far else None
        raise self._not_later(stamp)

    def _check_clock(self, stamp: int, now_ns: float) -> None:
        before, self._ahead = self._ahead, stamp - now_ns > self.AHEAD_NS
        if self._ahead and not before:
            raise Refused(f"stamp ahead: {(stamp - now_ns) * 1e-9:.3g} s later than the clock")

    def _not_later(self, stamp: int) -> Refused:
        newest = self._newest_ns or 0
        text = f"stamp not later: {stamp * 1e-9:.9f} s came after {newest * 1e-9:.9f} s"
        alike = "; if all are alike, the driver gives none: let it set `header.stamp`"
        return Refused(text + alike if stamp == newest else text)


def image_to_message(image: Array, header: Header) -> Image:
    """Pack an image of counts, shape ``(rows, columns)``, 0 to 65535, as mono16."""
    pixels = np.ascontiguousarray(image, dtype="<u2")
    rows, columns = pixels.shape
    return Image(
        header=header,
        height=rows,
        width=columns,
        encoding="mono16",
        is_bigendian=0,
        step=2 * columns,
        data=pixels.tobytes(),
    )


def features_to_message(parameters: Array | None, header: Header) -> PointCloud2:
    """Pack key parameters, shape ``(5,)``, as one point, or as none where there is no light."""
    data = b"" if parameters is None else np.asarray(parameters, dtype="<f8").tobytes()
    return PointCloud2(
        header=header,
        height=1,
        width=0 if parameters is None else 1,
        fields=[
            PointField(name=name, offset=8 * i, datatype=PointField.FLOAT64, count=1)
            for i, name in enumerate(FEATURE_NAMES)
        ],
        is_bigendian=False,
        point_step=_POINT_BYTES,
        row_step=len(data),
        data=data,
        is_dense=True,
    )


def features_from_message(message: PointCloud2) -> Array | None:
    """Unpack the key parameters, shape ``(5,)``; ``None`` for a cloud without a point."""
    names = tuple(field.name for field in message.fields)
    if names != FEATURE_NAMES:
        raise Refused(f"wrong fields: {', '.join(names)}, not {', '.join(FEATURE_NAMES)}")
    if any(field.datatype != PointField.FLOAT64 or field.count != 1 for field in message.fields):
        raise Refused("wrong field type: each field must be one FLOAT64")
    if [field.offset for field in message.fields] != list(range(0, _POINT_BYTES, 8)):
        raise Refused("wrong field offsets: they must be 0, 8, 16, 24, 32")
    points = message.width * message.height
    if points == 0:
        return None
    if points > 1:
        raise Refused(f"wrong size: {points} points, not one")
    if len(message.data) != _POINT_BYTES:
        raise Refused(f"truncated: {len(message.data)} bytes of data, not {_POINT_BYTES}")
    values = np.frombuffer(message.data, dtype=">f8" if message.is_bigendian else "<f8")
    if not np.isfinite(values).all():
        raise Refused(f"not finite: {dict(zip(FEATURE_NAMES, values.tolist(), strict=True))}")
    return values.astype(float)


def write_pose(message: Pose, position: Array, pitch: float, yaw: float, roll: float = 0.0) -> None:
    """Write a position, m, shape ``(3,)``, and an attitude, rad, into a message."""
    place, attitude = message.position, message.orientation
    place.x, place.y, place.z = map(float, position)
    attitude.x, attitude.y, attitude.z, attitude.w = quaternion_xyzw(roll, pitch, yaw)


def write_twist(message: Twist, linear: Array, angular: Array) -> None:
    """Write velocities, m/s and rad/s, shape ``(3,)`` each, into a message."""
    message.linear.x, message.linear.y, message.linear.z = map(float, linear)
    message.angular.x, message.angular.y, message.angular.z = map(float, angular)


def pose_to_message(
    pose: Array, covariance: Array, header: Header, roll: float = 0.0
) -> PoseWithCovarianceStamped:
    """Pack a pose ``(x, y, z, pitch, yaw)``, its roll, and its 6x6 covariance."""
    message, sign = PoseWithCovarianceStamped(header=header), signs(header.frame_id)
    *place, pitch, yaw = map(float, pose)
    write_pose(message.pose.pose, sign[:3] * place, sign[4] * pitch, sign[5] * yaw, roll)
    message.pose.covariance = (sign[:, None] * covariance * sign).ravel()
    return message


def odometry_to_message(
    pose: PoseWithCovarianceStamped, child_frame: str, twist: Array, covariance: Array
) -> Odometry:
    """Pack a pose, and the twist of the frame that it places with its 6x6 covariance.

    The twist, m/s and rad/s, ``(6,)``, is in REP 103's axes; the message has those of the frame.
    """
    frame = body_beside(pose.header.frame_id, child_frame)
    message = Odometry(header=pose.header, pose=pose.pose, child_frame_id=frame)
    sign = signs(frame)
    write_twist(message.twist.twist, *np.split(sign * twist, 2))
    message.twist.covariance = (np.outer(sign, sign) * covariance).ravel()
    return message


def inverse_to_message(pose: Array, header: Header, roll: float = 0.0) -> PoseStamped:
    """Pack where the beacon is in the follower's frame, of a pose ``(x, y, z, pitch, yaw)``."""
    to_follower = rotation_matrix(pose[PITCH], pose[YAW], roll).T
    message, sign = PoseStamped(header=header), signs(header.frame_id)
    roll, pitch, yaw = sign[3:] * angles_of_matrix(to_follower)
    write_pose(message.pose, sign[:3] * -(to_follower @ pose[:3]), pitch, yaw, roll)
    return message


def pose_from_message(message: PoseWithCovarianceStamped | Odometry) -> Array:
    """Unpack a relative pose as ``(x, y, z, pitch, yaw)``, m and rad."""
    position, quaternion = checked_pose(message.pose.pose)
    _, pitch, yaw = roll_pitch_yaw(quaternion)
    sign = signs(message.header.frame_id)
    return np.array([*position, pitch, yaw]) * [*sign[:3], *sign[4:]]


def rate_from_message(message: Odometry) -> Array:
    """Unpack the rate of the pose that `pose_from_message` returns, m/s and rad/s."""
    _, quaternion = checked_pose(message.pose.pose)
    roll, _, _ = roll_pitch_yaw(quaternion)
    twist = checked_twist(message.twist.twist, message.child_frame_id)
    # The roll is about the x axis, which is the same in all conventions.
    return pose_rate(pose_from_message(message), np.concatenate(twist), roll)


def rate_covariance_from_message(message: Odometry) -> Array:
    """Unpack the covariance of the rate that `rate_from_message` returns, ``(5, 5)``.

    It is a little too large, by what errors of the attitude add to that of the twist.
    """
    pose, (_, quaternion) = pose_from_message(message), checked_pose(message.pose.pose)
    roll, _, _ = roll_pitch_yaw(quaternion)
    by_twist = np.array([pose_rate(pose, twist, roll) for twist in np.eye(6)]).T
    covariance: Array = by_twist @ twist_covariance_from_message(message) @ by_twist.T
    return covariance


def covariance_from_message(message: PoseWithCovarianceStamped | Odometry) -> Array:
    """Unpack the 6x6 covariance of a pose."""
    return _covariance("pose", message.pose.covariance, message.header.frame_id)


def twist_covariance_from_message(message: Odometry) -> Array:
    """Unpack the 6x6 covariance of the twist of an odometry."""
    return _covariance("twist", message.twist.covariance, message.child_frame_id)


def _covariance(name: str, values: Any, frame: str) -> Array:
    covariance = np.reshape(values, (6, 6)).astype(float)
    if not np.isfinite(covariance).all():
        raise Refused(f"not finite: the {name}'s covariance")
    if (np.abs(covariance) > MAX_COVARIANCE).any():
        raise Refused(
            f"out of bounds: the {name}'s covariance, with {np.abs(covariance).max():g}, not "
            f"within +-{MAX_COVARIANCE:g}"
        )
    sign = signs(frame)
    return np.outer(sign, sign) * covariance


def imu_roll(message: Imu) -> float:
    """Unpack the roll of an IMU, rad."""
    if message.orientation_covariance[0] == -1:
        raise Refused("no orientation: the imu says that it has none")
    variances = np.asarray(message.orientation_covariance)[[0, 4, 8]]
    if not ((variances >= 0).all() and variances[0] <= MAX_ROLL_VARIANCE):
        raise Refused(
            f"out of bounds: variances of the orientation {variances.tolist()}; they must be at "
            f"least 0, and that of the roll at most {MAX_ROLL_VARIANCE:g} rad^2"
        )
    roll, _, _ = roll_pitch_yaw(checked_quaternion(message.orientation))
    return roll


def range_from_message(message: Range, usual_std: float) -> tuple[float, float]:
    """Unpack a range and its standard deviation, m: the usual one where the message has none."""
    measured, variance = message.range, getattr(message, "variance", 0.0)  # which Humble has not
    if not math.isfinite(measured):
        raise Refused(f"not finite: the range is {measured}")
    if not 0 <= variance < math.inf:
        raise Refused(f"out of bounds: the range's variance of {variance:g} m^2, not from 0")
    if not message.min_range <= measured <= (message.max_range or math.inf):
        raise Refused(
            f"out of bounds: the range of {measured:g} m, not within its sensor's "
            f"{message.min_range:g} to {message.max_range:g} m"
        )
    return measured, math.sqrt(variance) or usual_std


def range_to_message(measured: float, std: float, header: Header) -> Range:
    """Pack a range and its standard deviation, m, where the message has a place for it."""
    message = Range(header=header, radiation_type=Range.ULTRASOUND, range=measured)
    message.max_range = MAX_RANGE_M
    if hasattr(message, "variance"):
        message.variance = std**2
    return message


def twist_to_message(linear: Array, angular: Array, header: Header) -> TwistStamped:
    """Pack a twist in m/s and rad/s, each of shape ``(3,)``."""
    message, sign = TwistStamped(header=header), signs(header.frame_id)
    write_twist(message.twist, sign[:3] * linear, sign[3:] * angular)
    return message
