"""The whole messages of MCAP files without an index or an end, as by a killed recorder.

Readers start from a summary at the end, after records mostly in chunks (https://mcap.dev/spec).
"""

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from uuv_optical_array.core.extras import needs

MCAP = ".mcap"
MAGIC = b"\x89MCAP0\r\n"
END = struct.Struct("<QQI8s")  # where the summary and its offsets begin, its checksum, the magic
CHUNK, RECORD_HEAD = b"\x06", 9  # its kind; bytes of kind and length before each record


def is_truncated(path: Path) -> bool:
    """Say whether a file begins as MCAP and has no end, or another."""
    with path.open("rb") as file:
        begins = file.read(len(MAGIC)) == MAGIC
        if not begins or path.stat().st_size < END.size:
            return begins
        file.seek(-END.size, 2)
        start, _, checksum, magic = END.unpack(file.read())
        if magic != MAGIC or not checksum:
            return magic != MAGIC
        file.seek(min(start, file.tell()))
        return checksum != zlib.crc32(file.read()[: -len(MAGIC) - 4])


def reader_of(file: BinaryIO) -> Any | None:
    """Return a reader of a file that is not cut off; ``None`` where its index is not complete."""
    mcap = needs("bags", "mcap.reader")
    reader = mcap.SeekingReader(file, validate_crcs=True)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None or not summary.chunk_indexes:
        return None
    known = summary.channels.keys()
    counted = summary.statistics.channel_message_counts.keys()
    indexed = [chunk.message_index_offsets.keys() for chunk in summary.chunk_indexes]
    whole = all(indexed) and all(numbers <= known for numbers in (counted, *indexed))
    return reader if whole else None


def copy(path: Path, target: Path) -> Path:
    """Write the whole messages of an MCAP file to a new one, with an index and all checksums."""
    mcap = needs("bags", "mcap.writer")
    schemas, channels = {0: 0}, {}  # by the numbers that they have in the file
    with path.open("rb") as source, target.open("wb") as output:
        writer = mcap.Writer(output, compression=mcap.CompressionType.NONE)
        for record in _whole_records(source, path.stat().st_size):
            match record:
                case mcap.Header():
                    writer.start(record.profile)
                case mcap.Schema() if record.id not in schemas:
                    about = record.name, record.encoding, record.data
                    schemas[record.id] = writer.register_schema(*about)
                case mcap.Channel() if record.id not in channels:
                    about = record.topic, record.message_encoding, schemas[record.schema_id]
                    channels[record.id] = writer.register_channel(*about, record.metadata)
                case mcap.Message():
                    times = {"log_time": record.log_time, "publish_time": record.publish_time}
                    channel = channels[record.channel_id]
                    writer.add_message(channel, data=record.data, sequence=record.sequence, **times)
        writer.finish()
    return target


def _whole_records(source: BinaryIO, size: int) -> Iterator[Any]:
    mcap, place = needs("bags", "mcap.stream_reader"), len(MAGIC)
    with _until_cut():
        reader = mcap.StreamReader(source, emit_chunks=True, record_size_limit=size)
        for record in reader.records:
            place = source.tell()
            yield from _in_chunk(record) if isinstance(record, mcap.Chunk) else [record]
    source.seek(place)
    with _until_cut():
        if source.read(RECORD_HEAD)[:1] == CHUNK:
            chunk = mcap.Chunk.read(mcap.ReadDataStream(source))
            if not chunk.compression:
                yield from _in_chunk(chunk, whole=False)


def _in_chunk(chunk: Any, whole: bool = True) -> Iterator[Any]:
    """Yield the whole records in a chunk; ValueError where a whole one is damaged."""
    mcap = needs("bags", "mcap.stream_reader")
    try:
        stream, _ = mcap.get_chunk_data_stream(chunk, validate_crc=whole)
    except mcap.CRCValidationError:
        raise ValueError("a chunk is damaged; copy the bag again") from None
    with _until_cut():
        yield from mcap.StreamReader(stream, skip_magic=True).records


def _until_cut() -> suppress:
    """Let a block end where a record is longer than what is left."""
    return suppress(needs("bags", "mcap.exceptions").McapError, struct.error)
