"""Detects when an event loop is idle, that is, when every task waits.

Virtual time jumps only while the loop is idle. How this module detects this depends on the loop:

- A loop made by `new_event_loop` tells its selector to wait when no callback is ready. At that
  moment, the selector wakes every task that waits in `wait_until_idle`.
- Other asyncio loops keep the callbacks that are ready in a private queue, which this module reads.
- On asyncio loops that do not show their queue of callbacks (uvloop), this module calls
  `anyio.wait_all_tasks_blocked`, which polls every 0.1 s. Because that is slow, a warning is logged
  once per run.
- On trio, this module calls trio's own function ``wait_all_tasks_blocked``.

Source: asyncio ``BaseEventLoop._run_once``; trio ``wait_all_tasks_blocked``.
"""

from __future__ import annotations

import asyncio
import logging
import selectors
from collections.abc import Awaitable, Callable, Iterator, Sized
from contextlib import contextmanager, suppress
from typing import cast

import anyio
import anyio.to_thread
from anyio.lowlevel import RunVar

__all__ = [
    "IdleSelector",
    "ThreadWork",
    "WatchedEventLoop",
    "idleness",
    "new_event_loop",
    "ready_callbacks",
    "thread_work",
    "wait_until_idle",
]

logger = logging.getLogger("turtleact")

CALLBACK_TURNS = 3
"""How many turns of the loop to wait for pending callbacks if the loop's queue cannot be read.

A finished task wakes its parent with a callback that belongs to no task. Until this callback runs,
the loop looks idle although the parent is about to run."""


def new_event_loop() -> asyncio.AbstractEventLoop:
    """Make an asyncio event loop that knows when it is idle.

    Pass this function as the argument ``loop_factory`` of `asyncio.Runner`.
    """
    return WatchedEventLoop()


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
    loop = asyncio.get_running_loop()
    if isinstance(loop, WatchedEventLoop):
        return loop.idle_selector.wait_until_idle
    turns = _turns.get(None)
    if turns is None:
        turns = _Turns(loop)
        _turns.set(turns)
    return turns.wait_until_idle


class IdleSelector(selectors.DefaultSelector):
    """Before this selector blocks, it wakes every task that waits in `wait_until_idle`."""

    def __init__(self) -> None:
        super().__init__()
        self._watchers: list[asyncio.Future[None]] = []

    async def wait_until_idle(self) -> None:
        """Wait until the event loop has nothing to do. Cancelling: safe."""
        watcher = asyncio.get_running_loop().create_future()
        self._watchers.append(watcher)
        await watcher

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return the events that have arrived; if there are none, wait for events.

        If a callback is ready, asyncio passes 0 as the ``timeout``.
        """
        events = super().select(0)
        if events or (timeout is not None and timeout <= 0):
            return events
        if any(not watcher.done() for watcher in self._watchers):
            self._wake()
            return []  # the watchers' callbacks are ready now: the loop must not wait
        return self.wait_for_events(timeout)

    def wait_for_events(self, timeout: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        """Block until an event arrives or the timeout ends.

        This is called only while the loop is idle and no task is in `wait_until_idle`.
        """
        return super().select(timeout)

    def _wake(self) -> None:
        watchers, self._watchers = self._watchers, []
        for watcher in watchers:
            if not watcher.done():
                watcher.set_result(None)


class WatchedEventLoop(asyncio.SelectorEventLoop):
    """asyncio's selector event loop, with an `IdleSelector`.

    Attributes:
        idle_selector: The selector of this loop.
    """

    def __init__(self, selector: IdleSelector | None = None) -> None:
        self.idle_selector = IdleSelector() if selector is None else selector
        super().__init__(self.idle_selector)


def ready_callbacks(loop: asyncio.AbstractEventLoop) -> Sized | None:
    """Return the callbacks that an asyncio loop runs next; None if the loop hides them.

    This reads a private attribute of the loop, because asyncio has no public function for it. On a
    loop without the attribute, virtual time still works, but slowly.
    """
    return cast("Sized | None", getattr(loop, "_ready", None))


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
    """Detects when an asyncio event loop is idle if `new_event_loop` did not make the loop.

    Each call of `wait_until_idle` sleeps for one turn of the loop at a time, so each call always
    has one callback in the loop's queue. If a call finds only callbacks of other `wait_until_idle`
    calls in the queue, the loop is idle.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._ready = ready_callbacks(loop)
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
