"""Task functions for asyncio and trio alike; checks that an object is used in its event loop."""

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

__all__ = ["GRACE", "Cancelable", "LoopGuard", "Signal", "Tasks", "is_cancellation"]

GRACE = 5.0
"""How long to wait by default for a cancelled task (s), before the task is left running."""


class Cancelable(Protocol):
    """A running task that can be asked to stop."""

    def cancel(self) -> object:
        """Ask the task to stop. The task may take a while to stop."""


class Signal(Protocol):
    """Wakes the tasks that wait for it.

    A signal does not remember that it has fired: a task that begins to wait later waits until the
    signal fires again.
    """

    def fire(self) -> None:
        """Wake every task that is waiting."""

    async def wait(self) -> None:
        """Wait until the signal fires the next time. Cancelling: safe."""

    @property
    def waiters(self) -> int:
        """How many tasks are waiting."""


class Tasks(Protocol):
    """The functions for tasks on one kind of event loop, asyncio or trio.

    Attributes:
        cancelled: The exception that cancels a task.
        can_let_go: Whether the event loop can end while a task still ignores its cancellation. True
            on asyncio, False on trio.
    """

    cancelled: type[BaseException]
    can_let_go: bool

    def spawn(
        self,
        body: Coroutine[object, object, None],
        name: str,
        context: Context | None = None,
    ) -> Cancelable:
        """Run a coroutine in a new task.

        The caller owns the task, cancels it if necessary, and waits for its end. The coroutine must
        handle its own exceptions.

        The first step of the coroutine runs after this method has returned.
        """

    def is_shielded(self, task: Cancelable) -> bool:
        """Whether cancelling a task now would interrupt a shielded scope. Always False on trio."""

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Schedule a callback for the loop's next turn."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Schedule a callback from any thread. If the event loop is closed, do nothing."""

    def signal(self) -> Signal:
        """Make a new signal."""

    async def checkpoint(self) -> None:
        """Let all other tasks that are ready run."""

    def is_canceled(self) -> bool:
        """Whether the running task has been cancelled; True if the event loop cannot tell."""

    def stop_program(self, error: BaseException) -> None:
        """End the program because a task raised `SystemExit` or `KeyboardInterrupt`."""

    def stoppable(self) -> AbstractContextManager[None]:
        """Return a context manager for a block that `stop_program` can end.

        Only trio needs such a block.
        """


def is_cancellation(error: BaseException, tasks: Tasks) -> bool:
    """Whether an exception is a cancellation, or a group that contains only cancellations."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(tasks.cancelled)[1] is None
    return isinstance(error, tasks.cancelled)


class LoopGuard:
    """Remembers an object's event loop and thread, and checks that the object is used only there.

    Without this check, using an object in another thread or event loop fails much later, with an
    unhelpful message such as "aclose(): asynchronous generator is already running". Nodes, servers
    and clients create a `LoopGuard`, and call `check` first in every public method::

        def __init__(self, name: str) -> None:
            self._home = LoopGuard(f"node '{name}'")

        def publisher(self, ...) -> Publisher:
            self._home.check()

    A call of `check` takes well below a microsecond. Do not call `check` in `__del__`, or in
    callbacks of other threads, because these may run in any thread.

    Args:
        owner: The name of the object in error messages, for example ``"node '/lab'"``.
    """

    __slots__ = ("_current", "_loop", "_owner", "_thread")

    def __init__(self, owner: str) -> None:
        self._owner = owner
        self._current = _loop_getter()
        self._loop = self._current()
        self._thread = get_ident()

    def of(self, owner: str) -> LoopGuard:
        """Return a `LoopGuard` for another object, with the same event loop and thread.

        This method works even while no event loop runs.
        """
        home = copy.copy(self)
        home._owner = owner
        return home

    def check(self) -> None:
        """Check that this call comes from the home's event loop.

        While no event loop runs, a call from the home's thread is also allowed, because no task can
        run at the same time. For example, a notebook that runs as plain Python calls functions
        between two calls of ``runner.run(…)``. Calls without a running event loop are allowed only
        for a home on asyncio, and only until its loop is closed.

        Raises:
            TurtleactError: if the call comes from another event loop or another thread, or if the
                loop is closed.
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
    """Return a function that returns the running event loop.

    If no loop runs, the function raises RuntimeError.
    """
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return asyncio.get_running_loop
    import trio  # already imported, since its loop runs

    return trio.lowlevel.current_trio_token
