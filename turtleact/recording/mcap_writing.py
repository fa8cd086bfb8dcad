"""Writes one MCAP file.

Messages are collected in memory until they fill a chunk, which is written as a whole. If the
process is killed, only the last chunk in the file may be incomplete. If a write fails, the file is
cut back to the end of its last complete record, and can still be closed.

The classes of records come from the ``mcap`` package. The package's ``Writer`` takes 25 us per
message. With this ``Writer``, an action server would spend more time on recording than on its
goals. This module therefore packs each message and the message's index entry itself, which takes
2 us. Also, a ``Writer`` cannot be closed after a failed write.

Source: the MCAP specification; rosbag2 ``mcap_storage.cpp`` for the profile and the metadata.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, deque
from collections.abc import Callable, Mapping
from io import FileIO
from pathlib import Path
from typing import Final, Literal, TypeAlias

import msgspec
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)
from mcap.records import Schema as SchemaRecord

from turtleact.recording.schemas import Schema

__all__ = ["CHUNK", "MAGIC", "MESSAGE", "Compression", "McapWriter"]

Compression: TypeAlias = Literal["none", "zstd_fast", "zstd_small"]
"""How chunks are compressed. rosbag2 has presets with these names."""

CHUNK: Final = 768 * 1024
"""The size at which a chunk is written to the file (bytes), as in rosbag2."""

LEVELS: Final[Mapping[Compression, int]] = {"zstd_fast": 1, "zstd_small": 19}

MAGIC: Final = b"\x89MCAP0\r\n"
"""The bytes with which a file begins and ends.

This constant also exists in ``mcap.writer``, which imports slowly.
"""

HELD_BACK: Final = 64
"""How many of the last chunks can be removed to make room for the index."""

MESSAGE: Final = struct.Struct("<BQHIQQ")
"""The header of a message record, which precedes the data.

