"""Functions that block a thread until something has happened, while another thread spins."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from turtleact.rclpy.impl.diagnosis import BLOCKED_AFTER, warn_if_blocked
from turtleact.rclpy.impl.entity import Entity

__all__ = ["wait_for_answer", "wait_until"]

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
