"""Explains why a program hangs: which callback keeps another one from running.

In rclpy, a callback can wait for something that only another callback of the same group can do.
Such a wait never ends. turtleact does not interrupt it, but logs the names of both callbacks after
two seconds.
"""

from __future__ import annotations

import time

from turtleact.rclpy.callback_groups import Member, MutuallyExclusiveCallbackGroup
from turtleact.rclpy.impl.entity import Entity
from turtleact.rclpy.impl.rcutils_logger import RcutilsLogger

__all__ = ["BLOCKED_AFTER", "note_blocked", "warn_if_blocked"]

logger = RcutilsLogger("rclpy")

BLOCKED_AFTER = 2.0
"""How long a callback waits for its callback group before it is reported (s)."""

REPORTED = -1.0
"""The value of `Entity.blocked_since` for an entity that was reported."""

HINT = "give one of them a ReentrantCallbackGroup or a MutuallyExclusiveCallbackGroup of its own"


def note_blocked(entity: Entity) -> None:
    """Record that an entity waits for its callback group. Warn once if the wait lasts too long."""
    if entity.blocked_since == REPORTED:
        return
    now = time.monotonic()
    if not entity.blocked_since:
        entity.blocked_since = now
    elif now - entity.blocked_since >= BLOCKED_AFTER:
        entity.blocked_since = REPORTED
        holder = _holder(entity)
        if holder is not None:
            logger.warning(
                f"{entity.describe()} has waited for {BLOCKED_AFTER:g} s: its callback group is "
                f"held by {holder.describe()}, whose callback has not ended; {HINT}"
            )


def warn_if_blocked(entity: Entity, what: str, *, is_answered: bool) -> None:
    """Warn that a function waits for a callback that cannot run.

    Args:
        entity: The entity that has the callback.
        what: The name of the waiting function.
        is_answered: Whether the response that the callback handles has arrived. If the response has
            not arrived, no warning is logged.
    """
    if not is_answered:
        return
    holder = _holder(entity)
    if holder is not None:
        logger.warning(
            f"{what} has waited for {BLOCKED_AFTER:g} s: the response is there, but the callback "
            f"group of {entity.describe()} is held by {holder.describe()}; {HINT}"
        )
    else:
        logger.warning(
            f"{what} has waited for {BLOCKED_AFTER:g} s: the response is there, but nobody spins "
            "the node; spin it in another thread, or with a MultiThreadedExecutor"
        )


def _holder(entity: Entity) -> Member | None:
    group = entity.callback_group
    return group.active_entity if isinstance(group, MutuallyExclusiveCallbackGroup) else None
