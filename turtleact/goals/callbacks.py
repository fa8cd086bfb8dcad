"""Calls the user's callbacks, which decide whether to accept a goal and whether to cancel a goal.

A callback is a function or a coroutine function. If a callback fails, the request is rejected and
the failure is logged.
"""

from __future__ import annotations

import logging
from collections import Counter
from inspect import isawaitable
from typing import Any

import anyio
import msgspec

from turtleact.errors import GoalRejected, Reject, summary, text_of
from turtleact.goals.body import ServerOptions
from turtleact.goals.server import LocalActionServer
from turtleact.goals.state import CancelResponse, Goal, GoalRequest, GoalResponse

__all__ = ["Callbacks", "cancel_goals_of_lost_clients"]

logger = logging.getLogger("turtleact.server")


class Callbacks:
    """Calls the ``goal_callback`` and the ``cancel_callback`` of one server.

    When the server closes, the calls that have not returned yet are cancelled.

    Args:
        server: The server.
        options: The server's options, with ``goal_callback`` and ``cancel_callback``.
    """

    def __init__(self, server: LocalActionServer, options: ServerOptions) -> None:
        self._server = server
        self._goal_callback: Any = options.get("goal_callback")
        self._cancel_callback: Any = options.get("cancel_callback")
        self._open: set[anyio.CancelScope] = set()
        self._is_closed = False
        self._deciding: Counter[object] = Counter()  # goals not decided yet, counted by sender
        self._lost: set[object] = set()  # those of these senders that have gone
        if self._goal_callback is not None:
            server.admit = self.admit
            if options.get("on_client_lost") == "cancel":
                self._client_lost, server.client_lost = server.client_lost, self.client_lost
        if self._cancel_callback is not None:
            server.may_cancel = self.may_cancel
        self._aclose, server.aclose = server.aclose, self.aclose

    async def admit(self, request: GoalRequest) -> Goal:
        """Ask the ``goal_callback``, and accept the goal if the callback agrees.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if the goal is rejected, or its client has disconnected in the meantime.
        """
        return self._server.accept(await self.consider(request))

    async def consider(self, request: GoalRequest) -> GoalRequest:
        """Ask the ``goal_callback``, and return the checked request. The errors are as above."""
        message, sender = self._server.check_goal(request.message), request.sender
        self._deciding[sender] += 1
        try:
            await self._ask(message)
            if sender in self._lost:
                raise GoalRejected("its client has gone")
        finally:
            self._deciding[sender] -= 1
            if not self._deciding[sender]:
                del self._deciding[sender]
                self._lost.discard(sender)
        return msgspec.structs.replace(request, message=message)

    async def may_cancel(self, goal: Goal) -> bool:
        """Ask the ``cancel_callback`` whether to cancel a goal."""
        try:
            answer = await self._answer(self._cancel_callback(self._server.make_handle(goal)))
        except Exception as error:
            problem = "the cancel_callback of %s failed; the goal continues"
            logger.error(problem, self._server.name, exc_info=error)
            return False
        return answer is CancelResponse.ACCEPT

    def client_lost(self, sender: object) -> None:
        """Reject the goals of a client that is gone, if they are not decided yet."""
        if sender in self._deciding:
            self._lost.add(sender)
        self._client_lost(sender)

    async def aclose(self) -> None:
        """Cancel the callbacks that have not returned yet, and close the server."""
        self._server.is_open = False
        self._is_closed = True
        for scope in tuple(self._open):
            scope.cancel()
        await self._aclose()

    async def _ask(self, message: object) -> None:
        """Ask the ``goal_callback`` about a goal message; raise GoalRejected unless it agrees."""
        try:
            answer = await self._answer(self._goal_callback(message))
        except Reject as verdict:
            raise GoalRejected(text_of(verdict.reason)) from None
        except Exception as error:
            problem = "the goal_callback of %s failed; the goal is rejected"
            logger.error(problem, self._server.name, exc_info=error)
            raise GoalRejected(f"the goal_callback failed: {summary(error)}") from None
        if answer is GoalResponse.REJECT:
            raise GoalRejected("the goal_callback rejected it")
        if answer is _CLOSED:
            self._server.check_open()
        if answer is not GoalResponse.ACCEPT:
            raise GoalRejected(f"the goal_callback answered {answer!r}, not a GoalResponse")

    async def _answer(self, given: object) -> object:
        """Return the callback's answer; await the answer if it is awaitable."""
        if not isawaitable(given):
            return given
        tasks = self._server.tasks
        with anyio.CancelScope() as scope:
            self._open.add(scope)
            if self._is_closed:
                scope.cancel()
            try:
                return await given
            except tasks.cancelled:
                if scope.cancel_called or tasks.is_canceled():
                    raise
                # Nobody cancelled the caller. The callback awaited a task that was cancelled, which
                # is a failure of the callback.
                raise RuntimeError("it waited for something that was canceled") from None
            finally:
                self._open.remove(scope)
        return _CLOSED


_CLOSED = object()


def cancel_goals_of_lost_clients(server: LocalActionServer) -> None:
    """Let a server cancel the goals of clients that have gone."""

    def client_lost(sender: object) -> None:
        for goal in server.table.active:
            if goal.sender == sender:
                server.request_cancel(goal)

    server.client_lost = client_lost
