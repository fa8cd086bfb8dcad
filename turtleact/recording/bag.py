"""Reads a bag, which is a folder with ``metadata.yaml`` and files, or a single file.

A file is opened when its messages are read. But if ``metadata.yaml`` is missing, because the
recorder was killed, all files are opened at once to find out what they contain.

Source: rosbag2 ``docs/storage_plugin_development.md`` and ``sequential_reader.cpp``.
"""

from __future__ import annotations

import logging
import re
from collections.abc import AsyncGenerator, Callable, Collection, Iterator
from contextlib import aclosing
from itertools import islice
from pathlib import Path
from typing import Any, Final

import msgspec

from turtleact.errors import InvalidMessage
from turtleact.interfaces import Message
from turtleact.recording.metadata import (
    METADATA,
    ROOT,
    BagError,
    BagFile,
    BagInfo,
    BagTopic,
    read_info,
    span,
)
from turtleact.recording.schemas import Schema, class_of
from turtleact.recording.storage import BagStorage, Channel, McapFile, Range, Raw, SqliteFile

__all__ = ["Bag", "Reading", "Recorded", "read", "reader_of"]

logger = logging.getLogger("turtleact.recording")

SUFFIXES: Final = {".mcap": "mcap", ".db3": "sqlite3"}

BATCH: Final = 256
"""How many messages a thread reads at once."""


class Recorded(msgspec.Struct, frozen=True):
    """A message of a bag.

    Attributes:
        topic: The name of its topic.
        stamp: When it was recorded (ns since 1970).
        schema: The type of the message, with the definition that the bag has.
        data: The encoded message: CDR, unless the bag names another format for the topic.
        value: The decoded message. The value is None if the reader does not decode messages, if the
            type is unknown, or if the bytes do not fit the type.
    """

    topic: str
    stamp: int
    schema: Schema
    data: bytes
    value: Any  # each type has fields of its own

    @property
    def type_name(self) -> str:
        """The message's type, ``pkg/kind/Name``."""
        return self.schema.name


class Bag:
    """A bag that is open for reading.

    Args:
        path: The folder, or a single file.

    Raises:
        BagError: if there is no bag, or it cannot be read.

    Attributes:
        path: The folder or file.
        info: What is known about the bag without reading messages.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._open: dict[Path, BagStorage] = {}
        self._told: set[Path] = set()
        try:
            self.info = self._look()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the bag's files."""
        while self._open:
            self._open.popitem()[1].close()

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the wanted messages, ordered by stamp within each file.

        If a file is cut off or damaged so that messages are missing, a warning is logged.

        Raises:
            BagError: if damaged messages prevent further reading.
        """
        for file in self.info.files:
            is_outside = file.count and (
                file.start + file.duration < wanted.start
                or (wanted.end is not None and file.start > wanted.end)
            )
            if not is_outside:
                storage = self.storage(file.path)
                self._tell(storage)
                yield from storage.messages(wanted)

    def check(self) -> None:
        """Open each file, and log what is missing from it.

        SQLite files are not checked, because they show damage only when their messages are read.
        """
        if self.info.storage == "sqlite3":
            return
        for file in self.info.files:
            storage = self.storage(file.path)
            self._tell(storage)
            del self._open[storage.path]  # a bag may have more files than may be open at once
            storage.close()

    def storage(self, name: str) -> BagStorage:
        """Return one of the bag's files, open for reading."""
        path = self.path / name if self.path.is_dir() else self.path
        if path not in self._open:
            self._open[path] = _open(path)
        return self._open[path]

    def channels(self) -> list[Channel]:
        """Return the topics of all files, with their schemas."""
        found = dict[tuple[str, str], Channel]()
        for file in self.info.files:
            for channel in self.storage(file.path).channels.values():
                found.setdefault((channel.topic, channel.schema.name), channel)
        return list(found.values())

    def _tell(self, storage: BagStorage) -> None:
        """Log what is missing from a file, unless this was logged before."""
        if storage.flaw and storage.path not in self._told:
            self._told.add(storage.path)
            logger.warning("bag '%s': %s", storage.path, storage.flaw)

    def _look(self) -> BagInfo:
        if not self.path.exists():
            raise BagError(self.path, "it does not exist")
        if not self.path.is_dir():
            return self._from_files([self.path])
        described = self.path / METADATA
        if described.exists():
            if not described.is_file():
                raise BagError(described, "it is not a regular file")
            try:
                info = read_info(described.read_text(encoding="utf-8"), described)
            except (OSError, UnicodeDecodeError) as error:
                raise BagError(described, f"it cannot be read: {error}") from error
            return self._checked(info)
        files = sorted(
            (each for each in self.path.iterdir() if each.suffix in SUFFIXES), key=_by_number
        )
        if not files:
            raise BagError(self.path, "it has neither metadata.yaml nor files of a bag")
        return self._from_files(files)

    def _checked(self, info: BagInfo) -> BagInfo:
        """Check the description from ``metadata.yaml``, and add the total size of the files.

        Raises:
            BagError: if a file is missing, or if rosbag2 has compressed whole files or messages.
        """
        if info.compression:
            hint = "'ros2 bag convert' can write it without"
            raise BagError(self.path, f"its {info.compression}s are compressed: {hint}")
        # Before version 4, paths began with the folder's own name.
        names = [each.path.rpartition("/")[2] for each in info.files]
        missing = [each for each in names if not (self.path / each).is_file()]
        if missing:
            raise BagError(self.path, f"{', '.join(missing)} is missing; metadata.yaml names it")
        sizes = [(self.path / each).stat().st_size for each in names]
        files = tuple(
            msgspec.structs.replace(each, path=name)
            for each, name in zip(info.files, names, strict=True)
        )
        return msgspec.structs.replace(info, files=files, size=sum(sizes))

    def _from_files(self, paths: list[Path]) -> BagInfo:
        files, topics, about = list[BagFile](), dict[tuple[str, str], BagTopic](), ""
        is_closed = True
        for path in paths:
            storage = self._open[path] = _open(path)
            count = sum(storage.counts.values())
            files.append(
                BagFile(
                    path=path.name,
                    start=storage.start,
                    duration=storage.end - storage.start,
                    count=count,
                )
            )
            _add_topics(storage, topics)
            about = storage.about or about
            is_closed &= storage.is_closed
        start, duration = span(files)
        inside = _described(about, paths[-1])
        return BagInfo(
            files=tuple(files),
            topics=tuple(topics.values()),
            storage=SUFFIXES[paths[0].suffix],
            start=start,
            duration=duration,
            count=sum(file.count for file in files),
            size=sum(path.stat().st_size for path in paths),
            distro=inside.distro,
            custom=inside.custom,
            is_closed=is_closed,
        )


