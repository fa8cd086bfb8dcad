"""How a server cancels goals: which ones a request means, and whether the user agrees.

Source: action_msgs/srv/CancelGoal; rcl_action ``rcl_action_process_cancel_request``.
"""

from __future__ import annotations

from collections.abc import Callable

from turtleact.goal import Goal, GoalEvent, GoalStatus, GoalTable, cancel_code, select
from turtleact.interfaces.standard import CancelGoal, GoalInfo
from turtleact.server.callbacks import CancelCallback, Questions
from turtleact.server.execution import Execution
from turtleact.tasks import GRACE, Background, Tasks

__all__ = ["Canceling"]


class Canceling:
    """Cancels the goals of one server.

    Args:
        name: The action's name.
        callback: The user's ``cancel_callback``; None agrees to every cancel.
        questions: Puts the goals to the callback.
        tasks: Runs what need not be waited for.
        table: The goals.
        execution: Runs them.
        make_handle: Makes what the callback is given.
        info: A goal's id and stamp, as sent.
    """

    def __init__(
        self,
        name: str,
        callback: CancelCallback | None,
        *,
        questions: Questions,
        tasks: Tasks,
        table: GoalTable,
        execution: Execution,
        make_handle: Callable[[Goal], object],
        info: Callable[[Goal], GoalInfo],
    ) -> None:
        self._name = name
        self._callback = callback
        self._questions = questions
        self._tasks = tasks
        self._table = table
        self._execution = execution
        self._make_handle = make_handle
        self._info = info
        self._under_way: dict[Goal, Background] = {}

    async def answer(self, goal_id: bytes | None, stamp: int, now: int) -> CancelGoal.Response:
        """Answer a request: by id, by stamp (ns), by both, or for every goal."""
        wanted = goal_id if goal_id and any(goal_id) else None
        named = self._table.find(wanted, now) if wanted else None
        by_id = wanted is not None and not stamp
        held = self._table.active if not by_id else [] if named is None else [named]
        canceled: list[Goal] = []
        kept: list[Goal] = []
        for goal in select(held, wanted, stamp):
            (canceled if await self.ask_and_cancel(goal) else kept).append(goal)
        asked = len(canceled) + sum(goal.status.is_active for goal in kept)
        code = cancel_code(named, by_id=by_id, asked=asked, let_go=len(canceled))
        return CancelGoal.Response(int(code), [self._info(goal) for goal in canceled])

    async def ask_and_cancel(self, goal: Goal) -> bool:
        """Cancel a goal if the user agrees; False if not, or if it has ended."""
        has_ended = not goal.status.is_active  # perhaps while the user was asked of another
        if has_ended or self._callback is None or goal.status is GoalStatus.CANCELING:
            return self.cancel(goal)
        agreed = await self._questions.may_cancel(self._callback, self._make_handle(goal))
        return agreed and self.cancel(goal)

    def cancel_nowait(self, goal: Goal) -> None:
        """The same without waiting for the user's answer, who is asked once at a time."""
        if self._callback is None:
            self.cancel(goal)
        elif goal.status.is_active and goal not in self._under_way:
            asking = Background(self._ask(goal), f"a cancel of {self._name}", self._tasks)
            if not asking.has_ended:
                self._under_way[goal] = asking

    def cancel(self, goal: Goal) -> bool:
        """Cancel a goal; False if it has ended before."""
        if not goal.status.is_active:
            return False
        if goal.status is not GoalStatus.CANCELING:
            self._execution.move(goal, GoalEvent.CANCEL_GOAL)
            if goal.body is not None and not goal.reason:  # else it has been canceled already
                goal.body.cancel()
        return True

    async def aclose(self) -> None:
        """Wait for no answer of the user any more."""
        for asking in list(self._under_way.values()):
            await asking.aclose(GRACE)

    async def _ask(self, goal: Goal) -> None:
        try:
            await self.ask_and_cancel(goal)
        finally:
            self._under_way.pop(goal, None)
