"""Bare tasks of asyncio, and futures to wait for.

anyio tells nobody in which cancel scopes a task is, so they are read from what its backend keeps.

Source: asyncio ``Task(eager_start=...)`` of Python 3.12 for the eager first step.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Coroutine, Iterator
from contextlib import suppress
from contextvars import Context, copy_context
from functools import partial
from weakref import ref

from anyio._backends import _asyncio as backend

from turtleact.goal import Cancelable
from turtleact.tasks.base import DEEPEST, Scope

__all__ = ["AsyncioSignal", "AsyncioTasks", "hand_over"]

if sys.version_info < (3, 12):  # what eager tasks of asyncio use: the way to run one inside another
    _current_tasks = asyncio.tasks._current_tasks  # type: ignore[attr-defined]  # in no stub
    _enter_task = asyncio.tasks._enter_task
    _leave_task = asyncio.tasks._leave_task


def _scopes_of(task: object) -> backend.TaskState | None:
    """What anyio knows of a task; None if it has entered no scope, or is none yet."""
    known = backend._task_states.data  # type: ignore[attr-defined]  # past a slow `get`
    return known.get(ref(task)) if task is not None else None


def hand_over(
    task: asyncio.Task[object], scopes: list[backend.CancelScope], heir: asyncio.Task[object]
) -> None:
    """Let a task be in the cancel scopes that another has entered, and the other be outside.

    Cancellations that these scopes have sent the other are taken back there.

    Args:
        task: The other; it must be in the first of the scopes.
        scopes: The scopes, the innermost first; no other is inside them.
        heir: A task that has entered none.
    """
    state = _scopes_of(task)
    if state is None or not scopes:
        return
    for scope in scopes:
        scope._host_task = heir
        for _ in range(scope._pending_uncancellations or 0):
            task.uncancel()
        scope._pending_uncancellations = 0
    scopes[0]._tasks.discard(task)
    scopes[0]._tasks.add(heir)
    backend._task_states[heir] = backend.TaskState(state.parent_id, scopes[0])
    outer, scopes[-1]._parent_scope = scopes[-1]._parent_scope, None
    state.cancel_scope = outer
    if outer is not None:
        outer._child_scopes.discard(scopes[-1])
        outer._tasks.add(task)


def _nothing() -> None:
    """No step has been caught."""


class AsyncioTasks:
    """Bare `asyncio.Task` objects, started eagerly."""

    cancelled: type[BaseException] = asyncio.CancelledError
    can_borrow = True

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._step: Callable[[], object] = _nothing
        self.depth = 0

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> Cancelable:
        """Run a coroutine in a task of its own; its first step has run when this returns.

        It has not where so many are run inside one another that Python's stack would not hold them.
        """
        if context is None:
            context = copy_context()
        if self.depth >= DEEPEST:
            return _Late(partial(self._start_eagerly, body, name, context), self._loop)
        self.depth += 1
        try:
            return self._start_eagerly(body, name, context)
        finally:
            self.depth -= 1

    def scope(self) -> Scope | None:
        """The innermost cancel scope of the task that runs now."""
        state = _scopes_of(asyncio.current_task(self._loop))
        return None if state is None else state.cancel_scope

    def scopes(self, task: Cancelable, outer: Scope | None) -> Iterator[Scope]:
        """The cancel scopes that a task has entered inside ``outer``, the innermost first."""
        state = _scopes_of(task.task if isinstance(task, _Late) else task)
        scope = None if state is None else state.cancel_scope
        while scope is not None and scope is not outer:
            yield scope
            scope = scope._parent_scope

    def _start_eagerly(
        self, body: Coroutine[object, object, None], name: str, context: Context
    ) -> asyncio.Task[None]:
        """What ``eager_start=True`` does from Python 3.12 on.

        Before it, a new task asks its loop to call its first step soon; the loop's ``call_soon`` is
        shadowed for that moment, the step caught and run here, in the task's own context, as the
        current task.
        """
        loop = self._loop
        if sys.version_info >= (3, 12):
            return asyncio.Task(body, loop=loop, name=name, context=context, eager_start=True)
        else:
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

    def cancel(self, task: Cancelable, reason: str) -> None:
        """Cancel a task; the reason becomes the argument of its `asyncio.CancelledError`."""
        task.cancel(reason)  # type: ignore[call-arg]  # an asyncio.Task, or a `_Late`

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


class _Late:
    """A task that is started in the loop's next turn.

    Attributes:
        task: The task, once it is there.
    """

    def __init__(
        self, start: Callable[[], asyncio.Task[None]], loop: asyncio.AbstractEventLoop
    ) -> None:
        self.task: asyncio.Task[None] | None = None
        self._start = start
        self._is_canceled = False
        loop.call_soon(self._begin)

    def cancel(self, reason: str | None = None) -> None:
        """Let a cancellation arrive at the coroutine's next await, not before its first step."""
        self._is_canceled = True
        if self.task is not None:
            self.task.cancel(reason)

    def _begin(self) -> None:
        self.task = self._start()
        if self._is_canceled:
            self.task.cancel()


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
