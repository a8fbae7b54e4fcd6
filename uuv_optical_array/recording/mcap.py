"""MCAP files that end in the midst, because the recorder was killed or the disk was full.

The layout is that of https://mcap.dev/spec: records, each a byte of kind and eight of length before
its body; the data records, then a summary, a footer and the magic. A file without its end is read
by nothing that starts from the footer.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"
FOOTER, CHUNK, DATA_END = 0x02, 0x06, 0x0F
_HEAD = struct.Struct("<BQ")


def is_cut_off(path: Path) -> bool:
    """Say whether a file begins as MCAP does, and does not end so."""
    with path.open("rb") as file:
        begins = file.read(len(MAGIC)) == MAGIC
        file.seek(-min(len(MAGIC), path.stat().st_size), 2)
        return begins and (file.read() != MAGIC or file.tell() == len(MAGIC))


def mend(path: Path, target: Path) -> None:
    """Write the records that are whole to a file of their own, with an end and without a summary.

    Of the chunk in which the file ends, the whole records are kept where it is not compressed.

    Parameters
    ----------
    path
        A file for which `is_cut_off` holds.
    target
        The file to write.
    """
    with path.open("rb") as source, target.open("wb") as whole:
        whole.write(source.read(len(MAGIC)))
        for kind, body, length in _records(source, path.stat().st_size):
            if kind in (DATA_END, FOOTER):
                break
            if len(body) == length:
                whole.write(_HEAD.pack(kind, length) + body)
            elif kind == CHUNK:
                whole.write(_of_chunk(body))
        whole.write(_HEAD.pack(DATA_END, 4) + bytes(4) + _HEAD.pack(FOOTER, 20) + bytes(20) + MAGIC)


def _records(source: BinaryIO, size: int) -> Iterator[tuple[int, bytes, int]]:
    """Yield kind, body and length of each record; the body of the last may be shorter."""
    while len(head := source.read(_HEAD.size)) == _HEAD.size:
        kind, length = _HEAD.unpack(head)
        yield kind, source.read(min(length, size - source.tell())), length


def _of_chunk(body: bytes) -> bytes:
    """Return the whole records in the beginning of a chunk; none where they are compressed."""
    # Times, size and checksum, a compression of no letters, and the length of the records.
    if body[28:32] != bytes(4) or len(body) < 40:
        return b""
    at = end = 40
    while at + _HEAD.size <= len(body):
        at += _HEAD.size + _HEAD.unpack_from(body, at)[1]
        end = at if at <= len(body) else end
    return body[40:end]
