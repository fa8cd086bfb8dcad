"""Tasks and wake-ups, on asyncio (uvloop too) and on trio.

The few things for which anyio's own are too dear to spend one on each goal or message. A goal's
body runs in a *bare* task: no task group holds it, the action server that started it does, and
must cancel it and wait for its end. Nothing here knows what a goal is.

Order and cancellation:

- `Tasks.spawn` runs the first step of a coroutine at once where the loop can do that (asyncio),
  else soon (trio); the coroutine handles its own exceptions.
- A `Signal` wakes all that wait for it when it fires; it keeps no memory of earlier fires.
- ``Task.cancel()`` of asyncio breaks into anyio's shields, a scope of trio does not. Whoever wants
  the same of both asks for the `Tasks.scopes` first.
"""

from __future__ import annotations

from turtleact.tasks.background import Background
from turtleact.tasks.base import (
    DEEPEST,
    GRACE,
    Scope,
    Signal,
    Tasks,
    is_cancellation,
)
from turtleact.tasks.current import current_tasks
from turtleact.tasks.home import Home
from turtleact.tasks.idle import idleness, new_event_loop, wait_until_idle
from turtleact.tasks.waiting import wait_while

__all__ = [
    "DEEPEST",
    "GRACE",
    "Background",
    "Home",
    "Scope",
    "Signal",
    "Tasks",
    "current_tasks",
    "idleness",
    "is_cancellation",
    "new_event_loop",
    "wait_until_idle",
    "wait_while",
]
