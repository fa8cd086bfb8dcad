"""Reads the files of bags: MCAP files, and SQLite files of rosbag2.

An MCAP file is read with the ``mcap`` package, by its index if it has one. A file that was not
closed has no index. Such a file is read from its start, in the order in which it was written, until
it ends or a record is damaged.

turtleact never writes SQLite files. Old ones contain no definitions of types, only the names of the
types. Their messages are therefore decoded with the classes that the program has under these names.

Source: rosbag2 ``sqlite_storage.cpp``.
"""

from __future__ import annotations

import sqlite3
import struct
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple
from urllib.parse import quote

import msgspec
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import Channel as ChannelRecord
from mcap.records import McapRecord, Message, Metadata, Statistics
from mcap.records import Schema as SchemaRecord
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from zstandard import ZstdError

from turtleact.errors import InvalidOption
from turtleact.recording.metadata import ABOUT, BagError, Offer, read_offers
from turtleact.recording.schemas import Schema

__all__ = [
    "LONGEST",
    "BagStorage",
    "Channel",
    "McapFile",
    "Range",
    "Raw",
    "SqliteFile",
    "in_nanoseconds",
]

LONGEST: Final = 1_000_000_000
"""The longest time that a user may pass as an option (s): about 31 years.

The stamps of every format can hold this time.
"""


class Channel(msgspec.Struct, frozen=True, kw_only=True):
    """A topic in a file.

    Attributes:
        topic: The topic's name.
        schema: The schema of its messages.
        offers: The quality of service that its publishers offered.
        type_hash: The hash of the type; empty if the file does not have it.
        format: The encoding of its messages, such as ``"cdr"``.
    """

    topic: str
    schema: Schema
    offers: tuple[Offer, ...] = ()
    type_hash: str = ""
    format: str = "cdr"


class Raw(NamedTuple):
    """A message in a file, not decoded.

    Attributes:
        stamp: When the message was received (ns since 1970).
        sent: When the message was published (ns since 1970).
        channel: The topic of the message.
        data: The encoded message.
    """

    stamp: int
    sent: int
    channel: Channel
    data: bytes


class Range(msgspec.Struct, frozen=True):
    """Selects the messages to read, by time and topic.

    Attributes:
        start: The lowest stamp of the messages to read (ns since 1970).
        end: The highest stamp of the messages to read (ns since 1970); None for no limit.
        wants: A function that gets a topic's name and returns whether to read the topic; None to
            read all topics.
    """

    start: int = 0
    end: int | None = None
    wants: Callable[[str], bool] | None = None

    def has(self, topic: str) -> bool:
        """Whether the messages of a topic are read."""
        return self.wants is None or self.wants(topic)


def in_nanoseconds(option: str, seconds: float) -> int:
    """Convert the value of an option from seconds to nanoseconds.

    Raises:
        InvalidOption: if ``seconds`` is negative, above `LONGEST` or NaN.
    """
    if not 0 <= seconds <= LONGEST:
        raise InvalidOption(option, f"expected 0 to {LONGEST:,} seconds, not {seconds!r}")
    return round(seconds * 1e9)


class BagStorage(ABC):
    """What a file of a bag has. The file is open only while its messages are read.

    Attributes:
        path: The file.
        channels: The topics in the file, by their numbers.
        counts: How many messages each topic has, by the topic's number.
        start: The time of the earliest message (ns since 1970); 0 if there is none.
        end: The time of the latest message (ns since 1970); 0 if there is none.
        is_closed: Whether the recorder closed the file.
        about: The text in the file that describes the bag; empty if there is none.
        flaw: What is missing because the file is cut off or damaged; empty if nothing is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.start = self.end = 0
        self.is_closed = True
        self.about = ""
        self.flaw = ""

    @abstractmethod
    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the messages that ``wanted`` selects, ordered by stamp.

        Raises:
            BagError: if a part of the file is damaged.
        """


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


