"""Odometry messages, written and read with SciPy."""

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation


def time_of(nanoseconds):
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def odometry(stamp_ns, position, rotation=None, frame="odom", child="base_link"):
    message = Odometry(child_frame_id=child)
    message.header.stamp, message.header.frame_id = time_of(stamp_ns), frame
    p, q = message.pose.pose.position, message.pose.pose.orientation
    p.x, p.y, p.z = map(float, position)
    q.x, q.y, q.z, q.w = map(float, (rotation or Rotation.identity()).as_quat())
    return message


def position(message):
    p = message.pose.pose.position
    return np.array([p.x, p.y, p.z])


def rotation(message):
    q = message.pose.pose.orientation
    return Rotation.from_quat([q.x, q.y, q.z, q.w])
