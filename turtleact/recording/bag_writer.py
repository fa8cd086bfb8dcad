"""Writes a bag: a single MCAP file, or a folder with MCAP files and ``metadata.yaml``.

`convert` writes new bags from old ones: it merges, filters, splits or compresses them, or restores
a missing index.

Messages are collected in memory until a chunk is full or `BagWriter.flush` is called. If the
process is killed or the disk fills up, the last file has no index, and the folder no
``metadata.yaml``. Such a bag can be read up to the last whole chunk.

A write may block while the disk is busy, so `turtleact.recording.writer_thread` writes in a thread
of its own.

Source: rosbag2 ``sequential_writer.cpp``, ``bag_rewrite.cpp``, and ``mcap_storage.cpp`` for the
profile and the metadata.
"""

from __future__ import annotations

import heapq
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from io import FileIO
from operator import attrgetter
from pathlib import Path
from typing import Final, Literal, TypeAlias

import msgspec
from mcap.writer import CompressionType, Writer

from turtleact.recording.bag import Bag
from turtleact.recording.metadata import (
    ABOUT,
    METADATA,
    BagError,
    BagInfo,
    embedded,
    offers_text,
    write_info,
)
from turtleact.recording.schemas import Schema
from turtleact.recording.selection import EVERYTHING, Selection
from turtleact.recording.storage import Channel, Range, Raw

__all__ = ["BagWriter", "Compression", "Output", "Split", "convert"]

Compression: TypeAlias = Literal["none", "zstd_fast", "zstd_small"]
"""How chunks are compressed. rosbag2 has presets with these names."""

CHUNK: Final = 768 * 1024
"""The size at which a chunk is written to the file (bytes), as in rosbag2."""

OVERHEAD: Final = 31
"""The bytes that a message takes in a chunk besides its data."""

