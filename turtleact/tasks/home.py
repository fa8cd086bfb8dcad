"""Remembers which event loop an object belongs to, so that use from elsewhere fails clearly.

Objects of turtleact must not be used from another thread or event loop. Without a check, such use
fails much later, with a text that explains nothing: "aclose(): asynchronous generator is already
running".

Nodes, servers and clients create a `Home` and check it first in every public method::

    def __init__(self, name: str) -> None:
        self._home = Home(f"node '{name}'")

    def publisher(self, ...) -> Publisher:
        self._home.check()

The check takes well below a microsecond. Do not check in `__del__` or in other threads' callbacks,
which may run anywhere.
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
    """The running event loop; the owner of this home must be used only there.

    Args:
        owner: How messages name the owner, for example ``"node '/lab'"``.
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
        """Raise unless the home's event loop is running this call, or stands between two runs.

        A notebook run as plain Python calls functions between ``runner.run(…)`` and
        ``runner.run(…)``. The loop does not run then, so nothing can interfere.

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
            f"{self._owner} belongs to another event loop: use it there, or call it from another "
            "thread with anyio.from_thread.run or run_sync"
        )

    def _can_go_on(self) -> bool:
        return isinstance(self._loop, asyncio.AbstractEventLoop) and not self._loop.is_closed()


def _loop_getter() -> Callable[[], object]:
    """Return a function that gives the running loop, always the same object, or RuntimeError."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return asyncio.get_running_loop
    import trio  # already imported, since its loop runs

    return trio.lowlevel.current_trio_token
