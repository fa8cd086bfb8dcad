"""Reads one MCAP file, with its index if it has one.

A file that was not closed has no index. Such a file is read from its start, until it ends or a
record is cut off. Damaged records are skipped. Messages are read one chunk at a time.

Source: the MCAP specification.
"""

from __future__ import annotations

import heapq
import struct
from collections import Counter
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, ChunkIndex, Footer, Metadata, MetadataIndex, Statistics
from mcap.records import Schema as SchemaRecord
from mcap.stream_reader import get_chunk_data_stream
from zstandard import ZstdError

from turtleact.recording.mcap_writing import MAGIC, MESSAGE
from turtleact.recording.metadata import BagError, read_offers
from turtleact.recording.schemas import Schema
from turtleact.recording.storage import Channel, Range, Raw

__all__ = ["McapFile"]

ABOUT: Final = "rosbag2"
"""The name of the metadata record in which rosbag2 describes the bag."""

_HEAD: Final = struct.Struct("<BQ")
_FOOTER: Final = _HEAD.size + 20
"""The length of the last record (bytes)."""

_DAMAGED: Final = (
    *(McapError, struct.error, ValueError, MemoryError, EOFError, OverflowError, OSError, KeyError),
    *(RuntimeError, ZstdError),  # of the packages that decompress
)
"""The exceptions that reading a damaged record may raise."""

_REST: Final = (
    "to copy the messages before or behind it, use 'turtleact bag convert' with "
    "--playback-duration or --start-offset"
)
"""The advice for a damaged chunk."""

_AFTER: Final = "this record and everything after it are left out"


class _Piece(NamedTuple):
    """A part of the file that is read as a whole: a chunk, or a single message outside of chunks.

    Attributes:
        start: The time of its earliest message (ns).
        offset: Where its record begins, in bytes from the start of the file.
        end: The time of its latest message (ns).
        channels: The channels that have messages in this part; None if they are not known.
    """

    start: int
    offset: int
    end: int
    channels: frozenset[int] | None


class _Summary(NamedTuple):
    """The parts of a file's index that `McapFile` uses.

    Attributes:
        statistics: How many messages each channel has, and the times of the earliest and latest
            message.
        declared: The records of schemas and channels, each with its opcode.
        chunks: The records that give the positions of the chunks. A file of 1 GB has about a
            thousand of these records. They stay encoded, because only `McapFile.messages` needs
            them.
        about: Where the last metadata record about the bag begins, in bytes from the start of the
            file; 0 if there is none.
    """

    statistics: Statistics
    declared: list[tuple[int, bytes]]
    chunks: list[bytes]
    about: int


