"""Calls the user's callbacks, which decide whether to accept a goal and whether to cancel a goal.

A callback is a function or a coroutine function. If a callback fails, the request is rejected and
the failure is logged.
"""

from __future__ import annotations

import logging
from inspect import isawaitable

import anyio

from turtleact.errors import GoalRejected, Reject
from turtleact.goals.body import ServerOptions
from turtleact.goals.state import CancelResponse, GoalResponse
from turtleact.summaries import loggable, summary, text_of
from turtleact.tasks import Tasks

__all__ = ["Callbacks"]

logger = logging.getLogger("turtleact.server")


class Callbacks:
    """Calls the callbacks of one server. `close` cancels the calls that have not returned yet.

    Args:
        server: The action's name.
        options: The server's options, with ``goal_callback`` and ``cancel_callback``.
        tasks: The functions for tasks on the event loop, asyncio or trio. This class uses them to
            find out whether the task that awaits a callback was cancelled.

    Attributes:
        ask_about_goals: Whether there is a ``goal_callback``.
        ask_about_cancels: Whether there is a ``cancel_callback``. If there is no
            ``cancel_callback``, every cancel request is accepted.
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
        """Ask the ``goal_callback`` whether to accept a goal. ``request`` is the goal message.

        Raises:
            GoalRejected: if the goal is rejected.
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
        """Ask the ``cancel_callback`` whether to cancel a goal.

        ``handle`` is the goal's `turtleact.ServerGoalHandle`.
        """
        if self._cancel_callback is None:
            return True
        try:
            answer = await self._answer(self._cancel_callback(handle))
        except Exception as error:
            problem = "the cancel_callback of %s failed; the goal continues"
            logger.error(problem, self._server, exc_info=loggable(error))
            return False
        return answer is CancelResponse.ACCEPT

    def close(self) -> None:
        """Cancel the callbacks that have not returned yet. Later calls are cancelled at once."""
        self._is_closed = True
        for scope in tuple(self._open):
            scope.cancel()

    async def _answer(self, given: object) -> object:
        """Return the callback's answer; await the answer if it is awaitable."""
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
                # Nobody cancelled the caller. The callback awaited a task that was cancelled, which
                # is a failure of the callback.
                raise RuntimeError("it waited for something that was canceled") from None
            finally:
                self._open.remove(scope)
        return _CLOSED


_CLOSED = object()
