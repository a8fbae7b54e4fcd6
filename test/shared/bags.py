"""Bags as ``ros2 bag record`` writes them, by the library `rosbags`."""

import functools
import itertools

import numpy as np
from scipy.spatial.transform import Rotation

TYPES = {"image": "sensor_msgs/msg/Image", "odometry": "nav_msgs/msg/Odometry"}


@functools.cache
def store():
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_KILTED)


def type_of(topic):
    return TYPES["odometry" if "odometry" in topic else "image"]


def write_bag(path, messages, storage="SQLITE3", version=9, packed=False, times=None):
    """Write messages ``(topic, bytes)``, received at `times`, or a nanosecond apart from 1 on."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    bag = Writer(path, version=version, storage_plugin=StoragePlugin[storage])
    if packed:
        bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with bag as writer:
        connections = {}
        for at, (topic, data) in zip(times or itertools.count(1), messages, strict=False):
            if topic not in connections:
                kind = type_of(topic)
                connections[topic] = writer.add_connection(topic, kind, typestore=store())
            writer.write(connections[topic], at, data)
    return path


def make(kind, *values):
    return store().types[kind.replace("/", "/msg/")](*values)


def header(stamp_ns, frame):
    stamp = make("builtin_interfaces/Time", *divmod(stamp_ns, 10**9))
    return make("std_msgs/Header", stamp, frame)


def image_message(stamp_ns, image):
    """Return topic and bytes of an image, counts."""
    rows, columns = image.shape
    pixels = np.frombuffer(image.astype("<u2").tobytes(), np.uint8)
    message = make(
        "sensor_msgs/Image", header(stamp_ns, "rov/array"), rows, columns, "mono16", 0,
        2 * columns, pixels,
    )  # fmt: skip
    return "/array/image", bytes(store().serialize_cdr(message, TYPES["image"]))


def odometry_message(topic, stamp_ns, position, quaternion):
    """Return topic and bytes of an odometry without a twist."""
    pose = make(
        "geometry_msgs/Pose",
        make("geometry_msgs/Point", *map(float, position)),
        make("geometry_msgs/Quaternion", *map(float, quaternion)),
    )
    still = make("geometry_msgs/Twist", *[make("geometry_msgs/Vector3", 0.0, 0.0, 0.0)] * 2)
    message = make(
        "nav_msgs/Odometry", header(stamp_ns, "odom"), "rov/base_link",
        make("geometry_msgs/PoseWithCovariance", pose, np.zeros(36)),
        make("geometry_msgs/TwistWithCovariance", still, np.zeros(36)),
    )  # fmt: skip
    return topic, bytes(store().serialize_cdr(message, TYPES["odometry"]))


AT_REST = (0, 0, 0), Rotation.identity()


def drive_messages(stamps, poses, images, rolls=0.0, leader=AT_REST):
    """Yield topics and bytes of a leader at rest, a follower at poses and rolls, and images."""
    at, level = leader
    rolls = np.broadcast_to(rolls, len(poses))
    for stamp, pose, roll, image in zip(map(int, stamps), poses, rolls, images, strict=True):
        yield odometry_message("/leader/odometry", stamp, at, level.as_quat())
        turn = level * Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
        place = at + level.apply(pose[:3])
        yield odometry_message("/follower/odometry", stamp, place, turn.as_quat())
        yield image_message(stamp, image)
