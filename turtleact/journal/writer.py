"""The journal that servers use: the event loop makes changes, and a thread writes them to the file.

All changes go to one thread, in order. The thread writes all waiting changes in one transaction.
While the thread waits for the disk, further changes accumulate. A hundred goals at the same time
therefore need only a few waits for the disk, not a hundred.

If the disk is full, new goals are rejected for that reason. Running goals go on: their changes stay
in memory, and the thread tries again until it can write them.
"""

from __future__ import annotations

import logging
import sqlite3
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path

import anyio
import anyio.to_thread
import msgspec

from turtleact.errors import InvalidOption
from turtleact.goals.records import GoalChange, GoalRecord
from turtleact.journal.database import (
    Accept,
    Change,
    Database,
    JournalError,
    Withdraw,
    explain,
)
from turtleact.tasks import LoopGuard, Tasks, current_tasks, opening, thread_work

__all__ = ["Journal", "open_journal"]

logger = logging.getLogger("turtleact.journal")

RETRY = 1.0
"""After a failed write, the thread tries again after this time (s)."""

CLOSING = 5.0
"""How long a journal that is being closed keeps trying to write the rest (s)."""


class _Job(msgspec.Struct, eq=False):
    """Work for the thread that writes the file.

    Attributes:
        work: What to write; None if the caller only wants to know when all earlier jobs are
            written.
        done: Called in the event loop when the job is written. If the job is not durable,
            ``done`` is called after the first attempt, even if that attempt fails.
        failed: Called in the event loop with the error if the job cannot be written; the thread
            then drops the job. If ``failed`` is None, the thread tries again.
        is_durable: Whether the job must survive a power loss once it is written.
        is_told: Whether ``done`` has been called after a failed attempt to write the job.
        is_awaited: Whether virtual time must not advance until the thread has tried to write the
            job.
    """

    work: Accept | Change | Withdraw | None
    done: Callable[[], object] | None = None
    failed: Callable[[sqlite3.Error], object] | None = None
    is_durable: bool = False
    is_told: bool = False
    is_awaited: bool = False


