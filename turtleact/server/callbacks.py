"""What a server asks its user: whether to take a goal, and whether to cancel one.

A callback is a function or a coroutine function. One that fails means no, and is logged.
"""

from __future__ import annotations

import logging
from inspect import isawaitable

import anyio

from turtleact.body import ServerOptions
from turtleact.errors import GoalRejected, Reject
from turtleact.goal import CancelResponse, GoalResponse
from turtleact.summaries import loggable, summary, text_of
from turtleact.tasks import Tasks

__all__ = ["Callbacks"]

logger = logging.getLogger("turtleact.server")


class Callbacks:
    """The callbacks of one server; closing it ends the calls that have not answered yet.

    Args:
        server: The action's name.
        options: The user's ``goal_callback`` and ``cancel_callback`` are among them.
        tasks: Knows whether a cancellation is that of the caller.

    Attributes:
        ask_about_goals: Whether there is a ``goal_callback``.
        ask_about_cancels: Whether there is a ``cancel_callback``; without one, all are agreed to.
    """

    def __init__(self, server: str, options: ServerOptions, tasks: Tasks) -> None:
        self._server = server
        self._goal_callback = options.get("goal_callback")
        self._cancel_callback = options.get("cancel_callback")
        self._tasks = tasks
        self._open: set[anyio.CancelScope] = set()
        self._is_closed = False
        self.ask_about_goals = self._goal_callback is not None
        self.ask_about_cancels = self._cancel_callback is not None

    async def may_start(self, request: object) -> None:
        """Put a goal message to the ``goal_callback``.

        Raises:
            GoalRejected: if the goal is not taken.
        """
        if self._goal_callback is None:
            return
        try:
            answer = await self._answer(self._goal_callback(request))
        except Reject as verdict:
            raise GoalRejected(text_of(verdict.reason)) from None
        except Exception as error:
            problem = "the goal_callback of %s failed; the goal is rejected"
            logger.error(problem, self._server, exc_info=loggable(error))
            raise GoalRejected(f"the goal_callback failed: {summary(error)}") from None
        if answer is GoalResponse.ACCEPT:
            return
        if answer is GoalResponse.REJECT:
            raise GoalRejected("the goal_callback rejected it")
        if answer is _CLOSED:
            raise GoalRejected(f"the server of '{self._server}' is shutting down")
        raise GoalRejected(f"the goal_callback answered {answer!r}, not a GoalResponse")

    async def may_cancel(self, handle: object) -> bool:
        """Put a goal, by its `turtleact.ServerGoalHandle`, to the ``cancel_callback``."""
        if self._cancel_callback is None:
            return True
        try:
            answer = await self._answer(self._cancel_callback(handle))
        except Exception as error:
            problem = "the cancel_callback of %s failed; the goal goes on"
            logger.error(problem, self._server, exc_info=loggable(error))
            return False
        return answer is CancelResponse.ACCEPT

    def close(self) -> None:
        """Cancel the callbacks that have not answered yet, and wait for none from now on."""
        self._is_closed = True
        for scope in tuple(self._open):
            scope.cancel()

    async def _answer(self, given: object) -> object:
        """Wait for the answer of a coroutine; that of a function is there already."""
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
                # The callback waited for a task that somebody else has cancelled: its own failure.
                raise RuntimeError("it waited for something that was canceled") from None
            finally:
                self._open.remove(scope)
        return _CLOSED


_CLOSED = object()
