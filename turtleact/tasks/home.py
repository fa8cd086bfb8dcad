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
from collections.abc import Callable

import anyio

from turtleact.errors import TurtleactError

__all__ = ["Home"]


class Home:
    """The event loop that runs now; whatever has this home must be used there.

    Args:
        owner: What has it, as users call it: ``"node '/lab'"``.
    """

    __slots__ = ("_current", "_loop", "_owner")

    def __init__(self, owner: str) -> None:
        self._owner = owner
        self._current = _loop_getter()
        self._loop = self._current()

    def check(self) -> None:
        """Raise unless this is called in the home's event loop, and so in its thread.

        Raises:
            TurtleactError: if another event loop runs here, or none.
        """
        try:
            if self._current() is self._loop:
                return
        except RuntimeError:  # no event loop runs in this thread
            pass
        raise TurtleactError(
            f"{self._owner} belongs to another event loop: use it there, from another thread by "
            "anyio.from_thread.run or run_sync"
        )


def _loop_getter() -> Callable[[], object]:
    """What gives the event loop that runs, one and the same object each time; else RuntimeError."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return asyncio.get_running_loop
    import trio  # it runs, so it is there

    return trio.lowlevel.current_trio_token
