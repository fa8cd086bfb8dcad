"""Writes a bag: a single MCAP file, or a folder with MCAP files and ``metadata.yaml``.

Messages are collected in memory until a chunk is full or `BagWriter.flush` is called. If the
process is killed, the last file has no index and can be read up to its last chunk. If the disk
fills up, the last file is cut back to the end of its last chunk. A bag whose ``metadata.yaml``
found no room can be read without it.

A write may block while the disk is busy, so `turtleact.recording.writer_thread` writes in a thread
of its own.

Source: rosbag2 ``sequential_writer.cpp``, and ``mcap_storage.cpp`` for the profile and the
metadata.
"""

from __future__ import annotations

import contextlib
import sys
from collections import Counter
from io import FileIO
from pathlib import Path
from typing import Final, Literal, TypeAlias

import msgspec
from mcap.writer import CompressionType, Writer

from turtleact.recording.metadata import (
    ABOUT,
    METADATA,
    NOT_CLOSED,
    BagError,
    BagFile,
    BagInfo,
    BagTopic,
    embedded,
    offers_text,
    span,
    write_info,
)
from turtleact.recording.schemas import Schema
from turtleact.recording.storage import Channel

__all__ = ["CHUNK", "BagWriter", "Compression", "McapWriter", "Split"]

Compression: TypeAlias = Literal["none", "zstd_fast", "zstd_small"]
"""How chunks are compressed. rosbag2 has presets with these names."""

CHUNK: Final = 768 * 1024
"""The size at which a chunk is written to the file (bytes), as in rosbag2."""

OVERHEAD: Final = 31
"""The bytes that a message takes in a chunk besides its data."""


class McapWriter:
    """Writes an MCAP file.

    The constructor, `flush` and `finish` may raise OSError.

    Args:
        path: The file to create. The file must not exist yet.
        compression: How to compress chunks.
        about: Describes the bag.

    Attributes:
        counts: How many messages of each channel are in the file.
        start: The time of the earliest message in the file (ns since 1970); 0 if there is none.
        end: The time of the latest message in the file (ns since 1970); 0 if there is none.
        waiting: How many messages wait in the current chunk.
        is_finished: Whether the index has been written.
    """

    def __init__(self, path: Path, compression: Compression, about: dict[str, str]) -> None:
        self.counts: Counter[int] = Counter()
        self.start = self.end = 0
        self.is_finished = False
        self._file: FileIO = path.open("xb", buffering=0)
        # The chunks are ended by `flush` alone, which knows what to do if the disk is full.
        kind = CompressionType.NONE if compression == "none" else CompressionType.ZSTD
        self._writer = Writer(self._file, chunk_size=sys.maxsize, compression=kind)
        self._schemas: dict[Schema, int] = {}
        self._added: Counter[int] = Counter()
        self._first = self._last = 0
        self._chunk_size = 0
        self.waiting = 0
        try:
            self._writer.start("ros2", "turtleact")
            self._writer.add_metadata(ABOUT, about)
            self._writer.flush()  # type: ignore[no-untyped-call]  # mcap leaves it out
        except OSError:  # an empty file would make the folder's other files unreadable
            self._file.close()
            path.unlink()
            raise
        self._written = self._file.tell()

    @property
    def size(self) -> int:
        """The size of the file (bytes) if the current chunk were written without compression."""
        return self._written + self._chunk_size

    @property
    def count(self) -> int:
        """How many messages are in the file."""
        return self.counts.total()

    def add_channel(self, topic: str, schema: Schema, metadata: dict[str, str]) -> int:
        """Add a channel and return its number in the file."""
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(
                schema.name, schema.encoding, schema.text.encode()
            )
        return self._writer.register_channel(topic, "cdr", self._schemas[schema], metadata)

    def add(self, channel: int, stamp: int, sent: int, data: bytes) -> None:
        """Add a message.

        Args:
            channel: The number of the message's channel, from `add_channel`.
            stamp: When the message was received (ns since 1970).
            sent: When the message was published (ns since 1970).
            data: The encoded message.
        """
        self._writer.add_message(channel, stamp, data, sent)
        self._first = min(stamp, self._first) if self.waiting else stamp
        self._last = max(stamp, self._last)
        self._added[channel] += 1
        self._chunk_size += OVERHEAD + len(data)
        self.waiting += 1

    @property
    def is_full(self) -> bool:
        """Whether the current chunk is large enough to be written."""
        return self._chunk_size >= CHUNK

    def flush(self) -> None:
        """Write the current chunk to the file. After a failed write, this method has no effect.

        Raises:
            OSError: if the chunk cannot be written. Its messages are then lost, and the file is
                closed without an index.
        """
        if self._file.closed:
            return
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]  # mcap leaves it out
        except OSError:
            self._give_up()
            raise
        self._written = self._file.tell()
        if self.waiting:
            self.start = min(self._first, self.start) if self.counts else self._first
            self.end = max(self._last, self.end)
            self.counts += self._added
            self._added.clear()
            self._first = self._last = 0
            self._chunk_size = 0
            self.waiting = 0

    def finish(self, about: dict[str, str]) -> None:
        """Write the description of the bag and the index, and close the file.

        Call `flush` first. After a failed write, this method has no effect.

        Raises:
            OSError: if the disk has no room. The file then has no index, but its messages can be
                read.
        """
        if self._file.closed:
            return
        try:
            self._writer.add_metadata(ABOUT, about)
            self._writer.finish()  # type: ignore[no-untyped-call]  # as above
            self._writer.flush()  # type: ignore[no-untyped-call]  # as above
        except OSError:
            self._give_up()
            raise
        self._file.close()
        self.is_finished = True

    def _give_up(self) -> None:
        """Remove what was written of a chunk or an index, and close the file.

        Closing the file keeps ``mcap`` from writing the rest of it later.
        """
        self._file.truncate(self._written)
        self._file.close()


