"""Being idle: when every task waits.

Source: asyncio's ``BaseEventLoop._run_once``; trio's ``wait_all_tasks_blocked``.
"""

from __future__ import annotations

import asyncio
import gc
from collections import deque
from collections.abc import Awaitable, Callable, Sized
from typing import cast

import anyio
from anyio.lowlevel import RunVar

from turtleact.errors import SimError

__all__ = ["idleness", "wait_until_idle"]


async def wait_until_idle() -> None:
    """Wait until every other task waits for something that none of them brings about.

    Several may wait so; all go on then. What waits for the network, a thread or wall time counts as
    idle. Cancelling: safe, nothing is lost.
    """
    await idleness()()


def idleness() -> Callable[[], Awaitable[None]]:
    """The `wait_until_idle` of the event loop that runs now, for those who wait again and again.

    Raises:
        SimError: if the loop does not show what it will do.
    """
    if anyio.get_cancelled_exc_class() is not asyncio.CancelledError:
        return anyio.wait_all_tasks_blocked  # trio's own
    turns = _turns.get(None)
    if turns is None:
        turns = _Turns(asyncio.get_running_loop())
        _turns.set(turns)
    return turns.wait_until_idle


class _Turns:
    """How often an asyncio loop has been idle, and who watches it.

    A watcher takes turn after turn of the loop, so each has one call in the loop's queue; the loop
    is idle when a watcher, in its own turn, finds nothing there but those of the others.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._ready = _queue(loop)
        self._watchers = 0
        self._idle = 0

    async def wait_until_idle(self) -> None:
        """Take turns until the loop is idle; whoever sees it first has seen it for all."""
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


def _queue(loop: asyncio.AbstractEventLoop) -> Sized:
    """The calls that a loop will make in this or its next turn.

    Raises:
        SimError: if the loop does not show them.
    """
    ready = getattr(loop, "_ready", None)  # asyncio's own loops
    if ready is None:  # uvloop hides it from Python, but not from the garbage collector
        held = [each for each in gc.get_referents(loop) if isinstance(each, deque)]
        if len(held) != 1:
            raise SimError(f"virtual time does not work on the event loop {loop!r}")
        ready = held[0]
    return cast("Sized", ready)
