"""Between the event loop and other threads: an inbox, an outbox, and lanes that bound both.

Many messages cost one wake-up of the loop, and none of them ever makes it wait. A `Lane` holds what
one publisher has yet to send, or one subscription to deliver; it is bounded in bytes, so that
nobody's silence fills the memory. Knows no message and no Zenoh.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeAlias, TypeVar

import anyio.to_thread

from turtleact.tasks import GRACE, Tasks

__all__ = ["Inbox", "Lane", "Outbox"]

logger = logging.getLogger("turtleact.transport")

T = TypeVar("T")
Job: TypeAlias = Callable[[], object]

#: How much a lane holds, before the oldest is dropped (bytes).
CAPACITY = 32 * 1024 * 1024

#: How much an entry weighs besides its bytes.
ENTRY = 256

#: So many jobs are done before the event loop has its turn.
IN_A_ROW = 100


class Lane(Generic[T]):
    """What waits in order, put in by one thread and taken out by another.

    Args:
        longest: How many entries it holds; any number if left out.

    Attributes:
        dropped: How many entries were dropped, as it was full.
    """

    def __init__(self, longest: int | None = None) -> None:
        self.dropped = 0
        self._longest = longest
        self._entries: deque[tuple[T, int]] = deque()
        self._put = 0  # each of the three is written by one thread only
        self._taken = 0
        self._lost = 0

    @property
    def weight(self) -> int:
        """How much waits (bytes)."""
        return self._put - self._taken - self._lost

    def put(self, entry: T, size: int) -> bool:
        """Put one in; answers whether there is one more to take than before."""
        weight = size + ENTRY
        put = self._put = self._put + weight
        entries = self._entries
        is_full = put - self._taken - self._lost > CAPACITY or len(entries) == self._longest
        entries.append((entry, weight))
        return not (is_full and self._drop())

    def take(self) -> T | None:
        """Take the oldest out; None if there is none."""
        try:
            entry, weight = self._entries.popleft()
        except IndexError:
            return None
        self._taken += weight
        return entry

    def _drop(self) -> bool:
        try:
            _, weight = self._entries.popleft()
        except IndexError:  # the other thread has taken it meanwhile
            return False
        self._lost += weight
        self.dropped += 1
        return True


class Inbox:
    """What other threads have for the event loop to do, done in order.

    Args:
        tasks: The event loop.
    """

    def __init__(self, tasks: Tasks) -> None:
        self._tasks = tasks
        self._jobs: deque[Job] = deque()
        self._is_armed = False
        self._is_open = True

    def push(self, job: Job) -> None:
        """Have something done; from any thread."""
        self._jobs.append(job)
        if not self._is_armed:
            self._is_armed = True
            self._tasks.from_anywhere(self._work)

    def close(self) -> None:
        """Do nothing more."""
        self._is_open = False
        self._jobs.clear()

    def _work(self) -> None:
        self._is_armed = False
        jobs = self._jobs
        for _ in range(min(len(jobs), IN_A_ROW)):
            if not self._is_open:
                return
            try:
                jobs.popleft()()
            except Exception:
                logger.exception("the Zenoh transport failed on what has come")
        if self._jobs and not self._is_armed:
            self._is_armed = True
            self._tasks.from_anywhere(self._work)


class Outbox:
    """A thread that does what may block, in order; how a job fails is logged.

    Args:
        name: What the thread is called.

    Attributes:
        post: Has something done; never blocks.
    """

    def __init__(self, name: str) -> None:
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self.post: Callable[[Job], None] = self._jobs.put  # without a call between
        self._is_left = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    async def aclose(self) -> None:
        """Do what is left, and end; what hangs for `GRACE` seconds is left behind."""
        self._jobs.put(None)
        await anyio.to_thread.run_sync(self._thread.join, GRACE)
        if self._thread.is_alive():
            self._is_left = True
            logger.error("a peer takes nothing: the Zenoh transport leaves unsent what is left")

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None and not self._is_left:
            try:
                job()
            except Exception:
                if not self._is_left:  # else the session was closed under it
                    logger.exception("the Zenoh transport failed on what it was to send")