CHECK: Final = 1000
"""After each group of this many messages, `convert` asks ``goes_on`` whether to continue."""

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

    After an OSError, the caller must call `close`. The messages in the chunk that could not be
    written are lost; what was written before can be read.

    Args:
        path: The folder to create, or the single file if the path ends in ``.mcap``.
        split: When to begin another file, and how to compress files.

    Attributes:
        waiting: How many messages were passed to `write` but are not on disk. Any thread may read
            this attribute.

    Raises:
        BagError: if the folder or file exists already or cannot be created, or if ``split`` has a
            limit although the bag is a single file.
    """

    _first: int | None  # the time of the current file's first message

    def __init__(self, path: Path, split: Split) -> None:
        self.path = path
        self.waiting = 0
        self._split = split
        self._is_single = path.suffix == ".mcap"
        if self._is_single and (split.max_size or split.max_duration):
            raise BagError(path, "a single file cannot be split; name a folder instead")
        self._channels: dict[int, Channel] = {}
        self._head = embedded(BagInfo(distro=DISTRO))
        self._number = 0  # of the current file
        self._create()

    def add(self, number: int, channel: Channel) -> None:
        """Add a topic under a number that the caller chooses."""
        self._channels[number] = channel
        self._register(number)

    def write(self, number: int, stamp: int, sent: int, data: bytes) -> None:
        """Add a message to the current chunk. The chunk is written to disk when it is full.

        Raises:
            OSError: if the disk is full or gone.
        """
        if self._is_time_to_split(stamp):
            self._finish(self._head)
            self._number += 1
            self._begin()
        if self._first is None:
            self._first = stamp
        self._writer.add_message(self._numbers[number], stamp, data, sent)
        self.waiting += 1
        self._chunk_size += OVERHEAD + len(data)
        if self._chunk_size >= CHUNK:
            self.flush()

    def flush(self) -> None:
        """Write all messages added so far to disk, so that they survive if the process is killed.

        Raises:
            OSError: if the disk is full or gone.
        """
        if self._file.closed:
            return
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]  # mcap leaves it out
        except OSError:
            self._file.close()  # so that mcap cannot write the rest of the chunk later
            raise
        self._written = self._file.tell()
        self._chunk_size = self.waiting = 0

    def close(self, lost: Mapping[str, int]) -> None:
        """Close the last file and, if the bag is a folder, write ``metadata.yaml``.

        After a failed write, close the file as it is.

        Args:
            lost: How many messages of each topic were dropped instead of being passed to `write`.

        Raises:
            OSError: if something could not be written, or the folder was deleted.
        """
        custom = {f"lost:{topic}": str(count) for topic, count in lost.items()}
        is_whole = self._finish(embedded(BagInfo(distro=DISTRO, custom=custom)))
        if is_whole and not self._is_single:
            self._describe()

    # files

    def _create(self) -> None:
        path = self.path
        is_made = False
        try:
            if not self._is_single:
                path.mkdir(parents=True)
                is_made = True
            self._begin()
        except OSError as error:
            if is_made:  # an empty folder would only be in the way
                with suppress(OSError):
                    path.rmdir()
            if isinstance(error, FileExistsError):
                problem = "it exists already; give another name, or delete it"
                raise BagError(path, problem) from None
            raise BagError(path, f"it cannot be created: {error.strerror}") from error

    def _begin(self) -> None:
        """Begin a file with all topics of the bag."""
        path = self.path
        if not self._is_single:
            path = path / f"{path.name}_{self._number}.mcap"
        self._file: FileIO = path.open("xb", buffering=0)
        # `flush` alone ends a chunk, so that it knows which messages are on disk.
        kind = CompressionType.NONE if self._split.compression == "none" else CompressionType.ZSTD
        self._writer = Writer(self._file, chunk_size=sys.maxsize, compression=kind)
        self._first = None
        self._schemas: dict[Schema, int] = {}
        self._numbers: dict[int, int] = {}  # the topics as this file numbers them
        try:
            self._writer.start("ros2", "turtleact")
            self._writer.add_metadata(ABOUT, {"serialized_metadata": self._head})
            self.flush()
        except OSError:  # an empty file would make the folder's other files unreadable
            path.unlink()
            raise
        for number in self._channels:
            self._register(number)

    def _register(self, number: int) -> None:
        channel = self._channels[number]
        schema = channel.schema
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(
                schema.name, schema.encoding, schema.text.encode()
            )
        about = {
            "offered_qos_profiles": offers_text(channel.offers),
            "topic_type_hash": channel.type_hash,
        }
        self._numbers[number] = self._writer.register_channel(
            channel.topic, "cdr", self._schemas[schema], about
        )

    def _is_time_to_split(self, stamp: int) -> bool:
        split = self._split
        if self._first is None:
            return False
        is_large = split.max_size and self._written + self._chunk_size >= split.max_size
        return bool(is_large or (split.max_duration and stamp - self._first >= split.max_duration))

    def _finish(self, about: str) -> bool:
        """Write the description of the bag and the index, and close the file.

        Return False if an earlier write has failed; the file stays as it is.
        """
        self.flush()
        if self._file.closed:
            return False
        with self._file:
            self._writer.add_metadata(ABOUT, {"serialized_metadata": about})
            self._writer.finish()  # type: ignore[no-untyped-call]  # as above
            self._writer.flush()  # type: ignore[no-untyped-call]  # as above
        return True

    def _describe(self) -> None:
        """Write ``metadata.yaml``, completely or not at all, from what the files say."""
        info = Bag(self.path).info
        draft = self.path / f".{METADATA}"
        try:
            draft.write_text(write_info(info), encoding="utf-8", newline="\n")
            draft.replace(self.path / METADATA)
        except OSError:
            draft.unlink(missing_ok=True)
            raise


class Output(msgspec.Struct, frozen=True, kw_only=True):
    """A bag to write.

    Attributes:
        path: The folder to create. A path that ends in ``.mcap`` names a single file instead.
        selection: Which messages to write to the bag.
        start: The lowest stamp of the messages to write (ns since 1970).
        end: The highest stamp of the messages to write (ns since 1970); None for no limit.
        split: When to begin another file, and how to compress the files.
    """

    path: Path
    selection: Selection = EVERYTHING
    start: int = 0
    end: int | None = None
    split: Split = Split()


def convert(
    inputs: Sequence[Path], outputs: Sequence[Output], goes_on: Callable[[], bool] = lambda: True
) -> list[int]:
    """Write the messages of bags to new bags, in the order of their stamps. This call blocks.

    If an error is raised, all outputs are removed.

    Args:
        inputs: The bags to read.
        outputs: The bags to write.
        goes_on: Returns whether to continue. `convert` calls this function before the first message
            and after every 1,000 messages. If ``goes_on`` returns False, `convert` stops reading,
            and the outputs keep the messages written so far.

    Returns:
        How many messages were written to each output.

    Raises:
        BagError: if a bag cannot be read or written.
    """
    wanted = _range(outputs)
    found = [Bag(path).messages(wanted) for path in inputs]
    writers: list[_Writing] = []
    try:
        writers.extend(map(_Writing, outputs))  # if one raises, those before it are in the list
        for count, raw in enumerate(heapq.merge(*found, key=attrgetter("stamp"))):
            if not count % CHECK and not goes_on():
                break
            for writer in writers:
                writer.take(raw)
        for writer in writers:
            writer.close()
    except BaseException:
        for writer in writers:
            writer.discard()
        raise
    return [writer.count for writer in writers]


def _range(outputs: Sequence[Output]) -> Range:
    """Return the smallest time range that covers the ranges of all outputs."""
    ends = [each.end for each in outputs if each.end is not None]
    start = min((each.start for each in outputs), default=0)
    return Range(start, max(ends) if ends and len(ends) == len(outputs) else None)


class _Writing:
    """Writes one bag."""

    def __init__(self, output: Output) -> None:
        self.count = 0
        self._output = output
        self._writer = BagWriter(output.path, output.split)
        self._numbers: dict[Channel, int | None] = {}

    def take(self, raw: Raw) -> None:
        """Write a message, if the output's range and selection include it."""
        output = self._output
        if raw.stamp < output.start or (output.end is not None and raw.stamp > output.end):
            return
        number = self._number(raw.channel)
        if number is not None:
            try:
                self._writer.write(number, raw.stamp, raw.sent, raw.data)
            except OSError as error:
                raise self._error(error) from error
            self.count += 1

    def close(self) -> None:
        """Close the bag."""
        try:
            self._writer.close({})
        except OSError as error:
            raise self._error(error) from error

    def discard(self) -> None:
        """Remove the bag, because an unfinished bag would look complete."""
        with suppress(OSError):
            self._writer.close({})
        path = self._output.path
        if path.is_dir():  # the writer has made it, so nothing else is in it
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)

    def _number(self, channel: Channel) -> int | None:
        if channel not in self._numbers:
            wanted = self._output.selection.wants(channel.topic, channel.schema.name)
            self._numbers[channel] = len(self._numbers) if wanted else None
            if wanted:
                self._writer.add(len(self._numbers) - 1, channel)
        return self._numbers[channel]

    def _error(self, error: OSError) -> BagError:
        return BagError(self._output.path, f"it cannot be written: {error.strerror}")
