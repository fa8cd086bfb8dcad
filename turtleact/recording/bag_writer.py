"""Writes a bag: files, split by size or duration, and ``metadata.yaml`` at the end.

Everything here blocks, so a thread calls it; see `turtleact.recording.spool`.

Source: rosbag2 ``sequential_writer.cpp``.
"""

from __future__ import annotations

import contextlib
import errno
from collections import Counter
from pathlib import Path
from typing import Final

import msgspec

from turtleact.recording.mcap_writing import Compression, McapWriter
from turtleact.recording.metadata import (
    METADATA,
    BagError,
    BagFile,
    BagInfo,
    BagTopic,
    embedded,
    offers_text,
    span,
    write_info,
)
from turtleact.recording.storage import Channel

__all__ = ["BagWriter", "Split"]

DISTRO: Final = "turtleact"
"""The text that a bag has in place of a ROS distribution."""


class Split(msgspec.Struct, frozen=True, kw_only=True):
    """When to begin another file, and how to compress files.

    Attributes:
        max_size: A file that has this many bytes is followed by another; 0 for no limit.
        max_duration: A file is followed by another after this time from its first message (ns); 0
            for no limit.
        compression: How chunks are compressed.
    """

    max_size: int = 0
    max_duration: int = 0
    compression: Compression = "none"


class BagWriter:
    """Writes a bag.

    Args:
        path: The folder, which must not exist. A path that ends in ``.mcap`` names a single file.
        split: When to begin another file.

    Raises:
        BagError: if the folder or file exists, or cannot be created.

    Attributes:
        path: The folder or file.
        lost: How many messages of each topic were passed to `write` but are not in the bag.
    """

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
        self._total: Counter[int] = Counter()
        self._files: list[BagFile] = []
        self._first = 0
        self._is_open = False
        try:
            if not self._is_single:
                path.mkdir(parents=True)
            self._writer = self._begin()
        except FileExistsError:
            problem = "it exists already; give another name, or delete it"
            raise BagError(path, problem) from None
        except OSError as error:
            raise BagError(path, f"it cannot be created: {error.strerror}") from error

    def add(self, number: int, channel: Channel) -> None:
        """Add a topic under a number that the caller chooses."""
        self._channels[number] = channel
        self._register(number)

    def write(self, number: int, stamp: int, sent: int, data: bytes) -> None:
        """Add a message to the current chunk, which is written when it is full.

        Raises:
            OSError: if the disk is full or gone. Call `close` then.
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
            self._writer.flush()

    def flush(self) -> None:
        """Put all messages so far on disk, so that a killed process would not lose them.

        Raises:
            OSError: if the disk is full or gone. Call `close` then.
        """
        self._writer.flush()

    def close(self, lost: dict[str, int]) -> None:
        """Close the last file and describe the bag.

        Args:
            lost: How many messages of each topic were lost before they came here.

        Raises:
            OSError: if something could not be written. All that was written can be read.
        """
        error: OSError | None = None
        if self._is_open:
            try:
                self._writer.flush()
            except OSError as problem:
                error = problem
            try:
                self._end(lost)
            except OSError as problem:
                error = error or problem
        if not self._is_single:
            try:
                self._describe(lost)
            except OSError as problem:
                error = error or problem
        if error is not None:
            raise error

    @property
    def _name(self) -> str:
        if self._is_single:
            return self.path.name
        return f"{self.path.name}_{len(self._files)}.mcap"

    def _begin_another(self) -> None:
        """Close the file and begin another."""
        self._writer.flush()
        self._end()
        self._writer = self._begin()
        for each in self._channels:
            self._register(each)

    def _begin(self) -> McapWriter:
        folder = self.path.parent if self._is_single else self.path
        writer = McapWriter(folder / self._name, self._split.compression)
        writer.add_metadata("rosbag2", {"serialized_metadata": embedded(BagInfo(distro=DISTRO))})
        self._offered.clear()
        self._numbers.clear()
        self._is_open = True
        return writer

    def _register(self, number: int) -> None:
        channel = self._channels[number]
        about = {
            "offered_qos_profiles": offers_text(channel.offers),
            "topic_type_hash": channel.type_hash,
        }
        self._numbers[number] = self._writer.add_channel(channel.topic, channel.schema, about)

    def _is_time_to_split(self, stamp: int) -> bool:
        split = self._split
        if not self._offered:
            return False
        return bool(
            (split.max_size and self._writer.size >= split.max_size)
            or (split.max_duration and stamp - self._first >= split.max_duration)
        )

    def _end(self, lost: dict[str, int] | None = None) -> None:
        """Close the current file. If the disk has no room for the index, drop the last messages."""
        writer, self._is_open = self._writer, False
        try:
            with contextlib.suppress(OSError):  # the index says the same, and matters more
                self._embed(writer, lost or {})
            writer.finish()
        finally:
            written = Counter({own: writer.counts[its] for own, its in self._numbers.items()})
            for number, count in (self._offered - written).items():
                self.lost[self._channels[number].topic] += count
            self._total += written
            duration = writer.end - writer.start
            self._files.append(
                BagFile(path=self._name, start=writer.start, duration=duration, count=writer.count)
            )

    def _embed(self, writer: McapWriter, lost: dict[str, int]) -> None:
        about = BagInfo(distro=DISTRO, custom=self._custom(lost))
        writer.add_metadata("rosbag2", {"serialized_metadata": embedded(about)})

    def _describe(self, lost: dict[str, int]) -> None:
        """Write ``metadata.yaml``, completely or not at all."""
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
            custom=self._custom(lost),
        )
        described, draft = self.path / METADATA, self.path / f".{METADATA}"
        try:
            draft.write_text(write_info(info), encoding="utf-8")
            draft.replace(described)
        except OSError as error:
            draft.unlink(missing_ok=True)
            if error.errno == errno.ENOSPC:  # the files can be read without it
                return
            raise

    def _custom(self, lost: dict[str, int]) -> dict[str, str]:
        counts = self.lost + Counter(lost)
        return {f"lost:{topic}": str(count) for topic, count in counts.items()}
