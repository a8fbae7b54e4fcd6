"""Results of a replay as a bag, as CSV, and as trajectories in TUM's format."""

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.geometry import PITCH, YAW, Array, covariance_6x6
from uuv_optical_array.core.messages import BEACON_FRAME, FOLLOWER_FRAME, ROLL_STD_RAD
from uuv_optical_array.core.storage import files
from uuv_optical_array.core.storage.formats import csv_text
from uuv_optical_array.estimation.pipeline import Answer
from uuv_optical_array.estimation.tracking.track import relative_odometry
from uuv_optical_array.recording.bag import BagWriter, message_types
from uuv_optical_array.recording.images import Recording

COLUMNS = "x_m", "y_m", "z_m", "pitch_rad", "yaw_rad"


def write_results(folder: Path, frames: Sequence[Answer], recording: Recording) -> list[str]:
    """Write the results of a replay, and the true poses, into an empty folder; return the names."""
    write_csv(folder / "frames.csv", frames)
    write_bag(folder / "bag", frames)
    truth = zip(recording.stamps_ns, recording.poses, recording.rolls, strict=True)
    trajectories = {
        "relative_pose.tum": [
            (f.stamp_ns, f.estimate.pose, f.estimate.roll) for f in frames if f.estimate
        ],
        "relative_odometry.tum": [
            (f.stamp_ns, f.track.pose, f.estimate.roll) for f in frames if f.track and f.estimate
        ],
        "truth.tum": [(int(s), p, roll) for s, p, roll in truth if np.isfinite([*p, roll]).all()],
    }
    names = ["frames.csv", "bag", *(name for name, poses in trajectories.items() if poses)]
    for name in names[2:]:
        write_tum(folder / name, trajectories[name])
    return names


def write_csv(path: Path, frames: Iterable[Answer]) -> None:
    """Write a line for each image: the pose and its standard deviations, or why there is none."""
    columns = ["stamp_s", *COLUMNS, *(f"std_{name}" for name in COLUMNS), "misfit", "no_pose"]
    rows = []
    for frame in frames:
        results = [""] * 11
        if frame.estimate is not None:
            stds = np.sqrt(frame.estimate.covariance.diagonal())
            figures = [*frame.estimate.pose, *stds, frame.estimate.misfit]
            results = ["" if math.isnan(value) else f"{value:.9g}" for value in figures]
        cells = [_seconds(frame.stamp_ns), *results, frame.reason]
        rows.append(dict(zip(columns, cells, strict=True)))
    files.write_text(path, csv_text(columns, rows))


def write_tum(path: Path, poses: Iterable[tuple[int, Array, float]]) -> None:
    """Write stamp, position and quaternion x y z w of each (stamp in ns, pose, roll)."""
    lines = []
    for stamp, pose, roll in poses:
        numbers = " ".join(f"{value:.9f}" for value in _transform(pose, roll))
        lines.append(f"{_seconds(stamp)} {numbers}\n")
    files.write_text(path, "".join(lines))


def write_bag(path: Path, frames: Iterable[Answer]) -> None:
    """Write the topics that the estimator node publishes, each message at its own stamp."""
    types = message_types()
    with BagWriter(path) as bag:
        for frame in frames:
            for topic, message in _messages(types.types, frame):
                kind = message.__msgtype__
                bag.write(topic, kind, frame.stamp_ns, bytes(types.serialize_cdr(message, kind)))


def _messages(types: Any, frame: Answer) -> Iterator[tuple[str, Any]]:
    """Yield topic and message of a frame, of the types of `message_types`."""

    def make(kind: str, *values: Any) -> Any:
        return types[kind.replace("/", "/msg/")](*values)

    def pose_message(pose: Array, roll: float, covariance: Array) -> Any:
        numbers = _transform(pose, roll)
        position = make("geometry_msgs/Point", *numbers[:3])
        attitude = make("geometry_msgs/Quaternion", *numbers[3:])
        return make(
            "geometry_msgs/PoseWithCovariance",
            make("geometry_msgs/Pose", position, attitude),
            covariance.ravel(),
        )

    stamp = make("builtin_interfaces/Time", *divmod(frame.stamp_ns, 10**9))
    header = make("std_msgs/Header", stamp, BEACON_FRAME)
    estimate = frame.estimate
    if estimate is None:
        return
    covariance = covariance_6x6(estimate.pose, estimate.covariance, ROLL_STD_RAD, estimate.turn)
    message = pose_message(estimate.pose, estimate.roll, covariance)
    yield "/relative_pose", make("geometry_msgs/PoseWithCovarianceStamped", header, message)
    if frame.track is not None:
        odometry = relative_odometry(frame.track, estimate.roll, ROLL_STD_RAD)
        linear, angular = (
            make("geometry_msgs/Vector3", *part.tolist()) for part in np.split(odometry.twist, 2)
        )
        twist = make("geometry_msgs/Twist", linear, angular)
        twist = make("geometry_msgs/TwistWithCovariance", twist, odometry.spread.ravel())
        message = pose_message(odometry.pose, estimate.roll, odometry.covariance)
        yield (
            "/relative_odometry",
            make("nav_msgs/Odometry", header, FOLLOWER_FRAME, message, twist),
        )


def _transform(pose: Array, roll: float) -> list[float]:
    """Return position and quaternion x, y, z, w."""
    attitude = Rotation.from_euler("ZYX", [pose[YAW], pose[PITCH], roll])
    return [*pose[:3].tolist(), *attitude.as_quat().tolist()]


def _seconds(stamp_ns: int) -> str:
    seconds, rest = divmod(int(stamp_ns), 10**9)
    return f"{seconds}.{rest:09d}"
