"""The journal itself: its file, its thread, and what it does when the disk fails."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import anyio
import pytest

import turtleact
from turtleact import testing
from turtleact.errors import InvalidOption
from turtleact.goals.records import GoalChange, GoalRecord
from turtleact.goals.state import GoalStatus
from turtleact.journal import Journal, JournalError, find_goals, open_journal, prune, read_goals
from turtleact.journal.database import Accept, Change, Database, Withdraw
from turtleact.transports import MemoryTransport

from ..lab import Count, Gate, feedback, goal, result, running, settle

pytestmark = pytest.mark.loops("asyncio")

ID = bytes(range(16))
NOW = 1_700_000_000_000_000_000
"""A time (ns since the epoch)."""


@pytest.fixture
def path(tmp_path) -> Path:
    return Path(tmp_path, "goals.db")


def record(number: int = 0, accepted: int = NOW) -> GoalRecord:
    return GoalRecord(
        id=number.to_bytes(16),
        action="/count",
        type_name="lab_interfaces/action/Count",
        type_hash="RIHS01_0",
        request=b"request",
        stamp=accepted,
        accepted=accepted,
    )


def ended(at: int, expires: int) -> GoalChange:
    return GoalChange(status=GoalStatus.SUCCEEDED, result=b"result", ended=at, expires=expires)


# --- the file -----------------------------------------------------------------------------------


def test_what_was_written_is_read_in_order(path):
    database = Database(path)
    changes: list[Accept | Change | Withdraw] = [
        Accept(record(1)),
        Accept(record(2)),
        Change(record(1).id, GoalChange(status=GoalStatus.EXECUTING, feedback=b"1", crashes=0)),
        Change(record(1).id, GoalChange(feedback=b"2", partial_result=b"3")),
        Change(record(2).id, ended(NOW, NOW + 1)),
    ]
    database.write(changes, is_durable=True)
    first, second = read_goals(path)  # while the database is open
    database.close()
    assert (first.id, first.status) == (record(1).id, GoalStatus.EXECUTING)
    assert (first.feedback, first.feedback_count, first.partial_result) == (b"2", 2, b"3")
    assert (second.status, second.result, second.ended) == (GoalStatus.SUCCEEDED, b"result", NOW)


def test_a_write_that_fails_writes_nothing(path):
    database = Database(path)
    broken = Change(record(1).id, GoalChange(reason=object()))  # type: ignore[arg-type]
    with pytest.raises(sqlite3.Error):
        database.write([Accept(record(1)), broken], is_durable=True)
    database.close()
    assert list(read_goals(path)) == []


def test_only_what_matters_is_loaded(path):
    database = Database(path)
    goals = [record(number) for number in range(4)]
    lives = [None, ended(NOW, NOW + 10), ended(NOW, 0), ended(NOW, NOW + 1)]
    database.write([Accept(each) for each in goals], is_durable=False)
    changes = [
        Change(each.id, life) for each, life in zip(goals, lives, strict=True) if life is not None
    ]
    database.write(changes, is_durable=False)
    loaded = {each.id for each in database.load(NOW + 5)}
    database.close()
    assert loaded == {goals[0].id, goals[1].id, goals[2].id}


def test_goals_are_read_by_time_and_id(path):
    database = Database(path)
    database.write([Accept(record(number, NOW + number)) for number in range(3)], is_durable=False)
    database.close()
    assert [each.accepted - NOW for each in read_goals(path, since=NOW + 1)] == [1, 2]
    assert list(read_goals(path, since=NOW + 3)) == []
    assert [each.accepted - NOW for each in find_goals(path, record(2).id.hex())] == [2]


def test_goals_are_read_in_order_though_the_clock_was_set_back(path):
    database = Database(path)
    times = [0, 7, 3, 8]
    goals = [Accept(record(number, NOW + time)) for number, time in enumerate(times)]
    database.write(goals, is_durable=False)
    database.close()
    assert [each.accepted - NOW for each in read_goals(path, since=NOW + 5)] == [7, 8]


def test_a_journal_on_a_read_only_disk_is_read(path, monkeypatch):
    Database(path).close()
    monkeypatch.setattr(os, "access", lambda *_: False)
    opened = list[str]()
    connect = sqlite3.connect

    def note(where: str, **options: Any) -> sqlite3.Connection:
        opened.append(where)
        connection: sqlite3.Connection = connect(where, **options)
        return connection

    monkeypatch.setattr(sqlite3, "connect", note)
    assert list(read_goals(path)) == []
    assert opened == [f"{path.as_uri()}?mode=ro&immutable=1"]


def test_pruning_deletes_what_has_ended_and_expired(path):
    database = Database(path)
    database.write([Accept(record(number)) for number in range(4)], is_durable=False)
    database.write([Change(record(1).id, ended(NOW, NOW + 1))], is_durable=False)
    database.write([Change(record(2).id, ended(NOW, 0))], is_durable=False)  # kept for ever
    database.write([Change(record(3).id, ended(NOW + 9, NOW + 10))], is_durable=False)
    assert prune(path, NOW + 5) == 1  # while the database is open
    database.close()
    assert [each.id for each in read_goals(path)] == [record(0).id, record(2).id, record(3).id]


# --- files that cannot be used ------------------------------------------------------------------


async def test_a_second_writer_is_told_who_writes(path):
    async with open_journal(path):
        with pytest.raises(JournalError, match=f"process {os.getpid()} .* writes it, and only one"):
            async with open_journal(path):
                pass


async def test_the_journal_of_a_killed_process_can_be_opened(path):
    program = (
        "import anyio, os, turtleact\n"
        "async def main():\n"
        f"    async with turtleact.open_journal({str(path)!r}):\n"
        "        os._exit(9)\n"
        "anyio.run(main)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 9
    async with open_journal(path) as journal:
        assert journal.load("/count") == []


def test_a_newer_journal_is_left_alone(path):
    Database(path).close()
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA user_version = 7")
    connection.close()
    with pytest.raises(JournalError, match=r"its layout is 7, from a newer turtleact; .* update"):
        Database(path)
    with pytest.raises(JournalError, match="layout is 7"):
        list(read_goals(path))


def test_the_file_of_another_program_is_left_alone(path):
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE mine (x)")
    connection.close()
    with pytest.raises(JournalError, match="the file of another program"):
        Database(path)


@pytest.mark.parametrize("content", [b"import turtleact\n", b"\0", b"SQLite" * 500])
@pytest.mark.parametrize("count", [1, 500])
def test_a_file_that_is_no_database_is_left_alone(path, content, count):
    path.write_bytes(content * count)
    with pytest.raises(JournalError, match="the file of another program; choose another name"):
        Database(path)
    assert path.read_bytes() == content * count
    assert list(path.parent.iterdir()) == [path]


def test_an_empty_file_becomes_a_journal(path):
    path.touch()
    Database(path).close()
    assert list(read_goals(path)) == []


def spoil_the_contents(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100] + b"spoilt" * 5000)


def spoil_the_beginning(path: Path) -> None:
    path.write_bytes(b"spoilt" + path.read_bytes()[6:])


def empty_the_first_page(path: Path) -> None:
    path.write_bytes(bytes(4096) + path.read_bytes()[4096:])


def spoil_what_has_a_log(path: Path) -> None:
    path.write_bytes(b"spoilt" * 500)
    Path(f"{path}-wal").touch()


@pytest.mark.parametrize(
    "spoil",
    [spoil_the_contents, spoil_the_beginning, empty_the_first_page, spoil_what_has_a_log],
)
async def test_a_damaged_file_is_renamed_and_kept(path, caplog, spoil):
    Database(path).close()
    spoil(path)
    damaged = path.read_bytes()
    async with open_journal(path) as journal:
        assert await journal.accept(record(1)) is None
    kept, *_ = sorted(path.parent.glob("goals.db.damaged-*"))  # then its log, if it had one
    assert kept.read_bytes() == damaged
    assert f"is damaged; it is now {kept}" in caplog.text


def test_a_missing_folder_and_a_lock_that_cannot_be_made_are_told(tmp_path):
    with pytest.raises(JournalError, match="there is no folder"):
        Database(tmp_path / "none" / "goals.db")
    (tmp_path / "goals.db-lock").mkdir()
    with pytest.raises(JournalError, match="it cannot be written"):
        Database(tmp_path / "goals.db")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_named(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(JournalError, match="check the permissions"):
        Database(tmp_path / "goals.db")


@pytest.mark.parametrize("content", [None, b"text" * 100, b""])
def test_reading_what_is_no_journal_is_an_error(path, content):
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(JournalError, match="it is not a journal" if content == b"" else None):
        list(read_goals(path))


@pytest.mark.parametrize("count", [0, -1, True, 2.5, "3"])
async def test_max_starts_is_a_count(path, count):
    with pytest.raises(InvalidOption, match="'max_starts': expected a whole number from 1"):
        async with open_journal(path, max_starts=count):
            pass


# --- a disk that fails --------------------------------------------------------------------------


class Disk:
    """Lets writes fail as on a full disk."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.is_full = False
        write = Database.write

        def refuse(database: Database, jobs: object, *, is_durable: bool) -> None:
            if self.is_full:
                error = sqlite3.OperationalError("database or disk is full")
                error.sqlite_errorname = "SQLITE_FULL"
                raise error
            write(database, jobs, is_durable=is_durable)  # type: ignore[arg-type]

        monkeypatch.setattr(Database, "write", refuse)
        monkeypatch.setattr("turtleact.journal.writer.RETRY", 0.01)


