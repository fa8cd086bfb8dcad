"""A coroutine that runs beside its owner."""

from __future__ import annotations

import logging
from collections.abc import Coroutine

import anyio

from turtleact.tasks.base import Tasks
from turtleact.tasks.current import current_tasks

__all__ = ["Background"]

logger = logging.getLogger("turtleact")


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
