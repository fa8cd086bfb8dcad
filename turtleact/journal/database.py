"""Stores the goals of a journal in a SQLite file, in one table with a row for each goal.

All functions here block, so the journal calls them in a thread of its own. Other processes may read
the file while the journal writes it, because the file is in SQLite's WAL mode.

A commit with ``synchronous=FULL`` waits for the disk and survives a power loss. A commit with
``synchronous=NORMAL`` is about 50 times as fast. That commit survives a killed process, but not a
power loss.

Source: sqlite.org, "Write-Ahead Logging", "PRAGMA Statements" and "Database File Format".
"""

from __future__ import annotations

import os
import socket
import sqlite3
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from turtleact.errors import TurtleactError
from turtleact.goals.records import GoalChange, GoalRecord

__all__ = [
    "Accept",
    "Change",
    "Database",
    "JournalError",
    "JournalHeld",
    "Withdraw",
    "explain",
    "find_goals",
    "prune",
    "read_goals",
]

APPLICATION = 0x7475_7274
"""Marks a file as a journal of turtleact ("turt"). SQLite stores it as ``application_id``."""

VERSION = 1
"""The version of the file's layout. SQLite stores this number as ``user_version``."""

MAGIC = b"SQLite format 3\0"
"""The first bytes of every SQLite file."""

MARK = slice(68, 72)
"""The bytes of a SQLite file that hold its ``application_id``."""

FOREIGN = "it is the file of another program; choose another name"

BUSY = 5.0
"""How long reading or pruning a journal waits for the process that writes the journal (s)."""

AT_ONCE = 1000
"""The maximum number of goals that one transaction deletes.

Servers cannot write during a transaction, so transactions must be short.
"""

PAUSE = 0.002
"""How long to pause after each transaction that deletes goals, so that a server can write (s)."""

_COLUMNS = GoalRecord.__struct_fields__

_SCHEMA = f"""
CREATE TABLE goal (
    number INTEGER PRIMARY KEY,
    id BLOB NOT NULL UNIQUE,
    action TEXT NOT NULL,
    type_name TEXT NOT NULL,
    type_hash TEXT NOT NULL,
    request BLOB NOT NULL,
    stamp INTEGER NOT NULL,
    accepted INTEGER NOT NULL,
    status INTEGER NOT NULL,
    is_built_in INTEGER NOT NULL,
    is_nested INTEGER NOT NULL,
    sender BLOB NOT NULL,
    crashes INTEGER NOT NULL,
    is_stopped INTEGER NOT NULL,
    is_paused INTEGER NOT NULL,
    feedback BLOB NOT NULL,
    feedback_count INTEGER NOT NULL,
    partial_result BLOB NOT NULL,
    result BLOB NOT NULL,
    reason TEXT NOT NULL,
    ended INTEGER NOT NULL,
    expires INTEGER NOT NULL
);
CREATE INDEX unfinished ON goal (number) WHERE ended = 0;
CREATE INDEX expiry ON goal (expires) WHERE ended > 0;
CREATE INDEX acceptance ON goal (accepted);
CREATE TABLE holder (process INTEGER NOT NULL, host TEXT NOT NULL, command TEXT NOT NULL);
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = {VERSION};
"""


class JournalError(TurtleactError):
    """A journal cannot be opened, read or written.

    Attributes:
        path: The journal's file.
        problem: What is wrong, and what to do about it.
    """

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(path, problem)
        self.path = path
        self.problem = problem

    def __str__(self) -> str:
        return f"journal '{self.path}': {self.problem}"


class JournalHeld(JournalError):
    """The journal cannot be opened because another process writes it."""


class Accept(msgspec.Struct):
    """A job that adds a goal to the journal.

    Attributes:
        record: The record of the goal. When the job is written, the record gets its ``number``.
        known: The record that the journal already had for the goal's id; None if there was none.
            ``known`` is set when the job is written.
    """

    record: GoalRecord
    known: GoalRecord | None = None


class Change(msgspec.Struct):
    """A job that changes a goal in the journal.

    Attributes:
        goal_id: The 16 bytes of the goal's id.
        change: The new values.
    """

    goal_id: bytes
    change: GoalChange