DISTRO: Final = "turtleact"
"""The text that a bag has in place of a ROS distribution."""


class Split(msgspec.Struct, frozen=True, kw_only=True):
    """When to begin another file, and how to compress files.

    Attributes:
        max_size: The size at which a file is closed and another is begun (bytes); 0 for no limit.
        max_duration: The longest time from the first message of a file to its last (ns); 0 for no
            limit.
        compression: How the chunks of a file are compressed.
    """

    max_size: int = 0
    max_duration: int = 0
    compression: Compression = "none"


class BagWriter:
    """Writes a bag.

    Args:
        path: The folder to create, or the single file if the path ends in ``.mcap``.
        split: When to begin another file, and how to compress files.

    Raises:
        BagError: if the folder or file exists already or cannot be created, or if ``split`` has a
            limit although the bag is a single file.

    Attributes:
        path: The folder or file.
        lost: How many messages of each topic were passed to `write` but are not in the bag.
    """

    _writer: McapWriter

    def __init__(self, path: Path, split: Split) -> None:
        self.path = path
        self.lost: Counter[str] = Counter()
        self._split = split
        self._is_single = path.suffix == ".mcap"
        if self._is_single and (split.max_size or split.max_duration):
            raise BagError(path, "a single file cannot be split; name a folder instead")
        self._channels: dict[int, Channel] = {}
        self._offered: Counter[int] = Counter()  # messages given to the current file
        self._numbers: dict[int, int] = {}  # channels as the current file numbers them
        self._about: dict[int, dict[str, str]] = {}  # as every file describes the channels
        self._head = {"serialized_metadata": embedded(BagInfo(distro=DISTRO))}
        self._total: Counter[int] = Counter()
        self._files: list[BagFile] = []
        self._first = 0
        self._is_open = False
        self._not_closed = ""  # the file that could not be closed
        self._create()

    @property
    def waiting(self) -> int:
        """How many messages were passed to `write` but are not on disk.

        Any thread may read this property.
        """
        return self._writer.waiting

    def add(self, number: int, channel: Channel) -> None:
        """Add a topic under a number that the caller chooses."""
        self._channels[number] = channel
        self._about[number] = {
            "offered_qos_profiles": offers_text(channel.offers),
            "topic_type_hash": channel.type_hash,
        }
        self._register(number)

    def write(self, number: int, stamp: int, sent: int, data: bytes) -> None:
        """Add a message to the current chunk. The chunk is written to disk when it is full.

        Raises:
            OSError: if the disk is full or gone. The caller must then call
                `close`.
        """
        if self._is_time_to_split(stamp):
            try:
                self._begin_another()
            except OSError:
                self.lost[self._channels[number].topic] += 1
                raise
        if not self._offered:
            self._first = stamp
        self._offered[number] += 1
        self._writer.add(self._numbers[number], stamp, sent, data)
        if self._writer.is_full:
            self.flush()

    def flush(self) -> None:
        """Write all messages added so far to disk, so that they survive if the process is killed.

        Raises:
            OSError: if the disk is full or gone. The caller must then call
                `close`.
        """
        self._writer.flush()

    def close(self, lost: dict[str, int]) -> None:
        """Close the last file and, if the bag is a folder, write ``metadata.yaml``.

        Args:
            lost: How many messages of each topic were dropped instead of being passed to `write`.

        Raises:
            OSError: if something could not be written, or the folder was deleted. The messages that
                were written can still be read.
        """
        errors: list[OSError] = []
        for step in (self._close_file, self._describe):
            try:
                step(lost)
            except OSError as problem:
                errors.append(problem)
        if errors:
            raise errors[0]

    @property
    def _name(self) -> str:
        if self._is_single:
            return self.path.name
        return f"{self.path.name}_{len(self._files)}.mcap"

    @property
    def _folder(self) -> Path:
        return self.path.parent if self._is_single else self.path

    def _create(self) -> None:
        path = self.path
        try:
            path.name.encode()
        except UnicodeEncodeError:
            problem = "its name is not UTF-8, as ROS 2's file metadata.yaml requires"
            raise BagError(path, f"{problem}; give another name") from None
        is_made = False
        try:
            if not self._is_single:
                path.mkdir(parents=True)
                is_made = True
            self._writer = self._begin()
        except OSError as error:
            if is_made:  # an empty folder would only be in the way
                with contextlib.suppress(OSError):
                    path.rmdir()
            if isinstance(error, FileExistsError):
                problem = "it exists already; give another name, or delete it"
                raise BagError(path, problem) from None
            raise BagError(path, f"it cannot be created: {error.strerror}") from error

    def _begin_another(self) -> None:
        """Close the current file and begin another."""
        self.flush()
        self._end()
        self._writer = self._begin()
        for each in self._channels:
            self._register(each)

    def _begin(self) -> McapWriter:
        writer = McapWriter(self._folder / self._name, self._split.compression, self._head)
        self._offered.clear()
        self._numbers.clear()
        self._is_open = True
        return writer

    def _register(self, number: int) -> None:
        channel = self._channels[number]
        about = self._about[number]
        self._numbers[number] = self._writer.add_channel(channel.topic, channel.schema, about)

    def _is_time_to_split(self, stamp: int) -> bool:
        split = self._split
        if not self._offered:
            return False
        return bool(
            (split.max_size and self._writer.size >= split.max_size)
            or (split.max_duration and stamp - self._first >= split.max_duration)
        )

    def _close_file(self, lost: dict[str, int]) -> None:
        """Close the last file."""
        if not self._is_open:
            return
        problem: OSError | None = None
        try:
            self._writer.flush()
        except OSError as error:
            problem = error
        self._end(lost)
        if problem is not None:
            raise problem

    def _end(self, lost: dict[str, int] | None = None) -> None:
        """Close the current file."""
        writer, self._is_open = self._writer, False
        try:
            writer.finish(self._about_bag(lost or {}))
        finally:
            if not writer.is_finished:
                self._not_closed = self._name
            self.lost += self._lost_of_file()
            self._total += self._written()
            duration = writer.end - writer.start
            self._files.append(
                BagFile(path=self._name, start=writer.start, duration=duration, count=writer.count)
            )

    def _written(self) -> Counter[int]:
        """How many messages of each channel are in the current file."""
        counts = self._writer.counts
        return Counter({own: counts[its] for own, its in self._numbers.items()})

    def _lost_of_file(self) -> Counter[str]:
        """Count the messages of each topic that were added for the current file but not written."""
        lost = Counter[str]()
        for number, count in (self._offered - self._written()).items():
            lost[self._channels[number].topic] += count
        return lost

    def _about_bag(self, lost: dict[str, int]) -> dict[str, str]:
        """Return the metadata to write at the end of a file."""
        custom = _custom(self.lost + self._lost_of_file() + Counter(lost))
        if not custom:
            return self._head
        return {"serialized_metadata": embedded(BagInfo(distro=DISTRO, custom=custom))}

    def _describe(self, lost: dict[str, int]) -> None:
        """Write ``metadata.yaml``, completely or not at all."""
        if self._is_single:
            return
        custom = _custom(self.lost + Counter(lost))
        if self._not_closed:
            custom[NOT_CLOSED] = self._not_closed
        start, duration = span(self._files)
        info = BagInfo(
            files=tuple(self._files),
            topics=tuple(
                BagTopic(
                    name=channel.topic,
                    type_name=channel.schema.name,
                    count=self._total[number],
                    offers=channel.offers,
                )
                for number, channel in self._channels.items()
            ),
            start=start,
            duration=duration,
            count=self._total.total(),
            distro=DISTRO,
            custom=custom,
        )
        draft = self.path / f".{METADATA}"
        try:
            draft.write_text(write_info(info), encoding="utf-8", newline="\n")
            draft.replace(self.path / METADATA)
        except OSError:
            draft.unlink(missing_ok=True)
            raise


def _custom(lost: Counter[str]) -> dict[str, str]:
    return {f"lost:{topic}": str(count) for topic, count in lost.items()}
