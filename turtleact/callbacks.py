"""What a server asks its user: whether to take a goal, and whether to cancel one.

A callback is a function or a coroutine function. One that fails means no, and is logged.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from inspect import isawaitable
from typing import TypeAlias

from turtleact.errors import GoalRejected, Reject
from turtleact.goal import CancelResponse, GoalResponse
from turtleact.summaries import summary, text_of

__all__ = ["CancelCallback", "GoalCallback", "ask_for_cancel", "ask_for_goal"]

logger = logging.getLogger("turtleact.server")

GoalCallback: TypeAlias = Callable[..., object]
CancelCallback: TypeAlias = Callable[..., object]


async def ask_for_goal(server: str, callback: GoalCallback, request: object) -> None:
    """Put a goal to a ``goal_callback``.

    Args:
        server: The action's name.
        callback: The callback.
        request: The goal message.

    Raises:
        GoalRejected: if the goal is not taken.
    """
    try:
        answer = callback(request)
        if isawaitable(answer):
            answer = await answer
    except Reject as verdict:
        raise GoalRejected(text_of(verdict.reason)) from None
    except Exception as error:
        logger.exception("the goal_callback of %s failed; the goal is rejected", server)
        raise GoalRejected(f"the goal_callback failed: {summary(error)}") from None
    if answer is GoalResponse.REJECT:
        raise GoalRejected("the goal_callback rejected it")
    if answer is not GoalResponse.ACCEPT:
        raise GoalRejected(f"the goal_callback answered {answer!r}, not a GoalResponse")


async def ask_for_cancel(server: str, callback: CancelCallback, handle: object) -> bool:
    """Put a goal that is to be canceled to a ``cancel_callback``; whether it agrees.

    Args:
        server: The action's name.
        callback: The callback.
        handle: The goal's `turtleact.ServerGoalHandle`.
    """
    try:
        answer = callback(handle)
        if isawaitable(answer):
            answer = await answer
    except Exception:
        logger.exception("the cancel_callback of %s failed; the goal goes on", server)
        return False
    return answer is CancelResponse.ACCEPT
