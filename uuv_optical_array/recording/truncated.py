"""Bag files without their end, as the recorder was killed or the disk full, and their checksums.

A repaired file holds every whole message. MCAP (https://mcap.dev/spec) consists of records, each
one byte of kind and eight of length before its body, most of them in chunks; then come a summary, a
footer and the magic. Chunks and summary may have checksums, which rosbags does not write; of those
it checks the chunks'. Readers start from the footer, and without an index they need the messages in
the order of their times, in which recorders do not write them. SQLite states its number of pages in
its header (https://www.sqlite.org/fileformat.html): where zeros stand in for missing pages, a table
can be read in its order up to the first of them.
"""

import heapq
import shutil
import sqlite3
import struct
import zlib
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
CHUNK_SUM = 24  # where in a chunk the checksum of its records is
END = struct.Struct("<QQI8s")  # where the summary and its offsets begin, its checksum, the magic


def is_truncated(path: Path) -> bool:
    """Say whether a bag file, .mcap or .db3, begins as such a file and has no end, or another."""
    if path.suffix == SQLITE:
        return path.stat().st_size < _sqlite_size(path)
    with path.open("rb") as file:
        begins = file.read(len(MCAP_MAGIC)) == MCAP_MAGIC
        if not begins or path.stat().st_size < END.size:
            return begins
        checksum, magic, expected = _end(file)
        return magic != MCAP_MAGIC or checksum not in (0, expected)


def add_checksums(path: Path) -> None:
    """Write those of the chunks and of the summary into a whole MCAP file that has none."""
    with path.open("r+b") as file:
        file.seek(len(MCAP_MAGIC))
        kind = 0
        while kind != DATA_END:
            kind, length = RECORD.unpack(file.read(RECORD.size))
            start = file.tell()
            if kind == CHUNK:
                records = _chunk_records(file.read(length), True)
                file.seek(start + CHUNK_SUM)
                file.write(zlib.crc32(records).to_bytes(4, "little"))
            file.seek(start + length)
        *_, expected = _end(file)
        file.seek(-len(MCAP_MAGIC) - 4, 2)
        file.write(expected.to_bytes(4, "little"))


def _end(file: BinaryIO) -> tuple[int, bytes, int]:
    """Return the checksum of the summary, the magic, and what the checksum must be."""
    file.seek(-END.size, 2)
    start, _, checksum, magic = END.unpack(file.read())
    file.seek(min(start, file.tell()))
    return checksum, magic, zlib.crc32(file.read()[: -len(MCAP_MAGIC) - 4])


def repair(path: Path, target: Path) -> None:
    """Write the whole messages of a truncated file to a new one."""
    if path.suffix == SQLITE:
        _repair_sqlite(path, target)
    else:
        _repair_mcap(path, target)


def _repair_mcap(path: Path, target: Path) -> None:
    """Write the messages in the order of their times, with an end and without a summary."""
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
    _, _, size, checksum, letters = struct.unpack_from("<QQQII", body)
    compression, packed = body[32 : 32 + letters], body[40 + letters :]
    if compression and not whole:
        return b""
    if not compression:
        records = packed
    elif compression == b"zstd":
        records = bytes(needs("bags", "zstandard").decompress(packed, max_output_size=size))
    elif compression == b"lz4":
        records = bytes(needs("bags", "lz4.frame").decompress(packed))
    else:
        raise ValueError(f"a chunk is compressed by {compression!r}; give a bag by lz4 or zstd")
    if whole and checksum not in (0, zlib.crc32(records)):
        raise ValueError("a chunk is not as it was written; copy the bag again")
    return records


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
