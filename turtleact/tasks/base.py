"""The task functions of an event loop, the same for asyncio and trio, and the home of an object."""

from __future__ import annotations

import asyncio
import copy
from collections.abc import Callable, Coroutine
from contextlib import AbstractContextManager
from contextvars import Context
from threading import get_ident
from typing import Protocol

import anyio

from turtleact.errors import TurtleactError
from turtleact.goal import Cancelable

__all__ = ["GRACE", "Home", "Signal", "Tasks", "is_cancellation"]

GRACE = 5.0
"""How long to wait for a cancelled task by default, before it is left running (s)."""


class Signal(Protocol):
    """Wakes every task that waits for it. A signal does not remember earlier fires."""

    def fire(self) -> None:
        """Wake every task that waits now."""

    async def wait(self) -> None:
        """Wait for the next fire. Cancelling: safe, nothing is lost."""

    @property
    def waiters(self) -> int:
        """How many tasks wait now."""


class Tasks(Protocol):
    """The task functions of one kind of event loop.

    Attributes:
        cancelled: The exception that cancels a task.
        can_let_go: Whether the loop can end while a task ignores its cancellation. trio cannot.
    """

    cancelled: type[BaseException]
    can_let_go: bool

    def spawn(
        self,
        body: Coroutine[object, object, None],
        name: str,
        context: Context | None = None,
        *,
        is_eager: bool = False,
    ) -> Cancelable:
        """Run a coroutine in a new task.

        The caller owns the task: it cancels the task and waits for its end. The coroutine handles
        its own exceptions. Its first step runs soon. With ``is_eager``, the first step runs before
        this returns, on asyncio from Python 3.12 on.
        """

    def is_shielded(self, task: Cancelable) -> bool:
        """Whether cancelling a task would break into a shielded scope. On trio it never does."""

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Schedule a callback that may spawn tasks. asyncio never runs it within this call."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Schedule a callback from any thread; does nothing once the loop is closed."""

    def signal(self) -> Signal:
        """Make a new signal."""

    async def checkpoint(self) -> None:
        """Let other tasks run once."""

    def is_canceled(self) -> bool:
        """Whether somebody has cancelled the running task. True if the loop cannot tell."""

    def stop_program(self, error: BaseException) -> None:
        """End the program because a task raised `SystemExit` or `KeyboardInterrupt`."""

    def stoppable(self) -> AbstractContextManager[None]:
        """Return a context manager for a block that `stop_program` ends. Only trio needs it."""


def is_cancellation(error: BaseException, tasks: Tasks) -> bool:
    """Whether an exception is a cancellation, or a group of nothing but cancellations."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(tasks.cancelled)[1] is None
    return isinstance(error, tasks.cancelled)


class Home:
    """The running event loop, the only one in which the owner of this home may be used.

    Without a check, using the owner in another thread or event loop fails much later, with an
    unhelpful text: "aclose(): asynchronous generator is already running". Nodes, servers and
    clients create a `Home` and check it first in every public method::

        def __init__(self, name: str) -> None:
            self._home = Home(f"node '{name}'")

        def publisher(self, ...) -> Publisher:
            self._home.check()

    The check takes well below a microsecond. Do not check in `__del__` or in other threads'
    callbacks, which may run anywhere.

    Args:
        owner: The owner's name in error messages, for example ``"node '/lab'"``.
    """

    __slots__ = ("_current", "_loop", "_owner", "_thread")

    def __init__(self, owner: str) -> None:
        self._owner = owner
        self._current = _loop_getter()
        self._loop = self._current()
        self._thread = get_ident()

    def of(self, owner: str) -> Home:
        """Return the same home for another object that was created in it.

        No event loop need run now.
        """
        home = copy.copy(self)
        home._owner = owner
        return home

    def check(self) -> None:
        """Check that the home's event loop is running this call, or stands between two runs.

        A notebook that runs as plain Python calls functions between two calls of ``runner.run(…)``.
        The loop does not run then, so nothing can interfere.

        Raises:
            TurtleactError: if another event loop runs this call, or another thread does.
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
    """Return a function that returns the running loop, or raises RuntimeError."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return asyncio.get_running_loop
    import trio  # already imported, since its loop runs

    return trio.lowlevel.current_trio_token