class Withdraw(msgspec.Struct):
    """A job that removes a goal from the journal.

    Attributes:
        goal_id: The 16 bytes of the goal's id.
    """

    goal_id: bytes


class Database:
    """The file of a journal, opened for writing. Only one process at a time can open it.

    Args:
        path: The path of the file, which is created if it does not exist.

    Attributes:
        path: The path of the file.
        moved_to: The path to which a damaged file was renamed; None if the file was not damaged.

    Raises:
        JournalError: if the file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.moved_to: Path | None = None
        if _is_foreign(path):
            raise JournalError(path, FOREIGN)
        self._lock = _lock(path)
        try:
            self._open()
        except BaseException:
            self._lock.close()
            raise

    def close(self) -> None:
        """Close the file, so that another process may write it."""
        with suppress(sqlite3.Error):  # a full disk must not keep the program from ending
            self._connection.execute("DELETE FROM holder")
        self._connection.close()
        self._lock.close()

    # writing

    def write(self, jobs: Sequence[Accept | Change | Withdraw], *, is_durable: bool) -> None:
        """Write all jobs in one transaction: either all of them are written, or none.

        Args:
            jobs: The jobs, in order. Several changes of the same goal are merged and written
                together.
            is_durable: Whether to wait until the disk has stored the data, which then survives a
                power loss.

        Raises:
            sqlite3.Error: if the jobs cannot be written.
        """
        execute = self._connection.execute
        execute(f"PRAGMA synchronous = {'FULL' if is_durable else 'NORMAL'}")
        execute("BEGIN IMMEDIATE")
        try:
            changes: dict[bytes, dict[str, object]] = {}
            for job in jobs:
                if isinstance(job, Accept):
                    self._insert(job)
                elif isinstance(job, Withdraw):
                    execute("DELETE FROM goal WHERE id = ?", (job.goal_id,))
                else:
                    _add(changes.setdefault(job.goal_id, {}), job.change)
            for goal_id, columns in changes.items():
                self._update(goal_id, columns)
            execute("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):  # SQLite has rolled back by itself after some errors
                execute("ROLLBACK")
            raise

    def _insert(self, job: Accept) -> None:
        record = job.record
        columns = [name for name in _COLUMNS if name != "number"]
        values = [getattr(record, name) for name in columns]
        marks = ", ".join("?" * len(columns))
        statement = f"INSERT OR IGNORE INTO goal ({', '.join(columns)}) VALUES ({marks})"  # noqa: S608  # our own names
        cursor = self._connection.execute(statement, values)
        if cursor.rowcount:
            record.number = cursor.lastrowid or 0
        else:
            job.known = next(self._select("WHERE id = ?", (record.id,)))

    def _update(self, goal_id: bytes, columns: dict[str, object]) -> None:
        added = columns.pop("feedback_count", 0)
        names = [f"{name} = ?" for name in columns] + ["feedback_count = feedback_count + ?"]
        statement = f"UPDATE goal SET {', '.join(names)} WHERE id = ?"  # noqa: S608  # our own names
        self._connection.execute(statement, (*columns.values(), added, goal_id))

    # reading

    def load(self, now: int) -> list[GoalRecord]:
        """Return the goals that have not ended, and those with results that have not expired.

        ``now`` is the time by the wall clock (ns since the epoch).
        """
        # A sign before the column keeps SQLite from going through the whole table in that order.
        return [
            *self._select("WHERE ended = 0 ORDER BY number"),
            *self._select("WHERE ended > 0 AND expires = 0 ORDER BY number"),
            *self._select("WHERE ended > 0 AND expires > ? ORDER BY +number", (now,)),
        ]

    def _select(self, where: str, values: Sequence[object] = ()) -> Iterator[GoalRecord]:
        return _select(self._connection, where, values)

    # opening

    def _open(self) -> None:
        try:
            self._connection = self._connect()
        except sqlite3.DatabaseError as error:
            if not _is_damaged(error):
                raise JournalError(self.path, explain(error)) from error
            self._set_aside()
            self._connection = self._connect()

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, timeout=BUSY, isolation_level=None)
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            _check_version(self.path, connection)
            if not _has_tables(connection):
                connection.executescript(f"BEGIN; {_SCHEMA} COMMIT;")
            connection.execute("DELETE FROM holder")
            holder = (os.getpid(), socket.gethostname(), " ".join(sys.argv)[:200])
            connection.execute("INSERT INTO holder VALUES (?, ?, ?)", holder)
            for _ in _select(connection, "WHERE ended = 0"):
                pass  # a damaged file fails here, and not in the middle of a run
        except BaseException:
            connection.close()
            raise
        return connection

    def _set_aside(self) -> None:
        """Rename a damaged file and the files that belong to it. Nothing is deleted."""
        stamp = time.strftime("%Y%m%d-%H%M%S")
        self.moved_to = self.path.with_name(f"{self.path.name}.damaged-{stamp}")
        for suffix in ("", "-wal", "-shm"):
            part = self.path.with_name(self.path.name + suffix)
            if part.exists():
                part.rename(f"{self.moved_to}{suffix}")


def find_goals(path: Path, beginning: str) -> list[GoalRecord]:
    """Read at most ten goals whose ids begin with the hexadecimal digits in ``beginning``.

    Raises:
        JournalError: if there is no such file, or it is not a journal.
    """
    first, last = (bytes.fromhex(beginning.ljust(32, digit)) for digit in "0f")
    with _reading(path) as connection:
        return list(_select(connection, "WHERE id BETWEEN ? AND ? LIMIT 10", (first, last)))


def read_goals(path: Path, since: int = 0) -> Iterator[GoalRecord]:
    """Read goals from a journal, even while a server writes to it.

    Args:
        path: The journal's file.
        since: Read only goals accepted at or after this time (ns since the epoch, wall clock).

    Raises:
        JournalError: if there is no such file, or it is not a journal.
    """
    with _reading(path) as connection:
        if since:
            # The clock may have been set back, so the goals before the first of them are looked
            # for in the index, and those after it are read in order, which saves sorting them.
            first = "SELECT min(number) FROM goal INDEXED BY acceptance WHERE accepted >= ?"
            where = f"WHERE number >= ({first}) AND +accepted >= ? ORDER BY number"
            yield from _select(connection, where, (since, since))
        else:
            yield from _select(connection, "ORDER BY number")


def prune(path: Path, before: int) -> int:
    """Delete the goals that ended before ``before`` (ns since the epoch, wall clock).

    Goals with results that have not expired are kept. You may call this while a server uses the
    journal, because the goals are deleted in small transactions, and the server can write between
    them.

    Returns:
        How many goals were deleted.

    Raises:
        JournalError: if the file does not exist, is not a journal, or cannot be written.
    """
    with _reading(path, mode="rw") as connection:
        gone = "ended > 0 AND ended < ? AND expires > 0 AND expires < ? LIMIT ?"
        some = f"SELECT number FROM goal WHERE {gone}"  # noqa: S608  # our own text
        statement = f"DELETE FROM goal WHERE number IN ({some})"  # noqa: S608  # our own text
        count = 0
        while deleted := connection.execute(statement, (before, time.time_ns(), AT_ONCE)).rowcount:
            connection.commit()
            count += deleted
            time.sleep(PAUSE)
        return count


@contextmanager
def _reading(path: Path, mode: str = "ro") -> Iterator[sqlite3.Connection]:
    if not path.is_file():
        raise JournalError(path, "there is no such file")
    # To read a file in WAL mode, SQLite makes two more beside it. On a read-only disk it cannot,
    # and need not: nobody writes there, and a file without a log is complete.
    is_still = not os.access(path.parent, os.W_OK) and not Path(f"{path}-wal").exists()
    still = "&immutable=1" if mode == "ro" and is_still else ""
    connection = None
    try:
        connection = sqlite3.connect(
            f"{path.absolute().as_uri()}?mode={mode}{still}", uri=True, timeout=BUSY
        )
        _check_version(path, connection)
        if not _has_tables(connection):
            raise JournalError(path, "it is not a journal of turtleact")
        yield connection
    except sqlite3.Error as error:
        raise JournalError(path, explain(error)) from error
    finally:
        if connection is not None:
            connection.close()


def _select(
    connection: sqlite3.Connection, where: str, values: Sequence[object] = ()
) -> Iterator[GoalRecord]:
    statement = f"SELECT {', '.join(_COLUMNS)} FROM goal {where}"  # noqa: S608  # our own text
    for row in connection.execute(statement, values):
        # Not strict, because SQLite has no booleans.
        yield msgspec.convert(
            dict(zip(_COLUMNS, row, strict=True)),
            GoalRecord,
            strict=False,
            builtin_types=(bytes,),
        )


def _add(columns: dict[str, object], change: GoalChange) -> None:
    """Merge a change into the earlier changes of the same goal, so that they are written as one."""
    columns |= change.columns()
    if change.feedback is not None:
        columns["feedback_count"] = int(str(columns.get("feedback_count", 0))) + 1


def _lock(path: Path) -> sqlite3.Connection:
    """Take the lock that lets only one process write the journal.

    The lock is a transaction in a second, empty SQLite file, because this works in the same way on
    all systems. The system releases the lock when the process ends.
    """
    if not path.parent.is_dir():
        raise JournalError(path, f"there is no folder '{path.parent}'")
    try:
        connection = sqlite3.connect(
            f"{path}-lock", timeout=0.0, isolation_level=None, check_same_thread=False
        )
    except sqlite3.Error as error:  # for example a file system that takes no new files
        raise JournalError(path, explain(error)) from error
    try:
        connection.execute("BEGIN EXCLUSIVE")
    except sqlite3.Error as error:
        connection.close()
        if "locked" in str(error):
            problem = f"{_holder(path)} writes it, and only one process can do so at a time"
            raise JournalHeld(path, problem) from None
        raise JournalError(path, explain(error)) from error
    return connection


def _is_foreign(path: Path) -> bool:
    """Whether a file certainly belongs to another program.

    Such a file is not empty, and is neither a SQLite file nor a damaged journal. A journal is known
    by its mark, by its log, or by the lock file that the process which wrote it has left beside it.
    """
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            head = file.read(MARK.stop)
    except OSError:  # SQLite reports it
        return False
    is_marked = head[MARK] == APPLICATION.to_bytes(4, "big")
    has_files = Path(f"{path}-wal").exists() or Path(f"{path}-lock").exists()
    return bool(head) and not (head.startswith(MAGIC) or is_marked or has_files)


def _holder(path: Path) -> str:
    """Describe the process that writes a journal."""
    with suppress(JournalError), _reading(path) as connection:
        for process, host, command in connection.execute("SELECT * FROM holder"):
            where = "" if host == socket.gethostname() else f" on {host}"
            return f"process {process}{where} ({command})"
    return "another process"


def _check_version(path: Path, connection: sqlite3.Connection) -> None:
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if application not in (0, APPLICATION) or (not application and _has_any(connection)):
        raise JournalError(path, FOREIGN)
    if version > VERSION:
        problem = (
            f"its layout is {version}, from a newer turtleact; this one knows {VERSION}: update"
        )
        raise JournalError(path, problem)


def _has_any(connection: sqlite3.Connection) -> bool:
    return connection.execute("SELECT 1 FROM sqlite_master").fetchone() is not None


def _has_tables(connection: sqlite3.Connection) -> bool:
    names = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
    return {"goal", "holder"} <= {name for (name,) in names}


def _is_damaged(error: sqlite3.DatabaseError) -> bool:
    return getattr(error, "sqlite_errorname", "").startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB"))


def explain(error: sqlite3.Error) -> str:
    """Explain what an error of SQLite means, and what to do about it."""
    name = getattr(error, "sqlite_errorname", "")
    if name.startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB")):
        return f"it is damaged, or no journal: {error}"
    if name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
        return "another process keeps it locked; try again"
    if name == "SQLITE_FULL":
        return "the disk is full"
    if name.startswith(("SQLITE_READONLY", "SQLITE_CANTOPEN")):
        return "it cannot be written: check the permissions of the file and its folder"
    return str(error)
