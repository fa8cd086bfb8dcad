"""Detects when an event loop is idle, that is, when every task waits.

Virtual time jumps only while the loop is idle. How this module detects this depends on the loop:

- asyncio keeps the callbacks that are ready in a private queue, which this module reads.
- On asyncio loops that do not show their queue of callbacks (uvloop), this module calls
  `anyio.wait_all_tasks_blocked`, which polls every 0.1 s. Because that is slow, a warning is logged
  once per run.
- On trio, this module calls trio's own function ``wait_all_tasks_blocked``.

Source: asyncio ``BaseEventLoop._run_once``; trio ``wait_all_tasks_blocked``.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterator, Sized
from contextlib import contextmanager, suppress
from typing import cast

import anyio
import anyio.to_thread
from anyio.lowlevel import RunVar

__all__ = ["ThreadWork", "idleness", "thread_work", "wait_until_idle"]

logger = logging.getLogger("turtleact")

CALLBACK_TURNS = 3
"""How many turns of the loop to wait for pending callbacks if the loop's queue cannot be read.

A finished task wakes its parent with a callback that belongs to no task. Until this callback runs,
the loop looks idle although the parent is about to run."""


async def wait_until_idle() -> None:
    """Wait until all other tasks of the event loop are waiting.

    Tasks that wait for the network, for a thread or for wall time also count as waiting. Several
    tasks may call this function at the same time; all of them continue together. Cancelling: safe.
    """
    await idleness()()


def idleness() -> Callable[[], Awaitable[None]]:
    """Return a function that waits like `wait_until_idle`, but only on the running event loop.

    If you wait often, call this once and keep the function, because that is faster.
    """
    if anyio.get_cancelled_exc_class() is not asyncio.CancelledError:
        return anyio.wait_all_tasks_blocked  # trio's own
    turns = _turns.get(None)
    if turns is None:
        turns = _Turns(asyncio.get_running_loop())
        _turns.set(turns)
    return turns.wait_until_idle


class ThreadWork:
    """Counts the pieces of work that threads are doing for the event loop.

    While there is any work, virtual time stands still. Each piece of work must therefore be sure to
    end soon.

    A `turtleact.tasks.clock.VirtualClock` asks this object whether work is under way. On the event
    loops of `turtleact.testing`, time stands still while a token of anyio's thread limiter is
    borrowed. This object therefore borrows one token while work is under way.
    """

    def __init__(self) -> None:
        self._count = 0
        self._limiter = anyio.to_thread.current_default_thread_limiter()
        self._is_borrowing = False
        self._done: Callable[[], object] | None = None

    def begin(self) -> None:
        """Count one more piece of work that is under way."""
        self._count += 1
        if self._count == 1:
            with suppress(anyio.WouldBlock):  # other threads have all of them
                self._limiter.acquire_on_behalf_of_nowait(self)
                self._is_borrowing = True

    def end(self, count: int = 1) -> None:
        """Count ``count`` pieces of work as ended."""
        self._count -= count
        if self._count:
            return
        if self._is_borrowing:
            self._is_borrowing = False
            self._limiter.release_on_behalf_of(self)
        if self._done is not None:
            self._done()

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count a ``with`` block as one piece of work.

        Virtual time stands still during the block, even while the block waits for a worker thread.
        """
        self.begin()
        try:
            yield
        finally:
            self.end()

    @property
    def is_under_way(self) -> bool:
        """Whether any work is under way."""
        return self._count > 0

    async def wait_for_end(self) -> None:
        """Wait until no work is under way. Only one task at a time may wait. Cancelling: safe."""
        while self._count:
            done = anyio.Event()
            self._done = done.set
            await done.wait()


def thread_work() -> ThreadWork:
    """Return the running loop's `ThreadWork`."""
    work = _work.get(None)
    if work is None:
        work = ThreadWork()
        _work.set(work)
    return work


class _Turns:
    """Detects when an asyncio event loop is idle.

    Each call of `wait_until_idle` sleeps for one turn of the loop at a time, so each call always
    has one callback in the loop's queue. If a call finds only callbacks of other `wait_until_idle`
    calls in the queue, the loop is idle.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._ready = cast("Sized | None", getattr(loop, "_ready", None))
        self._watchers = 0
        self._idle = 0
        if self._ready is None:
            logger.warning(
                "virtual time is slow on %s: each jump takes 0.1 s; run the program on asyncio's"
                " own loop, or with turtleact.testing.run",
                type(loop).__name__,
            )

    async def wait_until_idle(self) -> None:
        """Wait until the loop is idle.

        The first call that finds the loop idle also ends the other calls.
        """
        if self._ready is None:
            await anyio.wait_all_tasks_blocked()
            for _ in range(CALLBACK_TURNS):
                await asyncio.sleep(0)
            await anyio.wait_all_tasks_blocked()
            return
        before = self._idle
        self._watchers += 1
        try:
            await asyncio.sleep(0)
            while self._idle == before and len(self._ready) >= self._watchers:
                await asyncio.sleep(0)
        finally:
            self._watchers -= 1
        if self._idle == before:
            self._idle += 1


_turns: RunVar[_Turns] = RunVar("turtleact_turns")
_work: RunVar[ThreadWork] = RunVar("turtleact_thread_work")
