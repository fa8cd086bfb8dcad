"""Detects when an event loop is idle, that is, when every task waits. Virtual time jumps only then.

The method depends on the loop:

- A loop made by `new_event_loop` asks its selector to wait when it has nothing else to do. At that
  moment, the selector wakes every task that waits for idleness.
- Other asyncio loops keep their callbacks in a private queue, which this module reads.
- A loop without that queue (uvloop) needs `anyio.wait_all_tasks_blocked`, which polls every 0.1 s.
  That is slow, so a warning is logged once per run.
- trio has a function for it.

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
"""How many turns callbacks outside any task get on a loop that hides its callbacks.

A finished task wakes its parent with such a callback. Until the callback runs, all tasks seem to
wait."""


def new_event_loop() -> asyncio.AbstractEventLoop:
    """Make an asyncio event loop that knows when it is idle. Pass this as ``loop_factory``."""
    return WatchedEventLoop()


async def wait_until_idle() -> None:
    """Wait until no other task can run by itself.

    Any number of tasks may call this. All these tasks continue together. Tasks that wait for the
    network, a thread or wall time count as idle. Cancelling: safe, nothing is lost.
    """
    await idleness()()


def idleness() -> Callable[[], Awaitable[None]]:
    """Return the `wait_until_idle` of the running loop, for callers that wait again and again."""
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
    """A selector that, before it blocks, wakes every task that waits for idleness."""

    def __init__(self) -> None:
        super().__init__()
        self._watchers: list[asyncio.Future[None]] = []

    async def wait_until_idle(self) -> None:
        """Wait until the loop has nothing to do. Cancelling: safe."""
        watcher = asyncio.get_running_loop().create_future()
        self._watchers.append(watcher)
        await watcher

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for events. A timeout above 0, or None, means that no callback is ready."""
        events = super().select(0)
        if events or (timeout is not None and timeout <= 0):
            return events
        if any(not watcher.done() for watcher in self._watchers):
            self._wake()
            return []  # the watchers' callbacks are ready now: the loop must not wait
        return self.wait_for_events(timeout)

    def wait_for_events(self, timeout: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        """Block until an event arrives, because the loop is idle and no task waits for idleness."""
        return super().select(timeout)

    def _wake(self) -> None:
        watchers, self._watchers = self._watchers, []
        for watcher in watchers:
            if not watcher.done():
                watcher.set_result(None)


class WatchedEventLoop(asyncio.SelectorEventLoop):
    """asyncio's selector loop with an `IdleSelector`.

    Attributes:
        idle_selector: The selector.
    """

    def __init__(self, selector: IdleSelector | None = None) -> None:
        self.idle_selector = IdleSelector() if selector is None else selector
        super().__init__(self.idle_selector)


def ready_callbacks(loop: asyncio.AbstractEventLoop) -> Sized | None:
    """Return the callbacks that an asyncio loop runs next; None if the loop hides them.

    This reads a private attribute, because asyncio has no public way to ask and turtleact did not
    make the loop. If the attribute is missing, virtual time still works, but slowly.
    """
    return cast("Sized | None", getattr(loop, "_ready", None))


class ThreadWork:
    """Counts the work that threads do for the loop. Virtual time stands still meanwhile.

    Such work must be sure to end soon. A `turtleact.clock.VirtualClock` asks this object whether
    there is any work. The event loops of `turtleact.testing` stand still while a token of anyio's
    thread limiter is borrowed, so this object borrows one.
    """

    def __init__(self) -> None:
        self._count = 0
        self._limiter = anyio.to_thread.current_default_thread_limiter()
        self._is_borrowing = False
        self._done: Callable[[], object] | None = None

    def begin(self) -> None:
        """Count one more piece of work."""
        self._count += 1
        if self._count == 1:
            with suppress(anyio.WouldBlock):  # other threads have all of them
                self._limiter.acquire_on_behalf_of_nowait(self)
                self._is_borrowing = True

    def end(self, count: int = 1) -> None:
        """Count ``count`` fewer pieces of work."""
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
        """Count a block, such as a wait for a thread, as one piece of work."""
        self.begin()
        try:
            yield
        finally:
            self.end()

    @property
    def is_under_way(self) -> bool:
        """Whether a thread is working for the loop."""
        return self._count > 0

    async def wait_for_end(self) -> None:
        """Wait until no work is under way. Only one task can wait. Cancelling: safe."""
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
    """Watches a loop that turtleact did not make.

    Each watcher sleeps for one turn of the loop at a time, so it always has one callback in the
    queue. If a watcher finds only callbacks of other watchers in the queue, the loop is idle.
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
        """Take turns until the loop is idle. The first watcher to notice tells the others."""
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
