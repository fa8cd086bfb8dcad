"""Functions that block a thread until something has happened, while another thread spins."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from turtleact.rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from turtleact.rclpy.impl.entity import Entity
from turtleact.rclpy.impl.rcutils_logger import RcutilsLogger
from turtleact.rclpy.impl.typing import Anything

__all__ = ["BLOCKED_AFTER", "note_blocked", "wait_for_answer", "wait_until", "warn_if_blocked"]

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


def _holder(entity: Entity) -> Anything:
    group = entity.callback_group
    return group.active_entity if isinstance(group, MutuallyExclusiveCallbackGroup) else None


POLL = 0.02
"""The interval at which a wait checks its condition (s)."""

PATIENCE = 0.5
"""The longest wait between two checks (s), because a signal cannot always interrupt a wait."""


def wait_until(
    is_there: Callable[[], bool], timeout: float | None, is_ok: Callable[[], bool]
) -> bool:
    """Check again and again until a condition is true. Return whether it became true.

    Args:
        is_there: The condition.
        timeout: How long to check (s). None means for ever.
        is_ok: Returns whether to continue the wait.
    """
    end = None if timeout is None else time.monotonic() + timeout
    while is_ok() and not is_there():
        left = POLL if end is None else min(POLL, end - time.monotonic())
        if left <= 0:
            break
        time.sleep(left)
    return is_there()


def wait_for_answer(
    entity: Entity,
    what: str,
    answered: threading.Event,
    is_ok: Callable[[], bool],
    timeout: float | None = None,
) -> bool:
    """Wait until an answer has been handled. Return False if the wait ended before that.

    If the wait takes long, a warning names the callback that prevents the answer from being
    handled.

    Args:
        entity: The entity that handles the answer.
        what: The name of the waiting function, for the warning.
        answered: An event that is set when the answer has been handled.
        is_ok: Returns whether to continue the wait.
        timeout: How long to wait (s). None or a negative number means for ever.
    """
    began = time.monotonic()
    end = None if timeout is None or timeout < 0 else began + timeout
    has_warned = False
    while is_ok():
        left = PATIENCE if end is None else min(PATIENCE, end - time.monotonic())
        if answered.wait(max(0.0, left)):
            return True
        if end is not None and time.monotonic() >= end:
            return False
        if not has_warned and time.monotonic() - began >= BLOCKED_AFTER:
            has_warned = True
            warn_if_blocked(entity, what, is_answered=entity.is_ready_now())
    return False