The fields are opcode, length, channel, sequence, log time and publish time.
"""

_INDEX_HEAD: Final = struct.Struct("<BQHI")


class _Written(msgspec.Struct):
    """A chunk in the file: where it begins (bytes), and its number of messages per channel."""

    offset: int
    counts: Counter[int]


class McapWriter:
    """Writes an MCAP file.

    The constructor, `flush`, `add_metadata` and `finish` may raise OSError.

    Args:
        path: The file to create. The file must not exist yet.
        compression: How to compress chunks.

    Attributes:
        counts: How many messages of each channel are in the written chunks.
        start: The time of the earliest message in the written chunks (ns since 1970); 0 if there is
            none.
        end: The time of the latest message in the written chunks (ns since 1970); 0 if there is
            none.
        waiting: How many messages wait in the current chunk.
        is_finished: Whether the index has been written.
    """

    def __init__(self, path: Path, compression: Compression = "none") -> None:
        self.counts: Counter[int] = Counter()
        self.start = self.end = 0
        self.is_finished = False
        self._compress = _compressor(compression)
        self._compression = "" if compression == "none" else "zstd"
        self._file: FileIO = path.open("xb", buffering=0)
        self._end = 0
        self._schemas: dict[Schema, SchemaRecord] = {}
        self._channels: dict[int, Channel] = {}
        self._chunk_index: list[bytes] = []
        self._metadata: list[MetadataIndex] = []
        self._last: deque[_Written] = deque(maxlen=HELD_BACK)
        self._begin_chunk()
        try:
            self._append(MAGIC + _bytes_of(Header("ros2", "turtleact")))
        except OSError:  # an empty file would make the folder's other files unreadable
            self._file.close()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """The size of the file (bytes) if the current chunk were written without compression."""
        return self._end + self._chunk_size

    @property
    def count(self) -> int:
        """How many messages are in the written chunks."""
        return self.counts.total()

    def add_channel(self, topic: str, schema: Schema, metadata: dict[str, str]) -> int:
        """Add a channel and return its number in the file."""
        record = self._schemas.get(schema)
        if record is None:
            number = len(self._schemas) + 1
            record = SchemaRecord(
                id=number, name=schema.name, encoding=schema.encoding, data=schema.text.encode()
            )
            self._schemas[schema] = record
            self._declare(record)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            schema_id=record.id,
            metadata=metadata,
        )
        self._channels[channel.id] = channel
        self._declare(channel)
        return channel.id

    def add(self, channel: int, stamp: int, sent: int, data: bytes) -> None:
        """Add a message.

        Args:
            channel: The number of the message's channel, from `add_channel`.
            stamp: When the message was received (ns since 1970).
            sent: When the message was published (ns since 1970).
            data: The encoded message.
        """
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = []
        entries.append(stamp)
        entries.append(self._chunk_size)
        size = len(data)
        self._parts.append(MESSAGE.pack(5, 22 + size, channel, 0, stamp, sent))
        self._parts.append(data)
        self._chunk_size += 31 + size
        self.waiting += 1

    @property
    def is_full(self) -> bool:
        """Whether the current chunk is large enough to be written."""
        return self._chunk_size >= CHUNK

    def flush(self) -> None:
        """Write the current chunk to the file, if the chunk has messages.

        Raises:
            OSError: if the chunk cannot be written. Its messages are then lost, and the file stays
                as it was.
        """
        if not self._entries:
            return
        content, entries = b"".join(self._parts), self._entries
        self._begin_chunk()
        stamps = [each for numbers in entries.values() for each in numbers[::2]]
        first, last = min(stamps), max(stamps)
        packed = self._compress(content)
        chunk = Chunk(
            compression=self._compression,
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        record = _bytes_of(chunk)
        offset, offsets, behind = self._end, dict[int, int](), bytearray()
        for channel, numbers in entries.items():
            offsets[channel] = offset + len(record) + len(behind)
            head = _INDEX_HEAD.pack(7, 6 + 8 * len(numbers), channel, 8 * len(numbers))
            behind += head + struct.pack(f"<{len(numbers)}Q", *numbers)
        self._append(record + behind)
        index = ChunkIndex(
            message_start_time=first,
            message_end_time=last,
            chunk_start_offset=offset,
            chunk_length=len(record),
            message_index_offsets=offsets,
            message_index_length=len(behind),
            compression=self._compression,
            compressed_size=len(packed),
            uncompressed_size=len(content),
        )
        self._chunk_index.append(_bytes_of(index))
        counts = Counter({channel: len(numbers) // 2 for channel, numbers in entries.items()})
        self._last.append(_Written(offset, counts))
        self.start = min(first, self.start) if self.counts else first
        self.end = max(last, self.end)
        self.counts += counts

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        record = _bytes_of(Metadata(name=name, metadata=values))
        self._metadata.append(MetadataIndex(offset=self._end, length=len(record), name=name))
        self._append(record)

    def finish(self, name: str = "", values: Callable[[], dict[str, str]] = dict) -> None:
        """Write a last metadata record and the index, and close the file.

        Call `flush` first. If the disk has no room for the index, the last chunks are removed until
        the index fits. Afterwards, `counts` includes only the messages of the remaining chunks.

        Args:
            name: The name of the metadata record; empty for no record.
            values: A function that returns the content of the record. It is called again whenever a
                chunk has been removed.

        Raises:
            OSError: if the disk had no room for everything. If `is_finished` is True
                afterwards, the index was written, but chunks had to be removed. Otherwise, the
                file has no index, but its messages can be read.
        """
        problem: OSError | None = None
        try:
            while not self.is_finished:
                try:
                    self._append(self._ending(name, values))
                    self.is_finished = True
                except OSError as error:
                    problem = problem or error
                    if not self._last:
                        raise
                    self._give_up_chunk()
        finally:
            self._file.close()
        if problem is not None:
            raise problem

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._entries: dict[int, list[int]] = {}
        self._chunk_size = 0
        self.waiting = 0

    def _declare(self, record: McapRecord) -> None:
        """Add the record of a schema or channel to the current chunk.

        The index at the end of the file contains a copy of the record.
        """
        data = _bytes_of(record)
        self._parts.append(data)
        self._chunk_size += len(data)

    def _append(self, data: bytes | bytearray) -> None:
        """Write all of the data at the end of the file, or none of it."""
        view = memoryview(data)
        try:
            while view:  # a nearly full disk takes a part, and then raises
                view = view[self._file.write(view) or 0 :]
        except OSError:
            self._file.truncate(self._end)
            self._file.seek(self._end)
            raise
        self._end += len(data)

    def _give_up_chunk(self) -> None:
        last = self._last.pop()
        self._chunk_index.pop()
        self.counts -= last.counts
        self._metadata = [each for each in self._metadata if each.offset < last.offset]
        self._end = last.offset
        self._file.truncate(self._end)
        self._file.seek(self._end)

    def _ending(self, name: str, values: Callable[[], dict[str, str]]) -> bytes:
        """Return what follows the chunks: the metadata record, and then the index.

        If ``name`` is empty, there is no metadata record.
        """
        if not name:
            return self._summary(self._end, self._metadata)
        record = _bytes_of(Metadata(name=name, metadata=values()))
        index = MetadataIndex(offset=self._end, length=len(record), name=name)
        return record + self._summary(self._end + len(record), [*self._metadata, index])

    def _summary(self, offset: int, metadata: list[MetadataIndex]) -> bytes:
        """Return the index, the statistics and the footer, with which the file ends.

        ``offset`` is where the returned bytes begin, in bytes from the start of the file.
        """
        head = _bytes_of(DataEnd(0))
        start = offset + len(head)
        groups = (
            (Opcode.SCHEMA, b"".join(map(_bytes_of, self._schemas.values()))),
            (Opcode.CHANNEL, b"".join(map(_bytes_of, self._channels.values()))),
            (Opcode.STATISTICS, _bytes_of(self._statistics(len(metadata)))),
            (Opcode.CHUNK_INDEX, b"".join(self._chunk_index)),
            (Opcode.METADATA_INDEX, b"".join(map(_bytes_of, metadata))),
        )
        body, offsets = bytearray(), bytearray()
        for opcode, records in groups:
            if records:
                place = SummaryOffset(
                    group_opcode=opcode,
                    group_start=start + len(body),
                    group_length=len(records),
                )
                offsets += _bytes_of(place)
                body += records
        behind = start + len(body)
        foot = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, behind)
        crc = zlib.crc32(foot, zlib.crc32(body + offsets))
        footer = Footer(summary_start=start, summary_offset_start=behind, summary_crc=crc)
        return head + bytes(body + offsets) + _bytes_of(footer) + MAGIC

    def _statistics(self, metadata_count: int) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunk_index),
            message_count=self.count,
            metadata_count=metadata_count,
            message_start_time=self.start,
            message_end_time=self.end,
            schema_count=len(self._schemas),
        )


def _compressor(compression: Compression) -> Callable[[bytes], bytes]:
    if compression == "none":
        return bytes
    import zstandard  # only compressed files need it

    return zstandard.ZstdCompressor(level=LEVELS[compression]).compress


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    content: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap leaves it out
    return content
