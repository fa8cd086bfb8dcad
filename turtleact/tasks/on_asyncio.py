"""Runs tasks on asyncio (uvloop too), and makes signals of futures.

Source: asyncio ``Task(eager_start=...)``, Python 3.12.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Coroutine, Generator
from contextlib import AbstractContextManager, nullcontext, suppress
from contextvars import Context
from types import CoroutineType
from typing import Any

import msgspec

from turtleact.goal import Cancelable

__all__ = ["AsyncioSignal", "AsyncioTasks", "is_in_shielded_scope"]

DEEPEST = 32
"""How many tasks may start inside each other's first steps.

A body that starts eagerly may send a goal, the body of that goal may also start eagerly, and so on.
Each level takes about six of the 1,000 frames on Python's stack. Deeper bodies start on the loop's
next turn."""


def is_in_shielded_scope(task: object) -> bool:
    """Whether an asyncio task is inside a shielded anyio scope.

    `asyncio.Task.cancel` ignores anyio's shields and would break into a shielded scope. anyio keeps
    the scopes of each task in a private table, and has no public way to ask for them. If the table
    is missing, this returns False, and the cancellation is delivered at once.
    """
    backend = sys.modules.get("anyio._backends._asyncio")
    states = getattr(backend, "_task_states", {})
    scope = getattr(states.get(task), "cancel_scope", None)
    while scope is not None and not scope.shield:
        scope = getattr(scope, "_parent_scope", None)
    return scope is not None


class AsyncioTasks:
    """Plain `asyncio.Task` objects."""

    cancelled: type[BaseException] = asyncio.CancelledError
    can_let_go = True

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._depth = 0

    def spawn(
        self,
        body: Coroutine[object, object, None],
        name: str,
        context: Context | None = None,
        *,
        is_eager: bool = False,
    ) -> Cancelable:
        """Run a coroutine in a new task.

        With ``is_eager``, it starts eagerly from Python 3.12 on.
        """
        if sys.version_info >= (3, 12) and is_eager and self._depth < DEEPEST:
            # An eager task runs its first step inside this call. That step may spawn another task,
            # and so on, which is why the depth is limited.
            self._depth += 1
            try:
                return asyncio.Task(
                    body, loop=self._loop, name=name, context=context, eager_start=True
                )
            finally:
                self._depth -= 1
        if isinstance(body, CoroutineType):
            body = _Begun(body)
        return asyncio.Task(body, loop=self._loop, name=name, context=context)

    def is_shielded(self, task: Cancelable) -> bool:
        """Whether cancelling a task would break into a shielded anyio scope."""
        return is_in_shielded_scope(task)

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Schedule a callback for the loop's next turn, because it may run a body's first step."""
        self._loop.call_soon(callback)

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Schedule a callback from any thread; does nothing once the loop is closed."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(callback)

    def signal(self) -> AsyncioSignal:
        """Make a new signal."""
        return AsyncioSignal(self._loop)

    def checkpoint(self) -> Coroutine[object, object, None]:
        """Let other tasks run once."""
        return asyncio.sleep(0)

    def is_canceled(self) -> bool:
        """Whether somebody has cancelled the running task."""
        task = asyncio.current_task()
        return task is None or task.cancelling() > 0

    def stop_program(self, error: BaseException) -> None:
        """Raise the error in a callback of the loop, which ends `asyncio.run`.

        If an eager task itself raised the error, the code that started the task would get it.
        """
        self._loop.call_soon(_throw, error)

    def stoppable(self) -> AbstractContextManager[None]:
        """Return a context manager that does nothing. On asyncio a callback ends the program."""
        return nullcontext()


class _Begun(Coroutine[object, object, None]):
    """A coroutine that runs its first step even if its task is cancelled before that.

    asyncio throws the cancellation into a coroutine that has not begun. That coroutine would run no
    ``finally`` and report its end to nobody. This wrapper runs the first step anyway, so that the
    cancellation arrives at the first await, as on trio.
    """

    __slots__ = ("_has_begun", "_running")

    def __init__(self, running: Coroutine[object, object, None]) -> None:
        self._running = running
        self._has_begun = False

    def send(self, value: Any) -> object:  # noqa: ANN401  # whatever the loop sends
        """Run one step."""
        self._has_begun = True
        return self._running.send(value)

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Throw an exception into the coroutine, after its first step."""
        if not self._has_begun:
            self.send(None)
        return self._running.throw(error)

    def close(self) -> None:
        """Close the coroutine."""
        self._running.close()

    def __await__(self) -> Generator[object, object, None]:
        return self._running.__await__()


class AsyncioSignal(msgspec.Struct, eq=False):
    """A signal made of futures, one per waiter, in the order of arrival."""

    _loop: asyncio.AbstractEventLoop
    _waiting: dict[asyncio.Future[None], None] = {}

    def fire(self) -> None:
        """Wake every task that waits now."""
        if self._waiting:
            waiting, self._waiting = self._waiting, {}
            for future in waiting:
                if not future.done():
                    future.set_result(None)

    async def wait(self) -> None:
        """Wait for the next fire. Cancelling: safe, nothing is lost."""
        future = self._loop.create_future()
        self._waiting[future] = None
        try:
            await future
        except asyncio.CancelledError:
            self._waiting.pop(future, None)
            raise

    @property
    def waiters(self) -> int:
        """How many wait now."""
        return len(self._waiting)


def _throw(error: BaseException) -> None:
    raise error
