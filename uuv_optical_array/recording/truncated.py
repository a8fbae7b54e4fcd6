"""Bag files without their end, because the recorder was killed, the disk was full or a copy broke.

A repaired file holds every whole message. MCAP (https://mcap.dev/spec) consists of records, each
one byte of kind and eight of length before its body, most of them in chunks; then come a summary, a
footer and the magic. Readers start from the footer, and without an index they need the messages in
the order of their times, in which recorders do not write them. SQLite states its number of pages in
its header (https://www.sqlite.org/fileformat.html): where zeros stand in for missing pages, a table
can be read in its order up to the first of them.
"""

import heapq
import shutil
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from uuv_optical_array.core.extras import needs

MCAP, SQLITE = ".mcap", ".db3"
MCAP_MAGIC, SQLITE_MAGIC = b"\x89MCAP0\r\n", b"SQLite format 3\0"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 1, 2, 3, 4, 5, 6, 0x0F
MAX_DELAY_NS = 10 * 10**9  # by which a recorder writes a message after a later one
RECORD = struct.Struct("<BQ")


def is_truncated(path: Path) -> bool:
    """Say whether a bag file, .mcap or .db3, begins as such a file and lacks its end."""
    if path.suffix == SQLITE:
        return path.stat().st_size < _sqlite_size(path)
    with path.open("rb") as file:
        begins = file.read(len(MCAP_MAGIC)) == MCAP_MAGIC
        file.seek(-min(len(MCAP_MAGIC), path.stat().st_size), 2)
        return begins and (file.read() != MCAP_MAGIC or file.tell() == len(MCAP_MAGIC))


def repair(path: Path, target: Path) -> None:
    """Write the whole messages of a truncated file to a new one."""
    if path.suffix == SQLITE:
        _repair_sqlite(path, target)
    else:
        _repair_mcap(path, target)


def _repair_mcap(path: Path, target: Path) -> None:
    """Write the messages in the order of their times, with an end and without a summary.

    Of the last chunk the whole messages are written if it is not compressed.
    """
    waiting: list[tuple[int, int, bytes]] = []  # a heap of time, position and record
    with path.open("rb") as source, target.open("wb") as output:
        output.write(source.read(len(MCAP_MAGIC)))
        for position, (kind, body) in enumerate(_whole_records(source, path.stat().st_size)):
            record = RECORD.pack(kind, len(body)) + body
            if kind in (HEADER, SCHEMA, CHANNEL):
                output.write(record)
            elif kind == MESSAGE:
                # The time follows the numbers of channel and message.
                (time_ns,) = struct.unpack_from("<Q", body, 6)
                heapq.heappush(waiting, (time_ns, position, record))
                while waiting[0][0] < time_ns - MAX_DELAY_NS:
                    output.write(heapq.heappop(waiting)[2])
        output.writelines(record for *_, record in sorted(waiting))
        output.write(RECORD.pack(DATA_END, 4) + bytes(4))
        output.write(RECORD.pack(FOOTER, 20) + bytes(20) + MCAP_MAGIC)


def _whole_records(source: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of each whole record up to the summary, with those in chunks."""
    while len(head := source.read(RECORD.size)) == RECORD.size:
        kind, length = RECORD.unpack(head)
        if kind in (DATA_END, FOOTER):
            return
        body = source.read(min(length, size - source.tell()))
        if kind == CHUNK:
            records = _chunk_records(body, len(body) == length)
            yield from _whole_records(BytesIO(records), len(records))
        elif len(body) == length:
            yield kind, body


def _chunk_records(body: bytes, whole: bool) -> bytes:
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


def _sqlite_size(path: Path) -> int:
    """Return the size that the header of a database states, bytes; 0 where there is none."""
    with path.open("rb") as file:
        head = file.read(100)
    if len(head) < 100 or not head.startswith(SQLITE_MAGIC):
        return 0
    page = int.from_bytes(head[16:18], "big")
    return (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")


def _repair_sqlite(path: Path, target: Path) -> None:
    """Copy the whole rows of each table."""
    padded = target.with_suffix(".padded")
    shutil.copyfile(path, padded)
    with padded.open("r+b") as file:
        file.truncate(_sqlite_size(path))
    with closing(sqlite3.connect(padded)) as source, closing(sqlite3.connect(target)) as output:
        # What can be read comes before the error.
        with suppress(sqlite3.DatabaseError):
            tables = "SELECT name, sql FROM sqlite_master WHERE type = 'table'"
            for name, layout in source.execute(tables).fetchall():
                output.execute(layout)
                with suppress(sqlite3.DatabaseError):
                    for row in source.execute(f'SELECT * FROM "{name}"'):
                        values = ",".join("?" * len(row))
                        output.execute(f'INSERT INTO "{name}" VALUES ({values})', row)
        output.commit()
    padded.unlink()