class Journal:
    """Keeps the goals of servers in a file. Use `open_journal` to open a journal.

    Only one process at a time can write a journal. Any process can read it with `read_goals`.

    Attributes:
        path: The journal's file.
        max_starts: A goal is not started again after this many server crashes without new feedback.
            None means that there is no limit.
        aborts_at_close: Whether closing a server ends the server's goals.
    """

    def __init__(
        self, path: Path, max_starts: int | None, tasks: Tasks, *, aborts_at_close: bool = False
    ) -> None:
        self.path = path
        self.max_starts = max_starts
        self.aborts_at_close = aborts_at_close
        self._tasks = tasks
        self._thread_work = thread_work()
        self._home = LoopGuard(f"journal '{path}'")
        self._held: dict[bytes, GoalRecord] = {}
        self._expiring: deque[GoalRecord] = deque()
        self._jobs: deque[_Job] = deque()
        self._changed = threading.Condition()
        self._is_closing = False
        self._deadline = 0.0
        self._is_failing = False
        self._failure = ""
        self._opened = anyio.Event()
        self._ended = anyio.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name=f"journal {path}", daemon=True)

    # what servers ask for; see `turtleact.goals.records.GoalJournal`

    def load(self, action: str) -> list[GoalRecord]:
        """Return the goals of an action that have not ended or whose results have not expired."""
        self._home.check()
        now = time.time_ns()
        held = [each for each in self._held.values() if each.action == action]
        return [each for each in held if not each.ended or not 0 < each.expires <= now]

    async def accept(self, record: GoalRecord) -> GoalRecord | None:
        """Write a new goal to disk, unless the journal already has a goal with that id.

        Return the record that the journal already has, or None if the new goal was written.

        Raises:
            JournalError: if the goal cannot be written, or the journal is closed.
        """
        accept = Accept(record)
        await self._write(accept)
        if accept.known is not None:
            return self._held.get(record.id, accept.known)
        return None

    async def withdraw(self, goal_id: bytes) -> None:
        """Remove a goal from the journal because it was not accepted after all."""
        try:
            await self._write(Withdraw(goal_id))
        except JournalError as error:
            logger.error("%s; the rejected goal %s stays in it", error, goal_id.hex())
        self._held.pop(goal_id, None)

    def progress(
        self, goal_id: bytes, change: GoalChange, then: Callable[[], object] | None = None
    ) -> None:
        """Write a change of a goal, and call ``then`` when the change is in the file.

        The change then survives if the process is killed, but a power failure may lose the change.
        If the first attempt to write fails, ``then`` is called nevertheless, and the thread tries
        again.
        """
        self._apply(goal_id, change)
        self._put(_Job(Change(goal_id, change), then))

    def end(self, goal_id: bytes, change: GoalChange, then: Callable[[], object]) -> None:
        """Write the end of a goal to disk, and call ``then`` when it is written.

        There is no time limit: the thread tries again until it succeeds or the journal is closed.
        """
        self._apply(goal_id, change)
        record = self._held.get(goal_id)
        if record is not None:
            self._expiring.append(record)
            self._forget_expired()
        self._put(_Job(Change(goal_id, change), then, is_durable=True))

    async def written(self) -> None:
        """Wait until the thread has tried to write every change made so far."""
        reached = anyio.Event()
        self._put(_Job(None, reached.set))
        await reached.wait()

    def problem(self) -> str:
        """Return why the journal cannot be written now, or an empty string if it can.

        Any thread may call this.
        """
        return self._failure

    # the event loop's side

    async def open(self) -> None:
        """Start the thread, and wait until it has opened the file.

        Raises:
            JournalError: if the file cannot be opened.
        """
        self._thread.start()
        with anyio.CancelScope(shield=True), self._thread_work.counted():
            await self._opened.wait()
        if self._error is not None:
            raise self._error

    async def aclose(self) -> None:
        """Write the remaining jobs, and close the file."""
        with self._changed:
            self._is_closing = True
            self._deadline = time.monotonic() + CLOSING
            self._changed.notify()
        with anyio.CancelScope(shield=True), self._thread_work.counted():
            await self._ended.wait()

    async def _write(self, work: Accept | Withdraw) -> None:
        """Write a job to disk, and wait until it is written.

        Raises:
            JournalError: if the job cannot be written, or the journal is closed.
        """
        over = anyio.Event()
        errors = list[sqlite3.Error]()

        def fail(error: sqlite3.Error) -> None:
            errors.append(error)
            over.set()

        done = over.set
        if isinstance(work, Accept):
            done = partial(self._accepted, work, over)
        if not self._put(_Job(work, done, fail, is_durable=True)):
            raise JournalError(self.path, "it is closed")
        await over.wait()
        if errors:
            raise JournalError(self.path, explain(errors[0]))

    def _accepted(self, accept: Accept, over: anyio.Event) -> None:
        if accept.known is None:
            self._held[accept.record.id] = accept.record
        over.set()

    def _apply(self, goal_id: bytes, change: GoalChange) -> None:
        """Make a change in the goal's record in memory."""
        record = self._held.get(goal_id)
        if record is None:
            return
        for name, value in change.columns().items():
            setattr(record, name, value)
        if change.feedback is not None:
            record.feedback_count += 1

    def _forget_expired(self) -> None:
        """Remove the goals with expired results from memory. The file keeps these goals."""
        now = time.time_ns()
        while self._expiring and 0 < self._expiring[0].expires <= now:
            record = self._expiring.popleft()
            if self._held.get(record.id) is record:
                del self._held[record.id]

    def _put(self, job: _Job) -> bool:
        """Give the thread a job. Return False if the journal is closed."""
        with self._changed:
            if self._is_closing:
                is_open = False
            else:
                if job.done is not None:
                    job.is_awaited = True
                    self._thread_work.begin()
                self._jobs.append(job)
                self._changed.notify()
                is_open = True
        if not is_open and job.done is not None and job.failed is None:
            if job.is_durable:
                problem = "%s is closed: a goal ends without a record; close its server first"
                logger.error(problem, self.path)
            job.done()
        return is_open

    def _hold(self, records: list[GoalRecord]) -> None:
        self._held = {record.id: record for record in records}
        ended = (record for record in records if record.ended)
        self._expiring = deque(sorted(ended, key=_by_expiry))

    # the thread's side

    def _work(self) -> None:
        try:
            database = Database(self.path)
            try:
                self._hold(database.load(time.time_ns()))
            except BaseException:
                database.close()
                raise
        except BaseException as error:
            self._error = error
            self._tasks.from_anywhere(self._opened.set)
            return
        if database.moved_to is not None:
            problem = "%s is damaged; it is now %s, and a new journal was begun"
            logger.error(problem, self.path, database.moved_to)
        self._tasks.from_anywhere(self._opened.set)
        try:
            while jobs := self._next():
                self._serve(database, jobs)
        finally:
            database.close()
            self._tasks.from_anywhere(self._ended.set)

    def _next(self) -> list[_Job]:
        """Wait until there are jobs, and return all of them.

        The list is empty when the journal is closed and all jobs are written or lost.
        """
        with self._changed:
            if self._is_failing and not self._is_closing:
                self._changed.wait(RETRY)
            while not self._jobs and not self._is_closing:
                self._changed.wait()
            jobs = list(self._jobs)
            self._jobs.clear()
        if jobs and self._is_closing and self._is_failing:
            if time.monotonic() > self._deadline:
                logger.error("%s: %d changes of goals are lost", self.path, len(jobs))
                return []
            time.sleep(RETRY / 10)
        return jobs

    def _serve(self, database: Database, jobs: list[_Job]) -> None:
        """Write jobs in one transaction, and report the outcome to the event loop."""
        work = [job.work for job in jobs if job.work is not None]
        try:
            if work:
                database.write(work, is_durable=any(job.is_durable for job in jobs))
        except sqlite3.Error as error:
            self._fail(jobs, error)
            return
        if self._is_failing:
            self._is_failing = False
            self._failure = ""
            logger.warning("%s can be written again", self.path)
        self._report(jobs, [job.done for job in jobs if job.done is not None and not job.is_told])

    def _fail(self, jobs: list[_Job], error: sqlite3.Error) -> None:
        """Call the ``failed`` callback of each job that has this callback, and keep the other jobs.

        The thread tries to write the other jobs again.
        """
        if not self._is_failing:
            self._is_failing = True
            self._failure = explain(error)
            problem = "%s cannot be written: %s; goals go on, and writing is tried again"
            logger.error(problem, self.path, self._failure)
        calls = list[Callable[[], object]]()
        kept = list[_Job]()
        for job in jobs:
            if job.failed is not None:
                calls.append(partial(job.failed, error))
                continue
            if not (job.is_durable or job.is_told) and job.done is not None:
                calls.append(job.done)
                job.is_told = True
            if job.work is not None:
                kept.append(job)
        with self._changed:
            self._jobs.extendleft(reversed(kept))
        self._report(jobs, calls)

    def _report(self, jobs: list[_Job], calls: list[Callable[[], object]]) -> None:
        """Call the functions ``calls`` in the event loop.

        If a virtual clock is stopped for ``jobs``, the clock starts again afterwards.
        """
        count = 0
        for job in jobs:
            count += job.is_awaited
            job.is_awaited = False
        if calls or count:
            self._tasks.from_anywhere(partial(self._call_all, calls, count))

    def _call_all(self, calls: list[Callable[[], object]], count: int) -> None:
        try:
            for call in calls:
                call()
        finally:
            if count:
                self._thread_work.end(count)