class Reading:
    """Reads the messages of a bag in a thread, and decodes them in the event loop.

    Args:
        bag: The bag. The caller must close it.
        wanted: Which messages to read.
        is_decoded: Whether to decode the messages.
    """

    def __init__(self, bag: Bag, wanted: Range, *, is_decoded: bool = True) -> None:
        self.bag = bag
        self._messages = bag.messages(wanted)
        self._is_decoded = is_decoded
        self._classes: dict[Channel, Callable[[bytes], Message | None]] = {}

    async def batches(self) -> AsyncGenerator[list[Recorded]]:
        """Yield the messages in batches. Cancelling: safe."""
        import anyio.to_thread  # slow to import, and not needed to look at a bag

        while True:
            batch = await anyio.to_thread.run_sync(self._read)
            if not batch:
                return
            yield [self._recorded(raw) for raw in batch]

    def _read(self) -> list[Raw]:
        return list(islice(self._messages, BATCH))

    def _recorded(self, raw: Raw) -> Recorded:
        channel = raw.channel
        value = None
        if self._is_decoded:
            read = self._classes.get(channel)
            if read is None:
                read = self._classes[channel] = reader_of(channel)
            value = read(raw.data)
        return Recorded(channel.topic, raw.stamp, channel.schema, raw.data, value)


def reader_of(channel: Channel) -> Callable[[bytes], Message | None]:
    """Return a function that decodes messages of a topic.

    The returned function returns None for data that cannot be decoded.
    """
    from turtleact.interfaces.cdr import decode  # slow to import

    cls = class_of(channel.schema, channel.type_hash) if channel.format == "cdr" else None

    def read(data: bytes) -> Message | None:
        try:
            return None if cls is None else decode(cls, data)
        except InvalidMessage:
            return None

    return read


async def read(
    path: str | Path,
    *,
    topics: Collection[str] | None = None,
    start: int = 0,
    end: int | None = None,
) -> AsyncGenerator[Recorded]:
    """Yield the messages of a bag, ordered by stamp within each file.

    The bag may have been recorded by turtleact, rosbag2 or rosbags, as MCAP or SQLite. Only the
    needed parts of a large file are read. If messages are missing because a file is cut off or
    damaged, a warning is logged.

    Args:
        path: The folder of the bag, or a single file.
        topics: The names of the topics to read; None for all topics.
        start: The earliest stamp to read (ns since 1970).
        end: The latest stamp to read (ns since 1970); None for no limit.

    Raises:
        BagError: if there is no bag, or damaged messages prevent further reading.
    """
    import anyio.to_thread  # as above

    wants = None if topics is None else frozenset(topics).__contains__
    bag = await anyio.to_thread.run_sync(Bag, path)
    try:
        async with aclosing(Reading(bag, Range(start, end, wants)).batches()) as batches:
            async for batch in batches:
                for message in batch:
                    yield message
    finally:
        bag.close()


def _open(path: Path) -> BagStorage:
    if path.exists() and not path.is_file():  # reading from a pipe could wait for ever
        raise BagError(path, "it is not a regular file")
    if path.suffix == ".db3":
        return SqliteFile(path)
    return McapFile(path)


def _by_number(path: Path) -> tuple[int, str]:
    """Return the key that sorts ``NAME_10.mcap`` after ``NAME_9.mcap``."""
    found = re.search(r"_(\d+)$", path.stem)
    return (int(found[1]) if found else 0, path.name)


def _add_topics(storage: BagStorage, topics: dict[tuple[str, str], BagTopic]) -> None:
    """Add the topics of a file to the topics of the bag."""
    for number, channel in storage.channels.items():
        key = (channel.topic, channel.schema.name)
        held = topics.get(key)
        count = storage.counts.get(number, 0) + (held.count if held else 0)
        topics[key] = BagTopic(
            name=channel.topic,
            type_name=channel.schema.name,
            count=count,
            offers=channel.offers,
            type_hash=channel.type_hash,
            format=channel.format,
        )


def _described(about: str, path: Path) -> BagInfo:
    """Parse ``about``, a description of the bag; return an empty `BagInfo` if it is invalid."""
    indented = "".join(f"  {line}\n" for line in about.splitlines())
    try:
        return read_info(f"{ROOT}:\n{indented}", path)
    except BagError:
        return BagInfo()
