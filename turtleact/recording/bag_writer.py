"""Writes a bag: a single file, or a folder with files and ``metadata.yaml``.

A disk may fill up during a recording. A hidden file in the folder therefore reserves disk space for
the index of the last file and for ``metadata.yaml``.

A write may block while the disk is busy, so `turtleact.recording.spool` writes in a thread of its
own.

Source: rosbag2 ``sequential_writer.cpp``.
"""

from __future__ import annotations

import contextlib
import errno
from collections import Counter
from io import FileIO
from pathlib import Path
from typing import Final

import msgspec

from turtleact.recording.mcap_writing import Compression, McapWriter
from turtleact.recording.metadata import (
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
from turtleact.recording.storage import Channel

__all__ = ["BagWriter", "Split"]

ABOUT: Final = "rosbag2"
"""The name of the metadata records that describe the bag."""

GONE: Final = "it was deleted, moved or renamed while it was written"
"""The text of the error if a file or the folder is missing."""

DISTRO: Final = "turtleact"
"""The text that a bag has in place of a ROS distribution."""


STEP: Final = 32 * 1024
"""The reserved disk space grows in steps of this many bytes."""

TOPIC_SIZE: Final = 500
"""An upper bound for the size of a topic's entry in ``metadata.yaml`` (bytes).

The bound does not count the names and the QoS profiles in the entry.
"""

FILE_SIZE: Final = 300
"""The maximum size of a file's entry in ``metadata.yaml``, without the file's name (bytes)."""


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
    _room: _Room | None = None

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
        self._described_size = STEP  # about how many bytes the description will have
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
        about = 3 * len(self._about[number]["offered_qos_profiles"])
        names = 4 * len(channel.topic) + len(channel.schema.name)
        self._described_size += TOPIC_SIZE + about + names
        self._register(number)

    def write(self, number: int, stamp: int, sent: int, data: bytes) -> None:
        """Add a message to the current chunk. The chunk is written to disk when it is full.

        Raises:
            OSError: if the disk is full or gone, or the file was deleted. The caller must then call
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
            OSError: if the disk is full or gone, or the file was deleted. The caller must then call
                `close`.
        """
        self._look_for([self._name])
        if self._room is not None:
            self._room.keep(self._writer.index_size + self._described_size)
        self._writer.flush()

    def close(self, lost: dict[str, int]) -> None:
        """Close the last file and, if the bag is a folder, write ``metadata.yaml``.

        Args:
            lost: How many messages of each topic were dropped instead of being passed to `write`.

        Raises:
            OSError: if something could not be written, or a file or the folder was deleted. The
                messages that were written and not deleted can still be read.
        """
        errors: list[OSError] = []
        for step in (self._close_file, self._describe):
            try:
                step(lost)
            except OSError as problem:
                errors.append(problem)
        self._look_for([each.path for each in self._files])
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
                self._room = _Room(path / f".{METADATA}")
                self._room.keep(STEP)
            self._writer = self._begin()
        except OSError as error:
            if self._room is not None:
                self._room.close()
            if is_made:  # an empty folder would only be in the way
                with contextlib.suppress(OSError):
                    path.rmdir()
            if isinstance(error, FileExistsError):
                problem = "it exists already; give another name, or delete it"
                raise BagError(path, problem) from None
            raise BagError(path, f"it cannot be created: {error.strerror}") from error

    def _look_for(self, names: list[str]) -> None:
        """Check that nobody has deleted these files or the folder.

        Raises:
            FileNotFoundError: if the folder or one of the files is missing.
        """
        if not self._folder.exists():
            raise FileNotFoundError(errno.ENOENT, GONE, str(self._folder))
        for name in names:
            if not (self._folder / name).exists():
                raise FileNotFoundError(errno.ENOENT, GONE, str(self._folder / name))

    def _begin_another(self) -> None:
        """Close the current file and begin another."""
        self.flush()
        self._end()
        self._writer = self._begin()
        for each in self._channels:
            self._register(each)

    def _begin(self) -> McapWriter:
        self._described_size += FILE_SIZE + 3 * len(self._name)
        writer = McapWriter(self._folder / self._name, self._split.compression)
        writer.add_metadata(ABOUT, self._head)
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
        """Close the last file, after freeing the disk space that is reserved for its index."""
        if not self._is_open:
            return
        problem: OSError | None = None
        try:
            self._writer.flush()
        except OSError as error:
            problem = error
        if self._room is not None:
            self._room.leave_only(self._described_size)
        self._end(lost)
        if problem is not None:
            raise problem

    def _end(self, lost: dict[str, int] | None = None) -> None:
        """Close the current file.

        If the disk has no room for the file's index, the file loses its last messages.
        """
        writer, self._is_open = self._writer, False
        try:
            writer.finish(ABOUT, lambda: self._about_bag(lost or {}))
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
        if self._room is None:
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
        try:
            self._room.become(self.path / METADATA, write_info(info).encode())
        finally:
            self._room.close()


class _Room:
    """Reserves disk space with a hidden file, which becomes ``metadata.yaml`` in the end.

    The file is filled with zeros, which can be overwritten even if the disk is full.

    Args:
        path: The hidden file, which must not exist yet.

    Raises:
        OSError: if the file cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: FileIO = path.open("xb", buffering=0)
        self._size = 0

    def keep(self, size: int) -> None:
        """Reserve at least ``size`` bytes. Raise OSError if the disk has too little space."""
        if size <= self._size:
            return
        wanted = (size // STEP + 1) * STEP
        self._file.seek(self._size)
        try:
            _write(self._file, bytes(wanted - self._size))
        except OSError:
            self._file.truncate(self._size)
            raise
        self._size = wanted

    def leave_only(self, size: int) -> None:
        """Keep the first ``size`` bytes of the reserved space, and free the rest."""
        if size < self._size:
            self._file.truncate(size)
            self._size = size

    def become(self, path: Path, content: bytes) -> None:
        """Replace the zeros in the file by ``content``, and rename the file to ``path``.

        Raises:
            OSError: if the file cannot be written or renamed.
        """
        self._file.seek(0)
        _write(self._file, content)
        self._file.truncate()
        self._file.close()  # Windows does not rename an open file
        self._path.replace(path)

    def close(self) -> None:
        """Close the file, and delete it unless it was renamed."""
        self._file.close()
        with contextlib.suppress(OSError):
            self._path.unlink()


def _write(file: FileIO, data: bytes) -> None:
    """Write all of the data.

    On a nearly full disk, the first call of ``file.write`` writes only a part of the data, and the
    second call raises OSError.
    """
    view = memoryview(data)
    while view:
        view = view[file.write(view) or 0 :]


def _custom(lost: Counter[str]) -> dict[str, str]:
    return {f"lost:{topic}": str(count) for topic, count in lost.items()}