class McapFile:
    """An MCAP file, open for reading; see `turtleact.recording.storage.BagStorage`.

    Args:
        path: The file.

    Raises:
        BagError: if the file cannot be opened, or is not an MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.start = self.end = 0
        self.is_closed = True
        self.about = ""
        self.flaw = ""
        self._pieces: list[_Piece] = []
        self._unread: list[bytes] = []  # the records of chunks that are not among the pieces yet
        self._schemas: dict[int, Schema] = {}
        try:
            self._file: BinaryIO = path.open("rb")
        except OSError as error:
            raise BagError(path, f"it cannot be opened: {error.strerror}") from error
        try:
            self._look_through()
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the messages that ``wanted`` selects, ordered by stamp.

        Messages with the same stamp keep their order in the file.

        Raises:
            BagError: if a chunk is damaged.
        """
        waiting: list[tuple[int, int, int, Raw]] = []
        for piece in self._chosen(wanted):
            while waiting and waiting[0][0] < piece.start:
                yield heapq.heappop(waiting)[3]
            for place, raw in enumerate(self._read(piece)):
                if wanted.has(raw.channel.topic) and _is_in(raw.stamp, wanted):
                    heapq.heappush(waiting, (raw.stamp, piece.offset, place, raw))
        while waiting:
            yield heapq.heappop(waiting)[3]

    def _chosen(self, wanted: Range) -> list[_Piece]:
        self._read_index()
        channels = {number for number, each in self.channels.items() if wanted.has(each.topic)}
        return [
            piece
            for piece in self._pieces
            if piece.end >= wanted.start
            and (wanted.end is None or piece.start <= wanted.end)
            and (piece.channels is None or piece.channels & channels)
        ]

    # opening

    def _look_through(self) -> None:
        if self._file.read(len(MAGIC)) != MAGIC:
            raise BagError(self.path, "it is not an MCAP file")
        summary = self._summary()
        if summary is None or not _is_complete(summary) or not self._takes(summary):
            self._scan()
            self._pieces.sort()

    def _summary(self) -> _Summary | None:
        """Return the index at the end of the file; None if no index can be read."""
        self._file.seek(-len(MAGIC), 2)
        self.is_closed = self._file.read() == MAGIC and self._file.tell() > 16
        if not self.is_closed:
            return None
        try:
            return self._read_summary()
        except _DAMAGED:
            self.is_closed = False
            return None

    def _read_summary(self) -> _Summary | None:
        end = self._file.seek(-len(MAGIC) - _FOOTER, 2)
        [(opcode, content)] = _split(self._file.read(_FOOTER))
        begin = Footer.read(_stream(content)).summary_start
        if opcode != Opcode.FOOTER or begin > end:
            raise EOFError("it has no footer")
        self._file.seek(begin)
        statistics, about = None, 0
        declared, chunks = list[tuple[int, bytes]](), list[bytes]()
        for opcode, content in _split(self._file.read(end - begin)) if begin else ():
            if opcode == Opcode.CHUNK_INDEX:
                chunks.append(content)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                declared.append((opcode, content))
            elif opcode == Opcode.STATISTICS:
                statistics = Statistics.read(_stream(content))
            elif opcode == Opcode.METADATA_INDEX:
                index = MetadataIndex.read(_stream(content))
                about = index.offset if index.name == ABOUT else about
        return None if statistics is None else _Summary(statistics, declared, chunks, about)

    def _takes(self, summary: _Summary) -> bool:
        """Copy the contents of the index into this object.

        If the index is damaged, copy nothing and return False.
        """
        try:
            self._take(summary)
        except _DAMAGED:
            self.is_closed = False
            for each in (self.channels, self.counts, self._schemas, self._unread):
                each.clear()
            self.start = self.end = 0
        return self.is_closed

    def _take(self, summary: _Summary) -> None:
        """Copy the contents of the index into this object. A damaged index raises an error."""
        for opcode, content in sorted(summary.declared, key=itemgetter(0)):  # schemas first
            self._declare(opcode, content)
        self.counts.update(summary.statistics.channel_message_counts)
        self.start = summary.statistics.message_start_time
        self.end = summary.statistics.message_end_time
        self._unread = summary.chunks
        if summary.about:
            self._file.seek(summary.about + _HEAD.size)
            self._note(Metadata.read(ReadDataStream(self._file)))

    def _read_index(self) -> None:
        """Decode the records that say where the chunks are.

        If such a record is damaged, read the whole file instead.
        """
        unread, self._unread = self._unread, []
        try:
            self._pieces += map(_piece, unread)
        except _DAMAGED:
            self.is_closed = False
            self.counts.clear()
            self._pieces.clear()
            self._scan()
        self._pieces.sort()

    def _scan(self) -> None:
        """Find the chunks and messages by reading the whole file.

        Stop at a record that is cut off. Skip damaged records.
        """
        size = self._file.seek(0, 2)
        place, damaged = len(MAGIC), 0
        self.flaw = "it was not closed, so messages may be missing at its end"
        while place + _HEAD.size <= size:
            self._file.seek(place)
            opcode, length = _HEAD.unpack(self._file.read(_HEAD.size))
            behind = place + _HEAD.size + length
            if behind > size:
                self.flaw = f"the record at byte {place} is cut off; {_AFTER}"
                break
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                self.flaw = ""
                break
            try:
                self._see(opcode, place, self._file.read(length))
            except _DAMAGED:
                damaged += 1  # the next record begins where it should
            place = behind
        if damaged:
            left_out = (
                f"{damaged} damaged {'record is' if damaged == 1 else 'records are'} left out"
            )
            self.flaw = f"{self.flaw}; {left_out}" if self.flaw else left_out
        self.is_closed &= not self.flaw

    def _see(self, opcode: int, place: int, content: bytes) -> None:
        """Note what a top-level record contains: a chunk, a message, metadata or a declaration."""
        if opcode == Opcode.CHUNK:
            found = self._records(Chunk.read(_stream(content)))
            if found:
                stamps = [stamp for _, stamp, _, _ in found]
                channels = Counter(channel for channel, _, _, _ in found)
                self._add_piece(place, min(stamps), max(stamps), channels)
        elif opcode == Opcode.MESSAGE:
            channel, _, stamp, _ = struct.unpack_from("<HIQQ", content)
            self._add_piece(place, stamp, stamp, Counter([channel]))
        elif opcode == Opcode.METADATA:
            self._note(Metadata.read(_stream(content)))
        else:
            self._declare(opcode, content)

    def _add_piece(self, place: int, start: int, end: int, channels: Counter[int]) -> None:
        self.start = min(start, self.start) if self._pieces else start
        self.end = max(end, self.end)
        self._pieces.append(_Piece(start, place, end, frozenset(channels)))
        self.counts += channels

    def _note(self, record: Metadata) -> None:
        if record.name == ABOUT:
            self.about = record.metadata.get("serialized_metadata", "")

    # records

    def _read(self, piece: _Piece) -> Iterator[Raw]:
        """Yield the messages of a chunk, or the message of a record outside of chunks."""
        try:
            self._file.seek(piece.offset)
            opcode, length = _HEAD.unpack(self._file.read(_HEAD.size))
            content = self._file.read(length)
            if opcode == Opcode.CHUNK:
                found = self._records(Chunk.read(_stream(content)))
            else:
                channel, _, stamp, sent = struct.unpack_from("<HIQQ", content)
                found = [(channel, stamp, sent, content[22:])]
            for channel, stamp, sent, data in found:
                yield Raw(stamp, sent, self.channels[channel], data)
        except _DAMAGED as error:
            problem = f"the chunk at byte {piece.offset} is damaged ({_reason(error)})"
            raise BagError(self.path, f"{problem}; {_REST}") from error

    def _records(self, chunk: Chunk) -> list[tuple[int, int, int, bytes]]:
        """Return the messages of a chunk, each as channel, log time, publish time and data."""
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        content = stream.read(length)
        if len(content) < length:
            raise EOFError("it is cut off")
        found, place = list[tuple[int, int, int, bytes]](), 0
        while place < length:
            opcode, size = _HEAD.unpack_from(content, place)
            behind = place + _HEAD.size + size
            if opcode == Opcode.MESSAGE:
                _, _, channel, _, stamp, sent = MESSAGE.unpack_from(content, place)
                found.append((channel, stamp, sent, content[place + MESSAGE.size : behind]))
            else:
                self._declare(opcode, content[place + _HEAD.size : behind])
            place = behind
        return found

    def _declare(self, opcode: int, content: bytes) -> None:
        """Store the schema or channel that a record declares. Ignore other records."""
        if opcode == Opcode.SCHEMA:
            self._add_schema(SchemaRecord.read(_stream(content)))
        elif opcode == Opcode.CHANNEL:
            self._add_channel(ChannelRecord.read(_stream(content)))

    def _add_schema(self, record: SchemaRecord) -> None:
        text = record.data.decode(errors="replace")
        self._schemas[record.id] = Schema(record.name, record.encoding, text)

    def _add_channel(self, record: ChannelRecord) -> None:
        if record.id in self.channels:  # one object for each, so that it can be a key
            return
        self.channels[record.id] = Channel(
            topic=record.topic,
            schema=self._schemas.get(record.schema_id, Schema("")),
            offers=read_offers(record.metadata.get("offered_qos_profiles", "")),
            type_hash=record.metadata.get("topic_type_hash", ""),
            format=record.message_encoding,
        )


