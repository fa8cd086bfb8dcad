"""Tools around tasks: background coroutines, daemon threads, waiting, and ``async with`` blocks."""

from __future__ import annotations

import asyncio
import copy
import logging
from collections.abc import AsyncIterator, Callable, Coroutine
from concurrent.futures import Future
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import wraps
from threading import Thread, get_ident
from typing import Any, NoReturn, ParamSpec, TypeVar

import anyio

from turtleact.errors import TurtleactError
from turtleact.tasks.event_loops import Signal, Tasks, current_tasks

__all__ = ["GRACE", "Background", "LoopGuard", "opening", "run_in_daemon", "wait_while"]

logger = logging.getLogger("turtleact")

P = ParamSpec("P")
T = TypeVar("T")

GRACE = 5.0
"""How long to wait by default for a cancelled task (s), before the task is left running."""


class Background:
    """Runs a coroutine in a task until the coroutine ends or the owner closes this object.

    If the coroutine fails, the exception is logged.

    Args:
        running: The coroutine.
        name: The coroutine's name in the log.
        tasks: The task functions to use. If left out, the task functions of the running event loop
            are used.

    Attributes:
        has_ended: Whether the coroutine has ended.
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

    def cancel(self) -> None:
        """Cancel the coroutine without waiting for its end."""
        self._task.cancel()

    async def aclose(self, timeout: float | None = None) -> None:
        """Cancel the coroutine, and wait for its end.

        The wait lasts at most ``timeout`` seconds (loop time); None means no limit.
        """
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


async def run_in_daemon(call: Callable[[], T], name: str) -> T:
    """Run a function in its own daemon thread, and return its result.

    The function may block for ever. The program can end while the daemon thread still runs, unlike
    with a thread of `anyio.to_thread`. Cancelling: safe; the function keeps running in its thread.

    Args:
        call: The function.
        name: The name of the thread.
    """
    tasks, outcome = current_tasks(), Future[T]()
    has_ended = tasks.signal()

    def run() -> None:
        try:
            outcome.set_result(call())
        except BaseException as error:
            outcome.set_exception(error)
        tasks.from_anywhere(has_ended.fire)

    Thread(target=run, name=name, daemon=True).start()
    while not outcome.done():
        await has_ended.wait()
    return outcome.result()


async def wait_while(is_busy: Callable[[], object], changed: Signal, patience: float) -> None:
    """Wait as long as ``is_busy()`` is true. The wait is shielded from cancellation.

    If ``is_busy()`` is false at once, the call costs almost nothing. The low cost matters when
    thousands of objects are closed together.

    Args:
        is_busy: A function that returns whether to keep waiting.
        changed: A signal that fires when the result of ``is_busy`` may have changed.
        patience: The longest wait (s, loop time).
    """
    if is_busy():
        with anyio.move_on_after(patience, shield=True):
            while is_busy():
                await changed.wait()


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


def opening(function: Callable[P, AsyncIterator[T]]) -> Callable[P, AbstractAsyncContextManager[T]]:
    """Make a function that opens a resource for an ``async with`` block, such as `open_node`.

    `opening` works like `contextlib.asynccontextmanager`. In addition, if the user writes ``with``,
    ``await`` or no keyword at all in place of ``async with``, the error says what to write. Without
    `opening`, Python's error would name an internal class of `contextlib`. Type checkers see an
    `AbstractAsyncContextManager`, so they find these mistakes themselves.

    Args:
        function: An async generator function that yields the resource once.
    """
    manager = asynccontextmanager(function)

    @wraps(function)
    def open_it(*args: P.args, **kwargs: P.kwargs) -> AbstractAsyncContextManager[T]:
        return _Opening(manager(*args, **kwargs), f"{function.__name__}(…)")

    return open_it


class _Opening(AbstractAsyncContextManager[T]):
    """Opens a resource at the start of an ``async with`` block, and closes the resource at the end.

    Args:
        manager: The context manager that opens and closes the resource.
        call: The call that made this object, for error messages.
    """

    def __init__(self, manager: AbstractAsyncContextManager[T, bool | None], call: str) -> None:
        self._manager = manager
        self._call = call
        self._advice = f"write 'async with {call} as …:'"

    async def __aenter__(self) -> T:
        return await self._manager.__aenter__()

    async def __aexit__(self, *raised: Any) -> bool | None:  # noqa: ANN401  # kind, error, trace
        return await self._manager.__aexit__(*raised)

    def __enter__(self) -> NoReturn:
        raise TypeError(f"'async' is missing: {self._advice}")

    def __exit__(self, *_: object) -> None:
        """Do nothing.

        A ``with`` statement needs ``__exit__``. Without this method, the statement would fail
        before it calls ``__enter__``, which raises the error that helps the user.
        """

    def __await__(self) -> NoReturn:
        raise TypeError(f"{self._call} cannot be awaited: {self._advice}")

    def __getattr__(self, name: str) -> NoReturn:
        # Private names belong to Python. `copy.copy`, for example, asks for ``__setstate__`` before
        # the copy has any attribute that this method could read.
        if name.startswith("_"):
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        raise AttributeError(f"{self._call} is not open yet and has no '{name}': {self._advice}")