class McapFile(BagStorage):
    """An MCAP file.

    Its messages are ordered by stamp if the file has an index. Messages with the same stamp keep
    their order in the file.

    Args:
        path: The file.

    Raises:
        BagError: if the file cannot be opened, or is not an MCAP file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._schemas: dict[int, Schema] = {}
        self._has_index = self._read_index()
        if not self._has_index:
            for record in self._records():
                self._see(record)

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the messages that ``wanted`` selects.

        Raises:
            BagError: if a chunk of a file with an index is damaged.
        """
        if wanted.end is not None and wanted.end < wanted.start:
            return
        for message in self._select(wanted) if self._has_index else self._scan(wanted):
            channel = self.channels[message.channel_id]
            yield Raw(message.log_time, message.publish_time, channel, message.data)

    def _select(self, wanted: Range) -> Iterator[Message]:
        topics = {each.topic for each in self.channels.values() if wanted.has(each.topic)}
        try:
            with self._opened() as file:
                for _, _, message in SeekingReader(file, validate_crcs=True).iter_messages(
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

    def _opened(self) -> BinaryIO:
        try:
            return self.path.open("rb")
        except OSError as error:
            raise BagError(self.path, f"it cannot be opened: {error.strerror}") from error

    def _read_index(self) -> bool:
        """Learn from the file's index what the file has. Return whether it has a whole index."""
        with self._opened() as file:
            try:
                reader = SeekingReader(file, validate_crcs=True)
            except _DAMAGED:
                raise BagError(self.path, "it is not an MCAP file") from None
            try:
                summary = reader.get_summary()
                metadata = list(reader.iter_metadata())
            except _DAMAGED:
                return False
        statistics = None if summary is None else summary.statistics
        if summary is None or statistics is None or not _is_complete(summary, statistics):
            return False
        for record in (*summary.schemas.values(), *summary.channels.values(), *metadata):
            self._see(record)
        self.counts.update(statistics.channel_message_counts)
        self.start, self.end = statistics.message_start_time, statistics.message_end_time
        return True

    def _records(self) -> Iterator[McapRecord]:
        """Yield the records from the file's start to its end, or up to what is damaged."""
        with self._opened() as file:
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


def _is_complete(summary: Summary, statistics: Statistics) -> bool:
    """Whether the index lists all messages. Messages outside of chunks are never listed."""
    if not statistics.channel_message_counts.keys() <= summary.channels.keys():
        return False
    return bool(summary.chunk_indexes) or not statistics.message_count


def _reason(error: BaseException) -> str:
    """Describe what is wrong with a damaged record."""
    if isinstance(error, struct.error | EndOfFile):
        return "a record in it is cut off"
    return str(error) or type(error).__name__


class SqliteFile(BagStorage):
    """An SQLite file.

    Args:
        path: The file.

    Raises:
        BagError: if the file cannot be opened, or is not an SQLite file of rosbag2.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        if not path.is_file():
            raise BagError(path, "it does not exist")
        try:
            with closing(self._opened()) as database:
                self._look_through(database)
        except sqlite3.Error as error:
            raise BagError(path, f"it is not an SQLite file of rosbag2: {error}") from error

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the messages that ``wanted`` selects, ordered by stamp.

        Raises:
            BagError: if the file is damaged.
        """
        chosen = [number for number, each in self.channels.items() if wanted.has(each.topic)]
        marks = ", ".join("?" * len(chosen))
        end = 2**63 - 1 if wanted.end is None else wanted.end
        query = (
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "  # noqa: S608  # marks only
            "AND timestamp BETWEEN ? AND ? ORDER BY timestamp, id"
        )
        try:
            with closing(self._opened()) as database:
                for number, stamp, data in database.execute(query, (*chosen, wanted.start, end)):
                    yield Raw(stamp, stamp, self.channels[number], data)
        except sqlite3.Error as error:
            raise BagError(self.path, f"it is damaged: {error}") from error

    def _opened(self) -> sqlite3.Connection:
        # A worker thread may read on where another has begun, one at a time.
        url = f"file:{quote(str(self.path.absolute()))}?mode=ro"
        return sqlite3.connect(url, uri=True, check_same_thread=False)

    def _look_through(self, database: sqlite3.Connection) -> None:
        texts = dict[str, Schema]()
        if _columns(database, "message_definitions"):
            query = (
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            for name, encoding, text in database.execute(query):
                texts[name] = Schema(name, encoding, text)
        columns = _columns(database, "topics")
        offers = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        hashes = "type_description_hash" if "type_description_hash" in columns else "''"
        query = f"SELECT id, name, type, serialization_format, {offers}, {hashes} FROM topics"  # noqa: S608  # names of ours
        for number, topic, type_name, format, offered, type_hash in database.execute(query):
            self.channels[number] = Channel(
                topic=topic,
                schema=texts.get(type_name, Schema(type_name)),
                offers=read_offers(offered),
                type_hash=type_hash,
                format=format,
            )
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY 1"
        found = list(database.execute(query))
        self.counts.update({number: count for number, count, _, _ in found})
        if found:
            self.start = min(first for _, _, first, _ in found)
            self.end = max(last for _, _, _, last in found)


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {name for _, name, *_ in database.execute(f"PRAGMA table_info({table})")}
