"""Tasks and wake-ups, on asyncio (uvloop too) and on trio.

The few things for which anyio's own cost too much to spend one on each goal or message. Nothing
here knows what a goal is.

- `Tasks.spawn` runs a coroutine in a task that no task group holds. Its caller owns the task,
  cancels it and waits for its end.
- A `Signal` wakes all that wait for it when it fires; it does not remember earlier fires.
- `asyncio.Task.cancel` breaks into anyio's shields, a scope of trio does not. Ask
  `Tasks.is_shielded` first where that matters.
"""

from __future__ import annotations

from turtleact.tasks.background import Background, current_tasks, wait_while
from turtleact.tasks.base import GRACE, Signal, Tasks, is_cancellation
from turtleact.tasks.home import Home
from turtleact.tasks.idle import idleness, new_event_loop, wait_until_idle

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
    "wait_until_idle",
    "wait_while",
]
