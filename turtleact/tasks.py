"""Tasks and wake-ups, on asyncio (uvloop too) and on trio.

The few things for which anyio's own are too dear to spend one on each goal or message. A goal's
body runs in a *bare* task: no task group holds it, the action server that started it does, and
must cancel it and wait for its end. Nothing here knows what a goal is.

Order and cancellation:

- `Tasks.spawn` runs the first step of a coroutine at once where the loop can do that (asyncio),
  else soon (trio); the coroutine handles its own exceptions.
- A `Signal` wakes all that wait for it when it fires; it keeps no memory of earlier fires.

Source: asyncio ``Task(eager_start=...)`` of Python 3.12 for the eager first step.
"""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Callable, Coroutine
from contextlib import suppress
from contextvars import Context, copy_context
from typing import TYPE_CHECKING, Protocol

import anyio

from turtleact.goal import Cancelable

if TYPE_CHECKING:
    import trio

__all__ = ["GRACE", "Background", "Signal", "Tasks", "current_tasks", "is_cancellation"]

logger = logging.getLogger("turtleact")


GRACE = 5.0
"""How long what was canceled is waited for, before it is left behind (s)."""


class Signal(Protocol):
    """Many wait, one fires, all go on."""

    def fire(self) -> None:
        """Wake all that wait now."""

    async def wait(self) -> None:
        """Wait for the next fire. Cancelling: safe, nothing is lost."""


class Tasks(Protocol):
    """What one kind of event loop offers."""

    cancelled: type[BaseException]
    can_borrow: bool

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> Cancelable:
        """Run a coroutine in a task of its own, in a copy of the current context unless given."""

    def soon(self, callback: Callable[[], object]) -> None:
        """Call something, not within this call if it may run a body's first step."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread; nothing happens once the loop is gone."""

    def signal(self) -> Signal:
        """A new signal."""

    async def checkpoint(self) -> None:
        """Let others run, once."""

    def is_canceled(self) -> bool:
        """Whether somebody has canceled the task that runs now; True where that cannot be told."""


def current_tasks() -> Tasks:
    """The tasks of the event loop that runs now."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return AsyncioTasks()
    return TrioTasks()


def is_cancellation(error: BaseException, tasks: Tasks) -> bool:
    """Whether an exception is the event loop's cancellation, or a group of nothing else."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(tasks.cancelled)[1] is None
    return isinstance(error, tasks.cancelled)


class Background:
    """A coroutine that runs beside its owner until it is closed; how it fails is logged.

    Args:
        running: The coroutine.
        name: What it is called in a log.
        tasks: What runs it; the event loop that runs now if left out.

    Attributes:
        has_ended: Whether it is over.
    """

    def __init__(
        self, running: Coroutine[object, object, None], name: str, tasks: Tasks | None = None
    ) -> None:
        tasks = current_tasks() if tasks is None else tasks
        self._name = name
        self.has_ended = False
        self._ended = tasks.signal()
        self._cancelled = tasks.cancelled
        self._task = tasks.spawn(self._run(running), name)

    async def aclose(self, timeout: float | None = None) -> None:
        """Cancel it and wait for its end, ``timeout`` seconds at most."""
        self._task.cancel()
        with anyio.move_on_after(timeout, shield=True):
            while not self.has_ended:
                await self._ended.wait()

    async def _run(self, running: Coroutine[object, object, None]) -> None:
        try:
            await running
        except self._cancelled:
            raise
        except Exception:
            logger.exception("%s has failed", self._name)
        finally:
            self.has_ended = True
            self._ended.fire()


# asyncio and uvloop

_current_tasks = asyncio.tasks._current_tasks  # type: ignore[attr-defined]  # what asyncio's own
_enter_task = asyncio.tasks._enter_task  # eager tasks use; the only way to
_leave_task = asyncio.tasks._leave_task  # run a task inside another


def _nothing() -> None:
    """No step has been caught."""


