"""Runs and wakes tasks on asyncio (uvloop too) and on trio.

`AsyncioTasks` and `TrioTasks` have the same methods, and so have their signals. `current_tasks`
chooses between them.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Coroutine, Generator, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import Context, copy_context
from types import CoroutineType
from typing import TYPE_CHECKING, Any, TypeAlias

import anyio
import msgspec
from anyio.lowlevel import RunVar

if TYPE_CHECKING:
    import trio

__all__ = [
    "AsyncioTasks",
    "Signal",
    "Task",
    "Tasks",
    "TrioTasks",
    "current_tasks",
    "is_cancellation",
]


def current_tasks() -> Tasks:
    """Return the task functions for the running event loop."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return AsyncioTasks()
    return TrioTasks()


def is_cancellation(error: BaseException, tasks: Tasks) -> bool:
    """Whether an exception is a cancellation, or a group that contains only cancellations."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(tasks.cancelled)[1] is None
    return isinstance(error, tasks.cancelled)


class AsyncioTasks:
    """Runs coroutines in plain `asyncio.Task` objects.

    Attributes:
        cancelled: The exception that cancels a task.
        can_let_go: Whether the event loop can end while a task still ignores its cancellation.
    """

    cancelled: type[BaseException] = asyncio.CancelledError
    can_let_go = True

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> asyncio.Task[None]:
        """Run a coroutine in a new task. Its first step runs after this method has returned.

        The caller owns the task, cancels it if necessary, and waits for its end. The coroutine must
        handle its own exceptions.
        """
        if isinstance(body, CoroutineType):
            body = _Begun(body)
        return asyncio.Task(body, loop=self._loop, name=name, context=context)

    def is_shielded(self, task: object) -> bool:
        """Whether cancelling a task now would interrupt a shielded anyio scope.

        `asyncio.Task.cancel` ignores anyio's shields and would interrupt a shielded scope. anyio
        keeps the scopes of each task in a private table, and has no public way to ask for them. If
        the table is missing, this returns False, so the caller cancels the task at once.
        """
        backend = sys.modules.get("anyio._backends._asyncio")
        states = getattr(backend, "_task_states", {})
        scope = getattr(states.get(task), "cancel_scope", None)
        while scope is not None and not scope.shield:
            scope = getattr(scope, "_parent_scope", None)
        return scope is not None

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
    """Wakes the tasks that wait for it, in the order in which they came.

    A signal does not remember that it has fired: a task that begins to wait later waits until the
    signal fires again.
    """

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


class TrioTasks:
    """Runs coroutines in system tasks of trio, each in its own cancel scope.

    A system task can outlive the task that starts it, as a goal can outlive its client. The owner
    of a task waits for the task's end. trio ends a program only after the last task has ended, even
    if that task ignores its cancellation.
    """

    can_let_go = False

    def __init__(self) -> None:
        import trio

        self._trio = trio
        self._token = trio.lowlevel.current_trio_token()
        try:
            self._stop = _stop.get()
        except LookupError:
            self._stop = _Stop()
            _stop.set(self._stop)
        self.cancelled: type[BaseException] = trio.Cancelled

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> TrioTask:
        """Run a coroutine in a new task. Its first step runs after this method has returned."""
        task = TrioTask(self._trio.CancelScope())
        self._trio.lowlevel.spawn_system_task(
            task.run, body, name=name, context=copy_context() if context is None else context
        )
        return task

    def is_shielded(self, task: object) -> bool:  # noqa: ARG002  # for asyncio
        """Return False, because trio's cancellation respects shields by itself."""
        return False

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Schedule a callback for the loop's next turn."""
        self._token.run_sync_soon(callback)

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Schedule a callback from any thread. If the event loop has ended, do nothing."""
        with suppress(self._trio.RunFinishedError):
            self._token.run_sync_soon(callback)

    def signal(self) -> TrioSignal:
        """Make a new signal."""
        return TrioSignal(self._trio.lowlevel.ParkingLot())

    async def checkpoint(self) -> None:
        """Let all other tasks that are ready run."""
        # trio runs the tasks of a batch in random order. After one checkpoint, a task that was
        # spawned just before may still be waiting for its turn; after two it has had it.
        await self._trio.lowlevel.checkpoint()
        await self._trio.lowlevel.checkpoint()

    def is_canceled(self) -> bool:
        """Return True, because trio raises ``Cancelled`` only in cancelled tasks."""
        return True

    def stop_program(self, error: BaseException) -> None:
        """Cancel the `stoppable` blocks. Each of these blocks then raises ``error``.

        A system task must not raise the error itself, because trio treats that as an internal
        error.
        """
        self._stop.error = error
        for block in self._stop.blocks:
            block.cancel()

    @contextmanager
    def stoppable(self) -> Iterator[None]:
        """Return a context manager for a block that `stop_program` can cancel.

        The cancelled block raises the error that ends the program.
        """
        stop = self._stop
        scope = self._trio.CancelScope()
        stop.blocks.append(scope)
        try:
            with scope:
                yield
        except BaseException:
            if not (scope.cancel_called and stop.error):
                raise
        finally:
            stop.blocks.remove(scope)
        # The cancellation may have ended the block with other errors, perhaps wrapped by nurseries.
        # The program must still end with the error that stopped it.
        if scope.cancel_called and stop.error:
            raise stop.error


class _Stop:
    """Holds the error that ends the program, and the `stoppable` blocks to cancel.

    Each event loop has its own `_Stop` object.
    """

    def __init__(self) -> None:
        self.error: BaseException | None = None
        self.blocks: list[trio.CancelScope] = []


_stop: RunVar[_Stop] = RunVar("turtleact_stop")


class TrioTask:
    """Runs a coroutine in its own cancel scope."""

    __slots__ = ("_scope",)

    def __init__(self, scope: trio.CancelScope) -> None:
        self._scope = scope

    async def run(self, body: Coroutine[object, object, None]) -> None:
        """Run the coroutine to its end."""
        with self._scope:
            await body

    def cancel(self) -> None:
        """Cancel the coroutine at its next ``await`` and at every later one."""
        self._scope.cancel()


class TrioSignal:
    """A signal that uses trio's `ParkingLot`."""

    __slots__ = ("_lot",)

    def __init__(self, lot: trio.lowlevel.ParkingLot) -> None:
        self._lot = lot

    def fire(self) -> None:
        """Wake every task that is waiting."""
        self._lot.unpark_all()

    async def wait(self) -> None:
        """Wait until the signal fires the next time. Cancelling: safe."""
        await self._lot.park()


def _throw(error: BaseException) -> None:
    raise error


Tasks: TypeAlias = AsyncioTasks | TrioTasks
Signal: TypeAlias = AsyncioSignal | TrioSignal
Task: TypeAlias = asyncio.Task[None] | TrioTask