async def test_a_full_disk_refuses_new_goals_and_lets_running_ones_end(path, monkeypatch, caplog):
    disk, gate = Disk(monkeypatch), Gate()
    async with open_journal(path) as journal, turtleact.open_node("lab") as node:
        node.action_server(Count, "count", gate.stream, journal=journal)
        client = node.action_client(Count, "count")
        async with client.send_goal(goal(), goal_id=ID) as handle:
            await anext(handle)
            disk.is_full = True
            with pytest.raises(turtleact.GoalRejected, match="the disk is full"):
                await client.send_goal(goal())
            gate.opened.set()
            await settle()
            assert not handle.done  # its end waits for the disk
            disk.is_full = False
            assert await handle.result() == result(3)
        (kept,) = read_goals(path)
    assert (kept.id, kept.status) == (ID, GoalStatus.SUCCEEDED)
    assert "goals go on, and writing is tried again" in caplog.text
    assert "can be written again" in caplog.text


async def test_feedback_goes_on_though_the_disk_is_full(path, monkeypatch):
    disk = Disk(monkeypatch)
    async with open_journal(path) as journal:
        await journal.accept(record(1))
        disk.is_full = True
        told = anyio.Event()
        journal.progress(record(1).id, GoalChange(feedback=b"1"), told.set)
        await told.wait()
        disk.is_full = False
        journal.progress(record(1).id, GoalChange(partial_result=b"2"))
        await journal.written()
        (kept,) = read_goals(path)
    assert (kept.feedback, kept.partial_result) == (b"1", b"2")


