"""Bags of rosbag2, MCAP or SQLite, opened and written without ROS."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.storage import files
from uuv_optical_array.recording import truncated
from uuv_optical_array.recording.truncated import MCAP

SQLITE = ".db3"
IMAGE, ODOMETRY = "sensor_msgs/msg/Image", "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/TwistStamped"
STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
RUN = {  # topics of a run that are recorded
    "array/image": IMAGE,
    "array/features": "sensor_msgs/msg/PointCloud2",
    "relative_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "relative_odometry": ODOMETRY,
    "leader/odometry": ODOMETRY,
    "follower/odometry": ODOMETRY,
    "cmd_vel": TWIST,
    "follow_state": STATUS,
}


def message_types() -> Any:
    """Return Humble's message definitions; ours are the same in later distributions."""
    typesys = needs("bags", "rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


@contextmanager
def opened(path: Path) -> Iterator[tuple[Any, list[str]]]:
    """Open the folder of a rosbag2, or one of its ``.mcap`` or ``.db3`` files.

    Yields a ``rosbags.highlevel.AnyReader``, and what is missing, a line each. A folder without
    ``metadata.yaml`` is read file by file, and every whole message of a truncated MCAP file.
    FileNotFoundError where it does not exist; ValueError, of one line, where it cannot be read.
    """
    reading = needs("bags", "rosbags.highlevel.anyreader")
    if not path.exists():
        raise FileNotFoundError(f"bag {path}: no such file or folder")
    try:
        with tempfile.TemporaryDirectory(prefix="uuv_optical_array_") as scratch:
            paths, lost = _readable(path, Path(scratch))
            with reading.AnyReader(paths, default_typestore=message_types()) as reader:
                yield reader, lost
    except (OSError, ValueError) as error:
        raise ValueError(f"bag {path}: {' '.join(str(error).split())}") from None
    except Exception as error:  # storage, metadata and deserialiser have types of their own
        words = " ".join(f"{type(error).__name__} {error}".split())
        if database := next((part for part in _parts(path) if part.suffix == SQLITE), None):
            words += f"; what is whole of it: sqlite3 {database} .recover | sqlite3 NEW{SQLITE}"
        raise ValueError(f"bag {path}: not a bag that can be read: {words}") from error


def _parts(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return sorted(part for part in path.iterdir() if part.suffix in (MCAP, SQLITE))


def _readable(path: Path, scratch: Path) -> tuple[list[Path], list[str]]:
    """Return what to open, the bag itself or its files, with truncated ones repaired."""
    parts = _parts(path)
    cut = [file for file in parts if truncated.is_truncated(file)]
    if path.is_dir() and not cut:
        if (path / "metadata.yaml").is_file():
            return [path], []
        if not parts:
            raise ValueError("no bag: it has neither metadata.yaml nor a file .mcap or .db3")
    for file in cut:
        truncated.copy(file, scratch / file.name)
    paths = [scratch / file.name if file in cut else file for file in parts]
    return paths, [f"the end of {file.name}, which is cut off or damaged" for file in cut]


class BagWriter:
    """A new bag of one MCAP file; ValueError if it exists or ``bags`` is not installed."""

    def __init__(self, path: Path) -> None:
        rosbag2 = needs("bags", "rosbags.rosbag2")
        if path.exists():
            raise ValueError(f"bag {path}: it exists; name a new one")
        self._path, self._types = path, message_types()
        self._bag = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> "BagWriter":
        with files.naming(self._path):
            self._bag.open()
        return self

    def __exit__(self, *_: object) -> None:
        with files.naming(self._path):
            self._bag.close()  # with its index, however the run ended
            file = self._path / f"{self._path.name}{MCAP}"
            with files.whole_file(file) as summed:  # rosbags writes no checksums
                truncated.copy(file, summed)

    def write(self, topic: str, kind: str, stamp_ns: int, data: bytes) -> None:
        """Write a serialised message of a type such as ``sensor_msgs/msg/Image`` and its time, ns.

        OSError, with the bag's name, such as where the disk is full; what was written stays.
        """
        with files.naming(self._path):
            if topic not in self._connections:
                self._connections[topic] = self._bag.add_connection(
                    topic, kind, typestore=self._types
                )
            self._bag.write(self._connections[topic], stamp_ns, data)
