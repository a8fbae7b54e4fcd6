"""Bags of rosbag2, MCAP or SQLite, opened and written without ROS."""

import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any

from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.storage import files
from uuv_optical_array.recording import bag_files, truncated
from uuv_optical_array.recording.bag_files import SQLITE, Channel
from uuv_optical_array.recording.truncated import MCAP

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


class Bag:
    """An open bag."""

    def __init__(
        self, files: list[bag_files.BagFile], told: Counter[Channel], lost: Counter[str]
    ) -> None:
        self._files, self._types = files, message_types()
        # What it holds, or should by its metadata.
        self.counts: Counter[Channel] = sum((file.counts for file in files), Counter())
        self._expected = self.counts | told
        self.lost = lost  # what is missing or cannot be used, in words; complete after `messages`

    def messages(self, wanted: Mapping[str, str]) -> Iterator[tuple[int, Channel, Any]]:
        """Yield time, ns, channel and message of topics, each with its type, by time.

        What is of another type or encoding, garbled, or not there is counted in `lost`.
        """
        channels = {Channel(topic, kind, "cdr") for topic, kind in wanted.items()}
        for channel, count in self.counts.items():
            if channel.topic in wanted and channel not in channels:
                other = f"{channel.kind or 'of no type'} in {channel.encoding}"
                self.lost[f"{channel.topic}: {other}, not {wanted[channel.topic]}"] += count
        read: Counter[Channel] = Counter()
        sources = [file.messages(channels) for file in self._files]
        for time, channel, data in merge(*sources, key=itemgetter(0)):
            read[channel] += 1
            try:
                message = self._types.deserialize_cdr(bag_files.message(data), channel.kind)
            except Exception:  # bytes of anything raise anything
                self.lost[f"{channel.topic}: not a message of its type"] += 1
                continue
            yield time, channel, message
        for channel in channels:
            if missing := max(self._expected[channel] - read[channel], 0):
                self.lost[f"{channel.topic}: counted in metadata.yaml, but in no file"] += missing


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Open the folder of a rosbag2, or one of its files, as they are or packed by zstd.

    A folder is read file by file, by its ``metadata.yaml`` if there is one, and every whole message
    of a truncated MCAP file. FileNotFoundError where it does not exist; ValueError, of one line,
    where it cannot be read.
    """
    message_types()  # or what to install
    if not path.exists():
        raise FileNotFoundError(f"bag {path}: no such file or folder")
    lost: Counter[str] = Counter()
    parts, told = [path], Counter[Channel]()
    try:
        with ExitStack() as stack:
            if path.is_dir():
                parts, told = _parts(path, lost)
            files = []
            for part in parts:
                folder = tempfile.TemporaryDirectory(prefix="uuv_optical_array_")
                scratch = Path(stack.enter_context(folder))
                files.append(bag_files.opened(part, scratch, lost, stack))
            yield Bag(files, told, lost)
    except (OSError, ValueError) as error:
        raise ValueError(f"bag {path}: {' '.join(str(error).split())}") from None
    except Exception as error:  # the storages have types of their own
        words = " ".join(f"{type(error).__name__} {error}".split())
        if database := next((part for part in parts if part.suffix == SQLITE), None):
            words += f"; to recover the rest: sqlite3 {database} .recover | sqlite3 NEW{SQLITE}"
        raise ValueError(f"bag {path}: not a bag that can be read: {words}") from error


def _parts(folder: Path, lost: Counter[str]) -> tuple[list[Path], Counter[Channel]]:
    """Return the files of a bag, and how many messages there are by its metadata."""
    found = bag_files.parts(folder)
    if not found:
        raise ValueError("no bag: it has no file .mcap or .db3")
    names, told = bag_files.told_of(folder, lost)
    named = [part for part in found if part.name in names]
    if named:  # else their names were changed
        for part in set(found) - set(named):
            lost[f"{part.name}, which metadata.yaml does not name"] += 1
    return named or found, told


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