async def test_a_closing_journal_does_not_wait_for_a_full_disk_for_ever(path, monkeypatch, caplog):
    monkeypatch.setattr("turtleact.journal.writer.CLOSING", 0.0)
    disk = Disk(monkeypatch)
    async with open_journal(path) as journal:
        await journal.accept(record(1))
        disk.is_full = True
        journal.end(record(1).id, ended(NOW, NOW), lambda: None)
    assert "1 changes of goals are lost" in caplog.text


# --- virtual time -------------------------------------------------------------------------------


@pytest.fixture
def slow(monkeypatch) -> None:
    """Lets every write take a while."""
    write = Database.write

    def write_slowly(database: Database, jobs: object, *, is_durable: bool) -> None:
        time.sleep(0.02)
        write(database, jobs, is_durable=is_durable)  # type: ignore[arg-type]

    monkeypatch.setattr(Database, "write", write_slowly)


async def goal_with_a_journal(path: Path, transport: Any) -> float:
    """Send a goal of 1 s to a server with a journal, beside a sleeper; return how long it took."""
    async with (
        open_journal(path) as journal,
        turtleact.open_node("lab", transport=transport) as lab,
    ):

        async def execute(request: Count.Goal) -> AsyncIterator[Any]:
            await lab.clock.sleep(1.0)
            yield feedback(1)
            yield result()

        lab.action_server(Count, "count", execute, journal=journal)
        client = lab.action_client(Count, "count")
        async with running(lambda: lab.clock.sleep(1000.0)) as sleeper:
            began = lab.clock.time()
            async with client.send_goal(goal()) as handle:
                assert [each async for each in handle] == [feedback(1)]
                await handle.result()
            took = lab.clock.time() - began
            sleeper.scope.cancel()
    return took


