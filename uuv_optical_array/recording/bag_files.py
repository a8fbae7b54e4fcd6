"""The files of a bag, MCAP or SQLite, and their messages in the order of time.

Messages are found by the files alone: what is odd in ``metadata.yaml``, or in the definition of a
type that is not asked for, hides none.
"""

import shutil
import sqlite3
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import NamedTuple

from uuv_optical_array.core.extras import needs
from uuv_optical_array.core.storage import yaml_text
from uuv_optical_array.recording import truncated
from uuv_optical_array.recording.truncated import MAGIC, MCAP

SQLITE, PACKED = ".db3", ".zstd"
DATABASE, PACK = b"SQLite format 3\0", b"\x28\xb5\x2f\xfd"  # how such files and messages begin
JOURNALS = "-wal", "-journal"  # what a killed writer leaves beside its database
UNREAD = "the counts of metadata.yaml, which cannot be read"


class Channel(NamedTuple):
    """Messages of one kind."""

    topic: str
    kind: str  # such as ``sensor_msgs/msg/Image``
    encoding: str  # ``cdr`` of ROS


class BagFile(NamedTuple):
    """What an open file holds."""

    counts: Counter[Channel]
    # Of channels: time, ns, channel and bytes of each message, in the order of time.
    messages: Callable[[Collection[Channel]], Iterator[tuple[int, Channel, bytes]]]


def parts(folder: Path) -> list[Path]:
    """Return the files of a bag in a folder, by name."""
    return sorted(
        part
        for part in folder.iterdir()
        if part.name.removesuffix(PACKED).endswith((MCAP, SQLITE)) and part.is_file()
    )


def told_of(folder: Path, lost: Counter[str]) -> tuple[set[str], Counter[Channel]]:
    """Return names of files, and counts, that ``metadata.yaml`` gives: nothing without one."""
    names: set[str] = set()
    counts: Counter[Channel] = Counter()
    try:
        told = yaml_text.read(folder / "metadata.yaml")["rosbag2_bagfile_information"]
        names = {Path(name).name for name in told["relative_file_paths"]}
        for topic in told["topics_with_message_count"]:
            about = topic["topic_metadata"]
            channel = Channel(about["name"], about["type"], about["serialization_format"])
            counts[channel] += int(topic["message_count"])
    except FileNotFoundError:
        pass
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        lost[UNREAD] = 1
    return names, counts


def opened(path: Path, scratch: Path, lost: Counter[str], stack: ExitStack) -> BagFile:
    """Open a file, until a stack is closed, with the help of a scratch folder.

    `lost` counts what is missing of it, in words. ValueError for a file of another kind.
    """
    if path.suffix == PACKED:
        path = _unpacked(path, scratch)
    with path.open("rb") as file:
        head = file.read(len(DATABASE))
    if head.startswith(MAGIC):
        return _mcap(path, scratch, lost, stack)
    if head == DATABASE:
        return _database(path, scratch, lost, stack)
    raise ValueError(f"{path.name}: neither MCAP nor SQLite")


def _unpacked(path: Path, scratch: Path) -> Path:
    """Unpack a file; of one that is cut off what is whole."""
    whole = scratch / path.name.removesuffix(PACKED)
    with path.open("rb") as source, whole.open("wb") as target:
        needs("bags", "zstandard").ZstdDecompressor().copy_stream(source, target)
    return whole


def message(data: bytes) -> bytes:
    """Return the bytes of a message, which may be packed; none of ROS begins so."""
    if not data.startswith(PACK):
        return data
    unpacked: bytes = needs("bags", "zstandard").ZstdDecompressor().decompressobj().decompress(data)
    return unpacked


def _mcap(path: Path, scratch: Path, lost: Counter[str], stack: ExitStack) -> BagFile:
    if truncated.is_truncated(path):
        lost[f"the end of {path.name}, which is cut off or damaged"] += 1
        path = truncated.copy(path, scratch / path.name)
    reader = truncated.reader_of(stack.enter_context(path.open("rb")))
    if reader is None:  # whole, but without an index
        path = truncated.copy(path, scratch / path.name)
        reader = truncated.reader_of(stack.enter_context(path.open("rb")))
    assert reader is not None
    summary = reader.get_summary()
    channels = {}
    for number, channel in summary.channels.items():
        schema = summary.schemas.get(channel.schema_id)
        kind = "" if schema is None else schema.name
        channels[number] = Channel(channel.topic, kind, channel.message_encoding)
    counts: Counter[Channel] = Counter()
    for number, count in summary.statistics.channel_message_counts.items():
        counts[channels[number]] += count

    def messages(wanted: Collection[Channel]) -> Iterator[tuple[int, Channel, bytes]]:
        topics = {channel.topic for channel in wanted}
        for _, channel, found in reader.iter_messages(topics=topics):
            if channels[channel.id] in wanted:
                yield found.log_time, channels[channel.id], found.data

    return BagFile(counts, messages)


def _database(path: Path, scratch: Path, lost: Counter[str], stack: ExitStack) -> BagFile:
    beside = [path.with_name(path.name + ending) for ending in JOURNALS]
    beside = [journal for journal in beside if journal.is_file()]
    if beside:  # SQLite works them into the database, which is the user's
        for file in (path, *beside):
            shutil.copyfile(file, scratch / file.name)
        path = scratch / path.name
    address = f"{path.absolute().as_uri()}?immutable={int(not beside)}"
    base = stack.enter_context(closing(sqlite3.connect(address, uri=True)))
    base.text_factory = lambda text: text.decode("utf-8", "replace")
    topics = base.execute("SELECT id, name, type, serialization_format FROM topics")
    channels = {number: Channel(*about) for number, *about in topics}
    counts: Counter[Channel] = Counter()
    for number, count in base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"):
        if number in channels:
            counts[channels[number]] += count
        else:
            lost["messages of no topic"] += count

    def messages(wanted: Collection[Channel]) -> Iterator[tuple[int, Channel, bytes]]:
        numbers = [number for number, channel in channels.items() if channel in wanted]
        query = (
            "SELECT timestamp, topic_id, data FROM messages "
            f"WHERE topic_id IN ({', '.join('?' * len(numbers))}) ORDER BY timestamp"
        )
        for time, number, data in base.execute(query, numbers):
            yield time, channels[number], data

    return BagFile(counts, messages)
