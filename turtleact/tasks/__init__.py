"""Runs and wakes tasks, on asyncio (uvloop too) and trio.

This package exists because anyio's tools are too slow to use once per goal or message. It knows
nothing about goals.

- `Tasks.spawn` runs a coroutine in a task outside any task group. The caller owns the task, cancels
  it if necessary, and waits for its end.
- When a `Signal` fires, it wakes all tasks that wait for it. A task that begins to wait later waits
  until the signal fires again.
- `asyncio.Task.cancel` cancels a task even inside a shielded scope of anyio, unlike trio's cancel
  scopes. To respect shields, call `Tasks.is_shielded` before you cancel a task.
"""

from __future__ import annotations

from turtleact.tasks.background import Background, current_tasks, run_in_daemon, wait_while
from turtleact.tasks.base import GRACE, Home, Signal, Tasks, is_cancellation
from turtleact.tasks.idle import (
    idleness,
    new_event_loop,
    thread_work,
    wait_until_idle,
)

__all__ = [
    "GRACE",
    "Background",
    "Home",
    "Signal",
    "Tasks",
    "current_tasks",
    "idleness",
    "is_cancellation",
    "new_event_loop",
    "run_in_daemon",
    "thread_work",
    "wait_until_idle",
    "wait_while",
]
