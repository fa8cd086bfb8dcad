"""The event loop that an object belongs to, so that using it elsewhere is told clearly.

Nothing of turtleact may be used from another thread or another event loop. Without a check, such a
use fails much later and with a text that says nothing: "aclose(): asynchronous generator is already
running".

A node, server or client makes a `Home` when it is made, and checks it first thing in what users
call::

    def __init__(self, name: str) -> None:
        self._home = Home(f"node '{name}'")

    def publisher(self, ...) -> Publisher:
        self._home.check()

The check takes well below a microsecond. Do not check in `__del__` or in callbacks
of other threads, which may run anywhere.
"""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Callable
from threading import get_ident

import anyio

from turtleact.errors import TurtleactError

__all__ = ["Home"]


class Home:
    """The event loop that runs now; whatever has this home must be used there.

    Args:
        owner: What has it, as users call it: ``"node '/lab'"``.
    """

    __slots__ = ("_current", "_loop", "_owner", "_thread")

    def __init__(self, owner: str) -> None:
        self._owner = owner
        self._current = _loop_getter()
        self._loop = self._current()
        self._thread = get_ident()

    def of(self, owner: str) -> Home:
        """The same home, for something that was made there; no event loop need run now."""
        home = copy.copy(self)
        home._owner = owner
        return home

    def check(self) -> None:
        """Raise unless this is called in the home's event loop, or between two runs of it.

        A notebook that is run as plain Python calls plain functions between ``runner.run(…)`` and
        ``runner.run(…)``: the loop stands still then, so nothing can get into its way.

        Raises:
            TurtleactError: if another event loop runs here, or this is another thread.
        """
        try:
            if self._current() is self._loop:
                return
        except RuntimeError:  # no event loop runs in this thread
            if self._thread == get_ident() and self._can_go_on():
                return
        raise TurtleactError(
            f"{self._owner} belongs to another event loop: use it there, from another thread by "
            "anyio.from_thread.run or run_sync"
        )

    def _can_go_on(self) -> bool:
        return isinstance(self._loop, asyncio.AbstractEventLoop) and not self._loop.is_closed()


def _loop_getter() -> Callable[[], object]:
    """What gives the event loop that runs, one and the same object each time; else RuntimeError."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return asyncio.get_running_loop
    import trio  # it runs, so it is there

    return trio.lowlevel.current_trio_token