def _is_complete(summary: _Summary) -> bool:
    """Whether the index lists all messages. Messages outside of chunks are never listed."""
    return bool(summary.chunks) or not summary.statistics.message_count


def _piece(content: bytes) -> _Piece:
    """Read the index record of a chunk, which says where the chunk is."""
    index = ChunkIndex.read(_stream(content))
    offsets = index.message_index_offsets
    return _Piece(
        index.message_start_time,
        index.chunk_start_offset,
        index.message_end_time,
        frozenset(offsets) if offsets else None,
    )


def _reason(error: Exception) -> str:
    """Describe what is wrong with a damaged chunk."""
    if isinstance(error, KeyError):
        return f"the file does not declare channel {error}"
    if isinstance(error, struct.error | EOFError):
        return "a record in it is cut off"
    return str(error) or type(error).__name__


def _split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the opcode and the content of each record in ``data``."""
    place = 0
    while place < len(data):
        opcode, length = _HEAD.unpack_from(data, place)
        behind = place + _HEAD.size + length
        if behind > len(data):
            raise EOFError("it is cut off")
        yield opcode, data[place + _HEAD.size : behind]
        place = behind


def _stream(content: bytes) -> ReadDataStream:
    from io import BytesIO

    return ReadDataStream(BytesIO(content))


def _is_in(stamp: int, wanted: Range) -> bool:
    return stamp >= wanted.start and (wanted.end is None or stamp <= wanted.end)
