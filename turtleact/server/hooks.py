"""Hooks on the transitions of goals: what logs, metrics, journals and tests share."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import Any, TypeAlias

from turtleact.goal import Goal, GoalStatus
from turtleact.server.execution import CURRENT_GOAL, Execution
from turtleact.server.goal_handle import ServerGoalHandle
from turtleact.summaries import STOPS

__all__ = ["Hooks", "Transition"]

logger = logging.getLogger("turtleact.server")

Transition: TypeAlias = Callable[[ServerGoalHandle[Any, Any, Any], GoalStatus, GoalStatus], object]

Change: TypeAlias = tuple[ServerGoalHandle[Any, Any, Any], GoalStatus, GoalStatus]


class Hooks:
    """The hooks of one server; a server without any spends nothing on them.

    Args:
        name: The action's name, for logs.
        execution: Tells of all transitions but the first.
        make_handle: Makes what a hook is given.
    """

    def __init__(
        self,
        name: str,
        execution: Execution,
        make_handle: Callable[[Goal], ServerGoalHandle[Any, Any, Any]],
    ) -> None:
        self._name = name
        self._execution = execution
        self._make_handle = make_handle
        self._hooks: list[Transition] = []
        self._untold: deque[Change] = deque()

    def __bool__(self) -> bool:
        return bool(self._hooks)

    def add(self, hook: Transition) -> None:
        """Call ``hook(goal, old, new)`` at each change of a goal from now on."""
        self._hooks.append(hook)
        self._execution.watch = self.tell

    def remove(self, hook: Transition) -> None:
        """Call it no more."""
        self._hooks.remove(hook)
        if not self._hooks:
            self._execution.watch = None

    def tell(self, goal: Goal, old: GoalStatus, new: GoalStatus) -> None:
        """Call all hooks; what they raise is logged and does no harm."""
        self._untold.append((self._make_handle(goal), old, new))
        if len(self._untold) > 1:  # a hook has made the change, and others have yet to hear of the
            return  # one before: they are told below
        token = CURRENT_GOAL.set(None)  # what a hook sends is no child of the goal it hears of
        while self._untold:
            for hook in tuple(self._hooks):
                try:
                    hook(*self._untold[0])
                except STOPS:
                    self._untold.clear()
                    raise
                except BaseException:  # a cancellation too: nobody has canceled the hook
                    logger.exception("a hook on the transitions of %s failed", self._name)
            self._untold.popleft()
        CURRENT_GOAL.reset(token)