class AsyncioTasks:
    """Bare `asyncio.Task` objects, started eagerly."""

    cancelled: type[BaseException] = asyncio.CancelledError
    can_borrow = True

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._step: Callable[[], object] = _nothing

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> asyncio.Task[None]:
        """Run a coroutine in a task of its own; its first step has run when this returns."""
        if sys.version_info >= (3, 12):
            return asyncio.Task(body, loop=self._loop, name=name, context=context, eager_start=True)
        return self._start_eagerly(body, name, copy_context() if context is None else context)

    def _start_eagerly(
        self, body: Coroutine[object, object, None], name: str, context: Context
    ) -> asyncio.Task[None]:
        """What ``eager_start=True`` does from Python 3.12 on.

        A new task asks its loop to call its first step soon; the loop's ``call_soon`` is shadowed
        for that moment, the step caught and run here, in the task's own context, as the current
        task.
        """
        loop = self._loop
        loop.call_soon = self._catch  # type: ignore[method-assign,assignment]  # for a moment
        try:
            task = asyncio.Task(body, loop=loop, name=name, context=context)
        finally:
            del loop.call_soon
        step, self._step = self._step, _nothing
        current = _current_tasks.get(loop)
        if current is None:
            context.run(step)
            return task
        _leave_task(loop, current)
        try:
            context.run(step)
        finally:
            _enter_task(loop, current)
        return task

    def _catch(self, step: Callable[[], object], *, context: Context) -> None:  # noqa: ARG002
        self._step = step

    def soon(self, callback: Callable[[], object]) -> None:
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
        """Whether somebody has canceled the task that runs now."""
        task = asyncio.current_task()
        return task is None or task.cancelling() > 0


class AsyncioSignal:
    """Futures, in the order of their coming; a canceled waiter takes its own out."""

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


# trio


class TrioTasks:
    """System tasks of trio, each in a cancel scope of its own."""

    can_borrow = False

    def __init__(self) -> None:
        import trio

        self._trio = trio
        self._token = trio.lowlevel.current_trio_token()
        self.cancelled: type[BaseException] = trio.Cancelled

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> TrioTask:
        """Run a coroutine in a task of its own; its first step runs soon."""
        task = TrioTask(self._trio.CancelScope())
        self._trio.lowlevel.spawn_system_task(
            task.run, body, name=name, context=copy_context() if context is None else context
        )
        return task

    def soon(self, callback: Callable[[], object]) -> None:
        """Call something now: what it spawns begins later."""
        callback()

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread; nothing happens once the loop is gone."""
        with suppress(self._trio.RunFinishedError):
            self._token.run_sync_soon(callback)

    def signal(self) -> TrioSignal:
        """A new signal."""
        return TrioSignal(self._trio.lowlevel.ParkingLot())

    async def checkpoint(self) -> None:
        """Let others run, once."""
        await self._trio.lowlevel.checkpoint()

    def is_canceled(self) -> bool:
        """Trio raises nothing else: nobody can await what was canceled."""
        return True


class TrioTask:
    """A coroutine in a cancel scope."""

    __slots__ = ("_scope",)

    def __init__(self, scope: trio.CancelScope) -> None:
        self._scope = scope

    async def run(self, body: Coroutine[object, object, None]) -> None:
        """Run the coroutine to its end."""
        with self._scope:
            await body

    def cancel(self) -> None:
        """Let a cancellation arrive at the coroutine's next await, and at each one after it."""
        self._scope.cancel()


class TrioSignal:
    """A parking lot."""

    __slots__ = ("_lot",)

    def __init__(self, lot: trio.lowlevel.ParkingLot) -> None:
        self._lot = lot

    def fire(self) -> None:
        """Wake all that wait now."""
        self._lot.unpark_all()

    async def wait(self) -> None:
        """Wait for the next fire. Cancelling: safe, nothing is lost."""
        await self._lot.park()
