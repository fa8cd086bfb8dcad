"""Writes one MCAP file with the ``mcap`` package.

Messages are collected in memory until `McapWriter.flush` writes them as one chunk. If the process
is killed, the file has no index and can be read up to its last chunk. If a write fails, the file is
cut back to the end of its last chunk, and stays without an index.

Source: rosbag2 ``mcap_storage.cpp`` for the profile and the metadata.
"""

from __future__ import annotations

import sys
from collections import Counter
from io import FileIO
from pathlib import Path
from typing import Final, Literal, TypeAlias

from mcap.writer import CompressionType, Writer

from turtleact.recording.schemas import Schema

__all__ = ["ABOUT", "CHUNK", "Compression", "McapWriter"]

Compression: TypeAlias = Literal["none", "zstd_fast", "zstd_small"]
"""How chunks are compressed. rosbag2 has presets with these names."""

CHUNK: Final = 768 * 1024
"""The size at which a chunk is written to the file (bytes), as in rosbag2."""

ABOUT: Final = "rosbag2"
"""The name of the metadata records that describe the bag."""

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
