"""MCAP files that end in the midst, because the recorder was killed or the disk was full.

The layout is that of https://mcap.dev/spec: records, each a byte of kind and eight of length before
its body; the data records, most of them in chunks, then a summary, a footer and the magic. A file
without its end is read by nothing that starts from the footer, and without an index only where the
messages are in the order of their times, which those of a recorder are not.
"""

import heapq
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from uuv_optical_array.core.extras import needs

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 1, 2, 3, 4, 5, 6, 0x0F
# A recorder takes no message so long after one of a later time, ns.
MOST_LATE_NS = 10 * 10**9
_HEAD = struct.Struct("<BQ")


def is_cut_off(path: Path) -> bool:
    """Say whether a file begins as MCAP does, and does not end so."""
    with path.open("rb") as file:
        begins = file.read(len(MAGIC)) == MAGIC
        file.seek(-min(len(MAGIC), path.stat().st_size), 2)
        return begins and (file.read() != MAGIC or file.tell() == len(MAGIC))


def mend(path: Path, target: Path) -> None:
    """Write the messages that are whole to a file of their own, in the order of their times.

    Of the chunk in which the file ends, the whole messages are kept where it is not compressed.

    Parameters
    ----------
    path
        A file for which `is_cut_off` holds.
    target
        The file to write; it has an end and no summary.
    """
    waiting: list[tuple[int, int, bytes]] = []  # a heap of time, place and record
    with path.open("rb") as source, target.open("wb") as whole:
        whole.write(source.read(len(MAGIC)))
        for place, (kind, body) in enumerate(_whole_records(source, path.stat().st_size)):
            record = _HEAD.pack(kind, len(body)) + body
            if kind in (HEADER, SCHEMA, CHANNEL):
                whole.write(record)
            elif kind == MESSAGE:
                # Behind the channel's number and the message's.
                (time_ns,) = struct.unpack_from("<Q", body, 6)
                heapq.heappush(waiting, (time_ns, place, record))
                while waiting[0][0] < time_ns - MOST_LATE_NS:
                    whole.write(heapq.heappop(waiting)[2])
        whole.writelines(record for *_, record in sorted(waiting))
        whole.write(_HEAD.pack(DATA_END, 4) + bytes(4) + _HEAD.pack(FOOTER, 20) + bytes(20) + MAGIC)


def _whole_records(source: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of each whole record up to the summary, with those in chunks."""
    while len(head := source.read(_HEAD.size)) == _HEAD.size:
        kind, length = _HEAD.unpack(head)
        if kind in (DATA_END, FOOTER):
            return
        body = source.read(min(length, size - source.tell()))
        if kind == CHUNK:
            packed = _of_chunk(body, len(body) == length)
            yield from _whole_records(BytesIO(packed), len(packed))
        elif len(body) == length:
            yield kind, body


def _of_chunk(body: bytes, whole: bool) -> bytes:
    """Return the records in a chunk, those of its beginning where it is not whole."""
    if len(body) < 32:
        return b""
    # Two times, size and checksum of the records, the name of the compression, and the packed size.
    _, _, size, _, letters = struct.unpack_from("<QQQII", body)
    compression, packed = body[32 : 32 + letters], body[40 + letters :]
    if not compression:
        return packed
    if not whole:
        return b""
    if compression == b"zstd":
        return bytes(needs("bags", "zstandard").decompress(packed, max_output_size=size))
    if compression == b"lz4":
        return bytes(needs("bags", "lz4.frame").decompress(packed))
    raise ValueError(f"a chunk is compressed by {compression!r}; give a bag by lz4 or zstd")
