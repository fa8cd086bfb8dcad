"""Runs coroutines in tasks, runs functions in daemon threads, and waits with a time limit."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from threading import Thread
from typing import TypeVar

import anyio

from turtleact.tasks.base import Signal, Tasks
from turtleact.tasks.on_asyncio import AsyncioTasks
from turtleact.tasks.on_trio import TrioTasks

__all__ = ["Background", "current_tasks", "run_in_daemon", "wait_while"]

logger = logging.getLogger("turtleact")

T = TypeVar("T")


def current_tasks() -> Tasks:
    """Return the task functions for the running event loop."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return AsyncioTasks()
    return TrioTasks()


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
