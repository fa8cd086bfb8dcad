"""Which event loop runs now."""

from __future__ import annotations

import asyncio

import anyio

from turtleact.tasks.base import Tasks
from turtleact.tasks.on_asyncio import AsyncioTasks
from turtleact.tasks.on_trio import TrioTasks

__all__ = ["current_tasks"]


def current_tasks() -> Tasks:
    """The tasks of the event loop that runs now."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return AsyncioTasks()
    return TrioTasks()
