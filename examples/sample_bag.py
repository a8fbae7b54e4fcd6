"""Simulate the sample bag: images of a drive in a sea that the scene follow does not describe.

Run: python3 sample_bag.py FOLDER
The same command writes the same messages, as its noise has the seed 1. It needs rosbags.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from uuv_optical_array import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.recording.bag import IMAGE, ODOMETRY, BagWriter, message_types

RATE_HZ, IMAGES, SEED = 10, 400, 1
# What differs from the scene follow, and is to be found.
LAMP = {"beam_sigma_deg": 6.8, "reference_counts": 700.0}
EFFECTS = {
    "sea": {"absorption_per_m": 0.17, "scattering_per_m": 0.2},
    "ambient": {"level_counts": 14.0},
    "responsivity": {"spread": 0.05, "seed": 8},  # of the detectors
    "sensor_noise": {"sigma_counts": 1.5},
}


def relative(t):
    """Return pose and roll of a follower that runs from 3 to 7 m, weaves and noses about."""
    x = -5 + 2 * np.cos(2 * np.pi * t / 40)
    y, z = 0.5 * np.sin(0.4 * t), 0.45 * np.cos(0.5 * t)
    return np.array([x, y, z, 0.2 * np.sin(0.6 * t), 0.2 * np.cos(0.8 * t)]), 0.03 * np.sin(0.5 * t)


def leader(t):
    """Return position and rotation of a leader that turns and dives."""
    turn = Rotation.from_euler("ZYX", [0.6 * np.sin(0.2 * t), 0.1 * np.sin(0.5 * t), 0.0])
    return np.array([0.8 * t, 3 * np.sin(0.2 * t), -5 + np.sin(0.3 * t)]), turn


settings = load_scene("follow").settings()
settings["lamp"] |= LAMP
settings["effects"] |= EFFECTS
model, rng = ForwardModel(scene_from_settings(settings, "sample")), np.random.default_rng(SEED)
store = message_types()


def message(kind, **fields):
    """Return a message."""
    return store.types[kind](**fields)


def header(stamp_ns, frame):
    """Return the header of a message."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    stamp = message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def odometry(stamp_ns, position, turn):
    """Return an odometry without a twist."""
    x, y, z = map(float, position)
    point, still = message("geometry_msgs/msg/Point", x=x, y=y, z=z), dict(x=0.0, y=0.0, z=0.0)
    names = zip("xyzw", map(float, turn.as_quat()), strict=True)
    quaternion = message("geometry_msgs/msg/Quaternion", **dict(names))
    pose = message("geometry_msgs/msg/Pose", position=point, orientation=quaternion)
    vector = message("geometry_msgs/msg/Vector3", **still)
    twist = message("geometry_msgs/msg/Twist", linear=vector, angular=vector)
    return message(
        ODOMETRY,
        header=header(stamp_ns, "odom"),
        child_frame_id="base_link",
        pose=message("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=message(
            "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
        ),
    )


def image(stamp_ns, counts):
    """Return an image of the array."""
    rows, columns = counts.shape
    data = np.frombuffer(counts.astype("<u2").tobytes(), np.uint8)
    shape = {"height": rows, "width": columns, "step": 2 * columns, "is_bigendian": 0}
    return message(IMAGE, header=header(stamp_ns, "array"), encoding="mono16", data=data, **shape)


with BagWriter(Path(sys.argv[1])) as bag:
    for number in range(IMAGES):
        t, stamp_ns = number / RATE_HZ, (10 * RATE_HZ + number) * 10**9 // RATE_HZ
        pose, roll = relative(t)
        place, turn = leader(t)
        behind = turn * Rotation.from_euler("ZYX", [pose[4], pose[3], roll])
        counts = model.expose(pose, rng, roll, time_s=t)
        for topic, kind, filled in (
            ("/leader/odometry", ODOMETRY, odometry(stamp_ns, place, turn)),
            (
                "/follower/odometry",
                ODOMETRY,
                odometry(stamp_ns, place + turn.apply(pose[:3]), behind),
            ),
            ("/array/image", IMAGE, image(stamp_ns, counts)),
        ):
            bag.write(topic, kind, stamp_ns, bytes(store.serialize_cdr(filled, kind)))
