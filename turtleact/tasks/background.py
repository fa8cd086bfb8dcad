"""Coroutines that run beside their owner, and waiting for what is being ended."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine

import anyio

from turtleact.tasks.base import Signal, Tasks
from turtleact.tasks.on_asyncio import AsyncioTasks
from turtleact.tasks.on_trio import TrioTasks

__all__ = ["Background", "current_tasks", "wait_while"]

logger = logging.getLogger("turtleact")


def current_tasks() -> Tasks:
    """The tasks of the event loop that runs now."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return AsyncioTasks()
    return TrioTasks()


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

    def cancel(self) -> None:
        """Cancel it, without waiting for its end."""
        self._task.cancel()

    async def aclose(self, timeout: float | None = None) -> None:
        """Cancel it and wait for its end, ``timeout`` seconds at most (event loop time)."""
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


async def wait_while(is_busy: Callable[[], object], changed: Signal, patience: float) -> None:
    """Wait, shielded, until something is over, at most ``patience`` seconds (event loop time).

    What is over already costs next to nothing: thousands may be closed together.

    Args:
        is_busy: Whether it is not over yet.
        changed: Fires whenever it may be.
        patience: How long it is waited for (s).
    """
    if is_busy():
        with anyio.move_on_after(patience, shield=True):
            while is_busy():
                await changed.wait()
