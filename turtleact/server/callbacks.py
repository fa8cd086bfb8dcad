"""What a server asks its user: whether to take a goal, and whether to cancel one.

A callback is a function or a coroutine function. One that fails means no, and is logged.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from inspect import isawaitable
from typing import TypeAlias

import anyio

from turtleact.errors import GoalRejected, Reject
from turtleact.goal import CancelResponse, GoalResponse
from turtleact.summaries import summary, text_of
from turtleact.tasks import Tasks

__all__ = ["CancelCallback", "GoalCallback", "Questions"]

logger = logging.getLogger("turtleact.server")

GoalCallback: TypeAlias = Callable[..., object]
CancelCallback: TypeAlias = Callable[..., object]


class Questions:
    """What a server asks its user; closing it ends the questions that are open.

    Args:
        server: The action's name.
        tasks: Knows whether a cancellation is that of the caller.
    """

    def __init__(self, server: str, tasks: Tasks) -> None:
        self._server = server
        self._tasks = tasks
        self._open: set[anyio.CancelScope] = set()
        self._is_closed = False

    async def may_start(self, callback: GoalCallback, request: object) -> None:
        """Put a goal message to a ``goal_callback``.

        Raises:
            GoalRejected: if the goal is not taken.
        """
        try:
            answer = await self._answer(callback(request))
        except Reject as verdict:
            raise GoalRejected(text_of(verdict.reason)) from None
        except Exception as error:
            logger.exception("the goal_callback of %s failed; the goal is rejected", self._server)
            raise GoalRejected(f"the goal_callback failed: {summary(error)}") from None
        if answer is GoalResponse.ACCEPT:
            return
        if answer is GoalResponse.REJECT:
            raise GoalRejected("the goal_callback rejected it")
        if answer is _CLOSED:
            raise GoalRejected(f"the server of '{self._server}' is shutting down")
        raise GoalRejected(f"the goal_callback answered {answer!r}, not a GoalResponse")

    async def may_cancel(self, callback: CancelCallback, handle: object) -> bool:
        """Put a goal, by its `turtleact.ServerGoalHandle`, to a ``cancel_callback``."""
        try:
            answer = await self._answer(callback(handle))
        except Exception:
            logger.exception("the cancel_callback of %s failed; the goal goes on", self._server)
            return False
        return answer is CancelResponse.ACCEPT

    def close(self) -> None:
        """Cancel the callbacks that have not answered yet, and wait for none from now on."""
        self._is_closed = True
        for scope in tuple(self._open):
            scope.cancel()

    async def _answer(self, given: object) -> object:
        if not isawaitable(given):
            return given
        with anyio.CancelScope() as scope:
            self._open.add(scope)
            if self._is_closed:
                scope.cancel()
            try:
                return await given
            except self._tasks.cancelled:
                if scope.cancel_called or self._tasks.is_canceled():
                    raise
                raise RuntimeError("it waited for something that was canceled") from None
            finally:
                self._open.remove(scope)
        return _CLOSED


_CLOSED = object()
