"""Tasks and wake-ups on asyncio (uvloop too) and trio.

These few tools exist because anyio's tools are too slow to use once per goal or message. Nothing
here knows what a goal is.

- `Tasks.spawn` runs a coroutine in a task outside any task group. The caller owns the task, cancels
  it and waits for its end.
- Firing a `Signal` wakes every task that waits for it. A signal does not remember earlier fires.
- `asyncio.Task.cancel` breaks into anyio's shields, unlike a cancel scope of trio. Where shields
  matter, ask `Tasks.is_shielded` first.
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
