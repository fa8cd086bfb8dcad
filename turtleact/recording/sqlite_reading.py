"""Reads one SQLite file of rosbag2. turtleact never writes such files.

Old files contain no definitions of types, only the names of the types. Messages of old files are
therefore decoded with the classes that the program has under these names.

Source: rosbag2 ``sqlite_storage.cpp``.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from turtleact.recording.metadata import BagError, read_offers
from turtleact.recording.schemas import Schema
from turtleact.recording.storage import Channel, Range, Raw

__all__ = ["SqliteFile"]


class SqliteFile:
    """An SQLite file, open for reading; see `turtleact.recording.storage.BagStorage`.

    Args:
        path: The file.

    Raises:
        BagError: if the file cannot be opened, or is not an SQLite file of rosbag2.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_closed = True
        self.about = self.flaw = ""
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] = {}
        self.start = self.end = 0
        if not path.is_file():
            raise BagError(path, "it does not exist")
        try:
            # A worker thread may read on where another has begun, one at a time.
            self._database = sqlite3.connect(
                f"file:{quote(str(path.absolute()))}?mode=ro", uri=True, check_same_thread=False
            )
        except sqlite3.Error as error:
            raise BagError(path, f"it cannot be opened: {error}") from error
        try:
            self._look_through()
        except sqlite3.Error as error:
            self._database.close()
            raise BagError(path, f"it is not an SQLite file of rosbag2: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def messages(self, wanted: Range) -> Iterator[Raw]:
        """Yield the messages that ``wanted`` selects, ordered by stamp.

        Raises:
            BagError: if the file is damaged.
        """
        chosen = [number for number, each in self.channels.items() if wanted.has(each.topic)]
        marks = ", ".join("?" * len(chosen))
        # SQLite's numbers have 64 bits.
        start, end = (
            max(-(2**63), min(each, 2**63 - 1))
            for each in (wanted.start, 2**63 - 1 if wanted.end is None else wanted.end)
        )
        query = (
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "  # noqa: S608  # marks only
            "AND timestamp BETWEEN ? AND ? ORDER BY timestamp, id"
        )
        try:
            for number, stamp, data in self._rows(query, *chosen, start, end):
                yield Raw(stamp, stamp, self.channels[number], data)
        except sqlite3.Error as error:
            raise BagError(self.path, f"it is damaged: {error}") from error

    def _look_through(self) -> None:
        texts = dict[str, Schema]()
        if self._columns("message_definitions"):
            query = (
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            for name, encoding, text in self._rows(query):
                texts[name] = Schema(name, encoding, text)
        columns = self._columns("topics")
        offers = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        hashes = "type_description_hash" if "type_description_hash" in columns else "''"
        query = f"SELECT id, name, type, serialization_format, {offers}, {hashes} FROM topics"  # noqa: S608  # names of ours
        for number, topic, type_name, format, offered, type_hash in self._rows(query):
            self.channels[number] = Channel(
                topic=topic,
                schema=texts.get(type_name, Schema(type_name)),
                offers=read_offers(offered),
                type_hash=type_hash,
                format=format,
            )
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY 1"
        found = list(self._rows(query))
        self.counts = {number: count for number, count, _, _ in found}
        if found:
            self.start = min(first for _, _, first, _ in found)
            self.end = max(last for _, _, _, last in found)

    def _columns(self, table: str) -> set[str]:
        return {name for _, name, *_ in self._rows(f"PRAGMA table_info({table})")}

    def _rows(self, query: str, *values: object) -> Iterator[Any]:
        return iter(self._database.execute(query, values))
