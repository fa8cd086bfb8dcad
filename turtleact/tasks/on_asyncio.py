"""Tasks of asyncio (uvloop too), and futures to wait for.

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

from turtleact.goal import Cancelable

__all__ = ["AsyncioSignal", "AsyncioTasks", "is_in_shielded_scope"]

DEEPEST = 32
"""How many first steps may run inside one another.

A body that starts eagerly may send a goal whose body starts eagerly, and so on. Each level takes
about six frames of Python's stack, which holds 1,000. Deeper bodies start on the next turn."""


def is_in_shielded_scope(task: object) -> bool:
    """Whether an asyncio task is inside a shielded anyio scope.

    `asyncio.Task.cancel` knows nothing of anyio's shields and would break into one. anyio keeps
    which scopes a task has entered in a private table, and has no public way to ask. Without it
    the answer is no: the cancellation is delivered at once.
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
        """Run a coroutine in a task of its own; started eagerly from Python 3.12 on."""
        if sys.version_info >= (3, 12) and is_eager and self._depth < DEEPEST:
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
        """Call something in the loop's next turn: it may run a body's first step."""
        self._loop.call_soon(callback)

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread; nothing happens once the loop is gone."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(callback)

    def signal(self) -> AsyncioSignal:
        """A new signal."""
        return AsyncioSignal(self._loop)

    async def checkpoint(self) -> None:
        """Let others run, once."""
        await asyncio.sleep(0)

    def is_canceled(self) -> bool:
        """Whether somebody has cancelled the running task."""
        task = asyncio.current_task()
        return task is None or task.cancelling() > 0

    def stop_program(self, error: BaseException) -> None:
        """Raise in a callback of the loop: that ends `asyncio.run`.

        Raised in the task itself, it would reach whoever has started the task eagerly.
        """
        self._loop.call_soon(_throw, error)

    def stoppable(self) -> AbstractContextManager[None]:
        """A callback can end the program on this loop, so the block needs nothing."""
        return nullcontext()


class _Begun(Coroutine[object, object, None]):
    """A coroutine whose first step runs even if its task is cancelled before it.

    asyncio would throw the cancellation into a coroutine that has not begun, which then runs no
    ``finally`` and tells nobody of its end. Here, as on trio, it arrives at the first await.
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
        """Run one step that begins with an exception."""
        if not self._has_begun:
            self.send(None)
        return self._running.throw(error)

    def close(self) -> None:
        """Close the coroutine."""
        self._running.close()

    def __await__(self) -> Generator[object, object, None]:
        return self._running.__await__()


class AsyncioSignal:
    """Futures, in the order of their coming; a cancelled waiter takes its own out."""

    __slots__ = ("_loop", "_waiting")

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._waiting: dict[asyncio.Future[None], None] = {}

    def fire(self) -> None:
        """Wake all that wait now."""
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
