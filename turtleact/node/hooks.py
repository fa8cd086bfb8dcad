"""Users' hooks on the transitions of goals, as observers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from turtleact.goal import CURRENT_GOAL, Goal, GoalStatus
from turtleact.observers import GoalObserver
from turtleact.server.execution import Execution

__all__ = ["Hook"]


class Hook(GoalObserver):
    """Calls a user's hook at each change of a goal.

    Args:
        hook: The hook.
        execution: Makes the handle that the hook gets.
    """

    def __init__(
        self, hook: Callable[[Any, GoalStatus, GoalStatus], object], execution: Execution
    ) -> None:
        self._hook = hook
        self._execution = execution

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Call the hook."""
        # Without a current goal, a goal that the hook sends does not become a child of this one.
        token = CURRENT_GOAL.set(None)
        try:
            self._hook(self._execution.make_handle(goal), before, after)
        finally:
            CURRENT_GOAL.reset(token)