def _by_expiry(record: GoalRecord) -> tuple[bool, int]:
    return not record.expires, record.expires


@opening
async def open_journal(
    path: str | Path, *, max_starts: int | None = 3, abort_at_close: bool = False
) -> AsyncIterator[Journal]:
    """Open a journal for the length of a block. Servers of several nodes may share one journal.

    Close the servers before the journal. If one ``async with`` opens both the journal and the node,
    list the journal first.

    Args:
        path: The file, which is created if it does not exist. Up to three more files are beside it,
            with the same name followed by ``-wal``, ``-shm`` or ``-lock``.
        max_starts: A goal is aborted, and not started again, after this many server crashes without
            new feedback. None means that there is no limit.
        abort_at_close: Whether closing a server ends the server's goals. If false, the goals go on
            when the server starts again with ``on_restart="resume"``.

    Raises:
        InvalidOption: if ``max_starts`` is neither None nor a whole number of at least 1.
        JournalError: if the file cannot be opened, for example because another process writes it.
    """
    is_count = isinstance(max_starts, int) and not isinstance(max_starts, bool) and max_starts > 0
    if max_starts is not None and not is_count:
        problem = f"expected a whole number from 1, or None for no limit, not {max_starts!r}"
        raise InvalidOption("max_starts", problem)
    journal = Journal(Path(path), max_starts, current_tasks(), aborts_at_close=abort_at_close)
    await journal.open()
    try:
        yield journal
    finally:
        await journal.aclose()