@pytest.mark.parametrize("backend", ["asyncio", "trio"])
def test_the_time_of_a_virtual_loop_stands_still_while_a_write_is_awaited(path, slow, backend):
    took = testing.run(lambda: goal_with_a_journal(path, MemoryTransport()), backend=backend)
    assert took == 1.0


def test_virtual_time_goes_on_though_the_disk_is_full(path, monkeypatch):
    disk = Disk(monkeypatch)
    monkeypatch.setattr("turtleact.journal.writer.CLOSING", 0.0)

    async def main() -> float:
        async with open_journal(path) as journal:
            await journal.accept(record(1))
            disk.is_full = True
            journal.end(record(1).id, ended(NOW, NOW), lambda: None)
            await anyio.sleep(1000.0)
            return anyio.current_time()

    assert testing.run(main) == 1000.0


# --- closed and shared --------------------------------------------------------------------------


async def test_a_closed_journal_takes_no_goals(path, caplog):
    async with open_journal(path) as journal:
        pass
    with pytest.raises(JournalError, match="it is closed"):
        await journal.accept(record(1))
    told: list[str] = []
    note: Callable[[], object] = lambda: told.append("over")  # noqa: E731
    journal.end(record(1).id, ended(NOW, NOW), note)
    journal.progress(record(1).id, GoalChange(feedback=b"1"), note)
    assert told == ["over", "over"]
    assert "a goal ends without a record" in caplog.text


async def test_results_that_have_expired_are_forgotten_in_memory(path):
    async with open_journal(path) as journal:
        for number in range(3):
            await journal.accept(record(number))
            journal.end(record(number).id, ended(NOW, NOW + 1), lambda: None)
        assert journal.load("/count") == []


async def test_many_goals_at_once_share_commits(path, monkeypatch):
    writes = list[int]()
    write = Database.write

    def note(database: Database, jobs: list[object], *, is_durable: bool) -> None:
        writes.append(len(jobs))
        write(database, jobs, is_durable=is_durable)  # type: ignore[arg-type]

    monkeypatch.setattr(Database, "write", note)
    async with open_journal(path) as journal, anyio.create_task_group() as senders:
        for number in range(50):
            senders.start_soon(journal.accept, record(number))
    assert sum(writes) == 50
    assert len(writes) < 25


@pytest.mark.loops("asyncio", "trio")
async def test_a_journal_belongs_to_its_event_loop(path):
    async with open_journal(path) as journal:
        with pytest.raises(turtleact.TurtleactError, match="belongs to another event loop"):
            await anyio.to_thread.run_sync(Journal.load, journal, "/count")
