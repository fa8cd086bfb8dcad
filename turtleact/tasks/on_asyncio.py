"""Implements tasks and signals on asyncio and uvloop."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Coroutine, Generator
from contextlib import AbstractContextManager, nullcontext, suppress
from contextvars import Context
from types import CoroutineType
from typing import Any

import msgspec

from turtleact.tasks.base import Cancelable

__all__ = ["AsyncioSignal", "AsyncioTasks", "is_in_shielded_scope"]


def is_in_shielded_scope(task: object) -> bool:
    """Whether an asyncio task is inside a shielded anyio scope.

    `asyncio.Task.cancel` ignores anyio's shields and would interrupt a shielded scope. anyio keeps
    the scopes of each task in a private table, and has no public way to ask for them. If the table
    is missing, this returns False, so the caller cancels the task at once.
    """
    backend = sys.modules.get("anyio._backends._asyncio")
    states = getattr(backend, "_task_states", {})
    scope = getattr(states.get(task), "cancel_scope", None)
    while scope is not None and not scope.shield:
        scope = getattr(scope, "_parent_scope", None)
    return scope is not None


class AsyncioTasks:
    """Runs coroutines in plain `asyncio.Task` objects."""

    cancelled: type[BaseException] = asyncio.CancelledError
    can_let_go = True

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> Cancelable:
        """Run a coroutine in a new task. Its first step runs after this method has returned."""
        if isinstance(body, CoroutineType):
            body = _Begun(body)
        return asyncio.Task(body, loop=self._loop, name=name, context=context)

    def is_shielded(self, task: Cancelable) -> bool:
        """Whether cancelling a task now would interrupt a shielded anyio scope."""
        return is_in_shielded_scope(task)

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Schedule a callback for the loop's next turn."""
        self._loop.call_soon(callback)

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Schedule a callback from any thread. If the event loop is closed, do nothing."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(callback)

    def signal(self) -> AsyncioSignal:
        """Make a new signal."""
        return AsyncioSignal(self._loop)

    def checkpoint(self) -> Coroutine[object, object, None]:
        """Let all other tasks that are ready run."""
        return asyncio.sleep(0)

    def is_canceled(self) -> bool:
        """Whether the running task has been cancelled; True if no task is running."""
        task = asyncio.current_task()
        return task is None or task.cancelling() > 0

    def stop_program(self, error: BaseException) -> None:
        """Raise the error in a callback of the loop, so that `asyncio.run` ends with the error."""
        self._loop.call_soon(_throw, error)

    def stoppable(self) -> AbstractContextManager[None]:
        """Return a context manager that does nothing; on asyncio, `stop_program` needs no block."""
        return nullcontext()


class _Begun(Coroutine[object, object, None]):
    """A coroutine that runs its first step even if its task is cancelled before that.

    If a task is cancelled before its first step, asyncio throws the cancellation into a coroutine
    that has not begun. Such a coroutine runs no code at all, not even ``finally``, and so cannot
    report its end. This wrapper therefore runs the first step before it passes the cancellation on.
    The cancellation then arrives at the first ``await``, as on trio.
    """

    __slots__ = ("_has_begun", "_running")

    def __init__(self, running: Coroutine[object, object, None]) -> None:
        self._running = running
        self._has_begun = False

    def send(self, value: Any) -> object:  # noqa: ANN401  # whatever the loop sends
        """Run one step of the coroutine."""
        self._has_begun = True
        return self._running.send(value)

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Run the coroutine's first step, unless it has run, and then throw an exception."""
        if not self._has_begun:
            self.send(None)
        return self._running.throw(error)

    def close(self) -> None:
        """Close the coroutine."""
        self._running.close()

    def __await__(self) -> Generator[object, object, None]:
        return self._running.__await__()


class AsyncioSignal(msgspec.Struct, eq=False):
    """A signal that keeps one future per waiting task, in the order in which the tasks came."""

    _loop: asyncio.AbstractEventLoop
    _waiting: dict[asyncio.Future[None], None] = {}

    def fire(self) -> None:
        """Wake every task that is waiting."""
        if self._waiting:
            waiting, self._waiting = self._waiting, {}
            for future in waiting:
                if not future.done():
                    future.set_result(None)

    async def wait(self) -> None:
        """Wait until the signal fires the next time. Cancelling: safe."""
        future = self._loop.create_future()
        self._waiting[future] = None
        try:
            await future
        except asyncio.CancelledError:
            self._waiting.pop(future, None)
            raise

    @property
    def waiters(self) -> int:
        """How many tasks are waiting."""
        return len(self._waiting)


def _throw(error: BaseException) -> None:
    raise error
