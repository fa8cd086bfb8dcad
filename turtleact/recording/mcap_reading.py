"""Reads one MCAP file with the ``mcap`` package, by its index if it has one.

A file that was not closed has no index. Such a file is read from its start, in the order in which
it was written, until it ends or a record is damaged.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import Channel as ChannelRecord
from mcap.records import McapRecord, Message, Metadata
from mcap.records import Schema as SchemaRecord
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from zstandard import ZstdError

from turtleact.recording.mcap_writing import ABOUT
from turtleact.recording.metadata import BagError, read_offers
from turtleact.recording.schemas import Schema
from turtleact.recording.storage import Channel, Range, Raw

__all__ = ["McapFile"]

_DAMAGED: Final = (
    *(McapError, struct.error, ValueError, MemoryError, OverflowError, OSError, KeyError),
    *(RuntimeError, ZstdError),  # of the packages that decompress
)
"""The exceptions that reading a damaged record may raise."""

_REST: Final = (
    "to copy the messages before or behind it, use 'turtleact bag convert' with "
    "--playback-duration or --start-offset"
)
"""The advice for a damaged chunk."""


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
        self._schemas: dict[int, Schema] = {}
        try:
            self._file: BinaryIO = path.open("rb")
        except OSError as error:
            raise BagError(path, f"it cannot be opened: {error.strerror}") from error
        try:
            self._reader = self._indexed_reader()
        except BaseException:
            self._file.close()
            raise
        if self._reader is None:
            for record in self._records():
                self._see(record)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the messages that ``wanted`` selects.

        They are ordered by stamp if the file has an index. Messages with the same stamp keep their
        order in the file.

        Raises:
            BagError: if a chunk of a file with an index is damaged.
        """
        if wanted.end is not None and wanted.end < wanted.start:
            return
        found = self._scan(wanted) if self._reader is None else self._select(self._reader, wanted)
        for message in found:
            channel = self.channels[message.channel_id]
            yield Raw(message.log_time, message.publish_time, channel, message.data)

    def _select(self, reader: SeekingReader, wanted: Range) -> Iterator[Message]:
        topics = {each.topic for each in self.channels.values() if wanted.has(each.topic)}
        try:
            for _, _, message in reader.iter_messages(
                topics, starting_at=wanted.start, ending_at=wanted.end
            ):
                yield message
        except _DAMAGED as error:
            raise BagError(self.path, f"a chunk is damaged ({_reason(error)}); {_REST}") from error

    def _scan(self, wanted: Range) -> Iterator[Message]:
        channels = {key for key, each in self.channels.items() if wanted.has(each.topic)}
        for record in self._records():
            if (
                isinstance(record, Message)
                and record.channel_id in channels
                and record.log_time >= wanted.start
                and (wanted.end is None or record.log_time <= wanted.end)
            ):
                yield record

    # opening

    def _indexed_reader(self) -> SeekingReader | None:
        """Return a reader that uses the file's index; None if the file has no whole index."""
        try:
            reader = SeekingReader(self._file, validate_crcs=True)
        except _DAMAGED:
            raise BagError(self.path, "it is not an MCAP file") from None
        try:
            summary = reader.get_summary()
            if summary is None or not _is_complete(summary):
                return None
            self._take(summary)
            for record in reader.iter_metadata():
                self._see(record)
        except _DAMAGED:
            for each in (self.channels, self.counts, self._schemas):
                each.clear()
            self.start = self.end = 0
            return None
        return reader

    def _take(self, summary: Summary) -> None:
        """Copy what the index says about the file."""
        for record in (*summary.schemas.values(), *summary.channels.values()):
            self._see(record)
        if summary.statistics is not None:
            self.counts.update(summary.statistics.channel_message_counts)
            self.start = summary.statistics.message_start_time
            self.end = summary.statistics.message_end_time

    def _records(self) -> Iterator[McapRecord]:
        """Yield the records from the file's start to its end, or up to what is damaged."""
        with self.path.open("rb") as file:
            try:
                yield from StreamReader(file, validate_crcs=True).records
            except (EndOfFile, struct.error):
                self.is_closed = False
                self.flaw = "it was not closed, so messages may be missing at its end"
            except _DAMAGED as error:
                self.is_closed = False
                self.flaw = (
                    f"a record is damaged ({_reason(error)}); this record and "
                    "everything after it are left out"
                )

    def _see(self, record: McapRecord) -> None:
        """Note what a record says about the file."""
        if isinstance(record, SchemaRecord):
            text = record.data.decode(errors="replace")
            self._schemas[record.id] = Schema(record.name, record.encoding, text)
        elif isinstance(record, ChannelRecord):
            self._add_channel(record)
        elif isinstance(record, Metadata) and record.name == ABOUT:
            self.about = record.metadata.get("serialized_metadata", "")
        elif isinstance(record, Message):
            self.start = min(record.log_time, self.start) if self.counts else record.log_time
            self.end = max(record.log_time, self.end)
            self.counts[record.channel_id] += 1

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


def _is_complete(summary: Summary) -> bool:
    """Whether the index lists all messages. Messages outside of chunks are never listed."""
    statistics = summary.statistics
    if (
        statistics is None
        or not statistics.channel_message_counts.keys() <= summary.channels.keys()
    ):
        return False
    return bool(summary.chunk_indexes) or not statistics.message_count


def _reason(error: BaseException) -> str:
    """Describe what is wrong with a damaged record."""
    if isinstance(error, KeyError):
        return f"the file does not declare channel {error}"
    if isinstance(error, struct.error | EndOfFile):
        return "a record in it is cut off"
    return str(error) or type(error).__name__
