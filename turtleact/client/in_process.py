# ruff: noqa: D102
"""A server in this process, until it implements `turtleact.goal_server.GoalServer` itself."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, cast

from turtleact.goal import Goal, GoalStatus
from turtleact.goal_server import GoalOrder
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import Signal

__all__ = ["InProcess"]


class InProcess:
    """Adapts an `ActionServer` whose methods are ``begin``, ``take`` and ``call``."""

    def __init__(self, server: Any) -> None:  # noqa: ANN401
        self.server = server
        self.signal: Callable[[Goal], Signal] = server.signal
        self.from_anywhere: Callable[[Callable[[], object]], None] = server.from_anywhere
        self.name_goal: Callable[[Goal], bytes] = server.name_goal
        self.client_lost: Callable[[object], None] = server.client_lost
        self.cancel_goal_nowait: Callable[[Goal], None] = server.cancel_nowait

    @property
    def is_open(self) -> bool:
        return cast("bool", self.server.is_open)

    async def send_goal(self, order: GoalOrder) -> Goal:
        parts = order.request, order.goal_id, order.on_feedback, order.sender
        goal = self.server.begin(*parts)
        return cast("Goal", await self.server.take(*parts) if goal is None else goal)

    async def run_goal(self, order: GoalOrder) -> Goal:
        parts = order.request, order.goal_id, order.on_feedback, order.sender
        result = await _Steps(self.server.call(*parts))
        return Goal(None, 0, GoalStatus.SUCCEEDED, result=result)

    async def attach(self, goal_id: bytes) -> Goal | None:
        return cast("Goal | None", await self.server.attach(goal_id))

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        return cast("CancelGoal.Response", await self.server.cancel(goal_id, stamp))

    async def cancel_goal(self, goal: Goal) -> CancelGoal.Response:
        return cast("CancelGoal.Response", await self.server.cancel_goal(goal))

    async def wait_for_end(self, goal: Goal) -> None:
        await self.server.wait_for_end(goal)


class _Steps:
    def __init__(self, steps: Generator[object, object, object]) -> None:
        self._steps = steps

    def __await__(self) -> Generator[object, object, object]:
        return self._steps
