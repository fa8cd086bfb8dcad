"""Reads a bag, which is a folder with ``metadata.yaml`` and files, or a single file.

What a bag has is read from its files. ``metadata.yaml`` only says which files they are, in which
order. If it is missing, because the recorder was killed, the files have the order of their numbers.

Source: rosbag2 ``docs/storage_plugin_development.md`` and ``sequential_reader.cpp``.
"""

from __future__ import annotations

import logging
import re
from collections.abc import AsyncGenerator, Callable, Collection, Iterable, Iterator
from contextlib import aclosing
from itertools import islice
from pathlib import Path
from typing import Any, Final

import msgspec

from turtleact.errors import InvalidMessage
from turtleact.interfaces import Message
from turtleact.recording.metadata import (
    METADATA,
    BagError,
    BagFile,
    BagInfo,
    BagTopic,
    Description,
    read_description,
    read_embedded,
)
from turtleact.recording.schemas import Schema, class_of
from turtleact.recording.storage import BagStorage, Channel, McapFile, Range, Raw, SqliteFile

__all__ = ["Bag", "Recorded", "messages_in", "read", "reader_of"]

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
        paths, said = self._find()
        self._storages = [_open(each) for each in paths]
        self._flawed = [each for each in self._storages if each.flaw]
        self.info = self._look(said)

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the wanted messages, ordered by stamp within each file.

        If a file is cut off or damaged so that messages are missing, a warning is logged once.

        Raises:
            BagError: if damaged messages prevent further reading.
        """
        while self._flawed:
            flawed = self._flawed.pop(0)
            logger.warning("bag '%s': %s", flawed.path, flawed.flaw)
        for storage in self._storages:
            if storage.end >= wanted.start and (wanted.end is None or storage.start <= wanted.end):
                yield from storage.messages(wanted)

    def channels(self) -> list[Channel]:
        """Return the topics of all files, with their schemas."""
        found = dict[tuple[str, str], Channel]()
        for storage in self._storages:
            for channel in storage.channels.values():
                found.setdefault((channel.topic, channel.schema.name), channel)
        return list(found.values())

    def _find(self) -> tuple[list[Path], Description | None]:
        """Return the bag's files, and what ``metadata.yaml`` says about them."""
        if not self.path.exists():
            raise BagError(self.path, "it does not exist")
        if not self.path.is_dir():
            return [self.path], None
        described = self.path / METADATA
        if described.exists():
            return self._described(described)
        found = (each for each in self.path.iterdir() if each.suffix in SUFFIXES)
        files = sorted(found, key=_by_number)
        if not files:
            raise BagError(self.path, "it has neither metadata.yaml nor files of a bag")
        return files, None

    def _described(self, path: Path) -> tuple[list[Path], Description]:
        """Read ``metadata.yaml``.

        Raises:
            BagError: if a file is missing, or if rosbag2 has compressed whole files or messages.
        """
        try:
            said = read_description(path.read_text(encoding="utf-8"), path)
        except (OSError, UnicodeDecodeError) as error:
            raise BagError(path, f"it cannot be read: {error}") from error
        if said.compression:
            hint = "'ros2 bag convert' can write it without"
            raise BagError(self.path, f"its {said.compression}s are compressed: {hint}")
        missing = [each for each in said.files if not (self.path / each).is_file()]
        if missing:
            raise BagError(self.path, f"{', '.join(missing)} is missing; metadata.yaml names it")
        return [self.path / each for each in said.files], said

    def _look(self, said: Description | None) -> BagInfo:
        """Return what the files say, and what ``metadata.yaml`` says, about the bag."""
        storages = self._storages
        filled = [each for each in storages if each.counts.total()]
        start = min((each.start for each in filled), default=0)
        inside = next((each.about for each in reversed(storages) if each.about), "")
        said = said or read_embedded(inside)
        return BagInfo(
            files=tuple(map(_file, storages)),
            topics=_topics(storages),
            storage=SUFFIXES.get(storages[0].path.suffix, "mcap") if storages else "mcap",
            start=start,
            duration=max((each.end for each in filled), default=0) - start,
            count=sum(each.counts.total() for each in storages),
            size=sum(each.path.stat().st_size for each in storages),
            distro=said.distro,
            custom=said.custom,
            is_closed=all(each.is_closed for each in storages),
        )


async def messages_in(
    bag: Bag, wanted: Range, *, is_decoded: bool = True
) -> AsyncGenerator[Recorded]:
    """Read the messages of a bag in a thread, and decode them in the event loop.

    Virtual time stands still while the thread reads. Cancelling: safe.

    Args:
        bag: The bag.
        wanted: Which messages to read.
        is_decoded: Whether to decode the messages.
    """
    import anyio.to_thread  # slow to import, and not needed to look at a bag

    from turtleact.tasks import thread_work  # as above

    found = bag.messages(wanted)
    readers: dict[Channel, Callable[[bytes], Message | None]] = {}
    while True:
        with thread_work().counted():
            batch = await anyio.to_thread.run_sync(list, islice(found, BATCH))
        if not batch:
            return
        for raw in batch:
            channel, value = raw.channel, None
            if is_decoded:
                if channel not in readers:
                    readers[channel] = reader_of(channel)
                value = readers[channel](raw.data)
            yield Recorded(channel.topic, raw.stamp, channel.schema, raw.data, value)


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
    async with aclosing(messages_in(bag, Range(start, end, wants))) as messages:
        async for message in messages:
            yield message


def _open(path: Path) -> BagStorage:
    return SqliteFile(path) if path.suffix == ".db3" else McapFile(path)


def _by_number(path: Path) -> tuple[int, str]:
    """Return the key that sorts ``NAME_10.mcap`` after ``NAME_9.mcap``."""
    found = re.search(r"_(\d+)$", path.stem)
    return (int(found[1]) if found else 0, path.name)


def _file(storage: BagStorage) -> BagFile:
    return BagFile(
        path=storage.path.name,
        start=storage.start,
        duration=storage.end - storage.start,
        count=storage.counts.total(),
    )


def _topics(storages: Iterable[BagStorage]) -> tuple[BagTopic, ...]:
    """Return the topics of all files together, in the order in which they were first seen."""
    topics = dict[tuple[str, str], BagTopic]()
    for storage in storages:
        for number, channel in storage.channels.items():
            key = (channel.topic, channel.schema.name)
            before = topics[key].count if key in topics else 0
            topics[key] = BagTopic(
                name=channel.topic,
                type_name=channel.schema.name,
                count=before + storage.counts[number],
                offers=channel.offers,
                type_hash=channel.type_hash,
                format=channel.format,
            )
    return tuple(topics.values())
