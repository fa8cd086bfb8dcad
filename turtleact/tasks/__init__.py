"""Runs and wakes tasks, on asyncio (uvloop too) and trio.

This package exists because anyio's tools are too slow to use once per goal or message. It knows
nothing about goals.

- `Tasks.spawn` runs a coroutine in a task outside any task group. The caller owns the task, cancels
  it if necessary, and waits for its end.
- When a `Signal` fires, it wakes all tasks that wait for it. A task that begins to wait later waits
  until the signal fires again.
- On asyncio, `asyncio.Task.cancel` ignores anyio's shielded scopes. On trio, cancellation respects
  shielded scopes. To respect shields on both, call `Tasks.is_shielded` before you cancel a task.
"""

from __future__ import annotations

from turtleact.tasks.background import (
    GRACE,
    Background,
    LoopGuard,
    opening,
    run_in_daemon,
    wait_while,
)
from turtleact.tasks.clock import thread_work, wait_until_idle
from turtleact.tasks.event_loops import Signal, Task, Tasks, current_tasks, is_cancellation

__all__ = [
    "GRACE",
    "Background",
    "LoopGuard",
    "Signal",
    "Task",
    "Tasks",
    "current_tasks",
    "is_cancellation",
    "opening",
    "run_in_daemon",
    "thread_work",
    "wait_until_idle",
    "wait_while",
]
