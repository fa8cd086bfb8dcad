"""Which goals are taken up, and where they wait: asked about, checked, held, given a place.

Who may run beside whom stands in `turtleact.slot`.

Source: rcl_action ``rcl_action_accept_new_goal``; `turtleact.slot` for the rest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextvars import copy_context
from functools import partial
from typing import cast

from turtleact.errors import GoalRejected
from turtleact.goal import Goal, GoalEvent, GoalStatus, GoalTable, OnFeedback
from turtleact.goal_id import new_goal_id
from turtleact.interfaces import Message, snapshotter
from turtleact.server.callbacks import GoalCallback, Questions
from turtleact.server.claim import Claim
from turtleact.server.execution import CURRENT_GOAL, Execution
from turtleact.server.hooks import Hooks
from turtleact.slot import Admission, Slot
from turtleact.tasks import Tasks

__all__ = ["Reception"]

_ACCEPTED = GoalStatus.ACCEPTED
_EXECUTING = GoalStatus.EXECUTING
_CANCELING = GoalStatus.CANCELING
_AT_ONCE = ((_EXECUTING, 0),)  # the history of a goal that did not wait to be started

IN_A_ROW = 64
"""So many goals are begun before others have their turn for sure."""


class Reception:
    """Takes up the goals of one server.

    Args:
        name: The action's name.
        goal_type: The class of the goal messages.
        goal_callback: Whom a goal is put to first, if anybody.
        keeps: Whether goals are kept whose client has gone.
        questions: Puts them.
        tasks: Lets others run.
        slot: Where goals have their places; None if they need none.
        table: Where goals are held.
        execution: Runs them.
        hooks: Told of each that is accepted.
        now: The time (ns since the epoch).

    Attributes:
        name: The action's name.
        check_goal: The checked copy of a goal message.
        slot: Where goals have their places.
        execution: What runs them.
        is_open: Whether it takes goals.
    """

    def __init__(
        self,
        name: str,
        goal_type: type[Message],
        *,
        goal_callback: GoalCallback | None,
        keeps: bool,
        questions: Questions,
        tasks: Tasks,
        slot: Slot[Claim] | None,
        table: GoalTable,
        execution: Execution,
        hooks: Hooks,
        now: Callable[[], int],
    ) -> None:
        self.name = name
        self.check_goal = cast("Callable[[object], Message]", snapshotter(goal_type, root="goal"))
        self.slot = slot
        self.execution = execution
        self.is_open = True
        self._goal_callback = goal_callback
        self._keeps = keeps
        self._questions = questions
        self._tasks = tasks
        self._until_turn = IN_A_ROW
        self._preparing: Counter[object] = Counter()  # how many goals, by their senders
        self._lost: set[object] = set()  # which of these have gone
        self._table = table
        self._hooks = hooks
        self._now = now
        if slot is not None:
            execution.release = self._release
            Execution.notes_parents = True

    def waits_first(self) -> bool:
        """Whether `prepare` is to be awaited before the next goal is admitted.

        So it is if there is a ``goal_callback``; and after `IN_A_ROW` goals, as some never wait.
        """
        self._until_turn -= 1
        return self._until_turn == 0 or self._goal_callback is not None

    async def prepare(self, request: object, sender: object) -> object:
        """Let others run, and put a goal to the ``goal_callback``; answer what is to be admitted.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if it is not taken; if its client has gone meanwhile, and its goals with
                it.
        """
        self._preparing[sender] += 1
        try:
            if self._until_turn <= 0:
                self._until_turn = IN_A_ROW
                await self._tasks.checkpoint()
            if self._goal_callback is not None:
                request = self.check_goal(request)
                await self._questions.may_start(self._goal_callback, request)
            if sender in self._lost or not (self._keeps or getattr(sender, "is_open", True)):
                raise GoalRejected("its client has gone")
            return request
        finally:
            self._preparing[sender] -= 1
            if not self._preparing[sender]:
                del self._preparing[sender]
                self._lost.discard(sender)

    def lose(self, sender: object) -> None:
        """Reject the goals of a client that has gone which are not admitted yet."""
        if sender in self._preparing:
            self._lost.add(sender)

    def admit(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
        *,
        is_streamed: bool = False,
    ) -> Goal:
        """Hold a goal; it is ACCEPTED if it has to wait, else EXECUTING, and to be started.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if it is not taken.
        """
        if not self.is_open:
            raise GoalRejected(f"the server of '{self.name}' is shutting down")
        if on_feedback is not None:  # in the sender's context, not in that of the body
            on_feedback = partial(copy_context().run, on_feedback)  # type: ignore[call-arg]
        goal = Goal(
            self.check_goal(request),
            self._now(),
            _EXECUTING,
            _AT_ONCE,
            goal_id,
            on_feedback,
            is_streamed,
            parent=CURRENT_GOAL.get(),
            sender=sender,
        )
        if not self._table.add(goal):
            raise GoalRejected(f"the server still holds a goal of the id {goal.hex}")
        execution, board = self.execution, self.execution.board
        shows_each = board is not None and board.shows_each
        if self.slot is not None or execution.watch is not None or shows_each:
            goal.status, goal.history = _ACCEPTED, ()
            self._enter(goal)
        elif board is not None:
            board.note(goal)
        return goal

    def name_goal(self, goal: Goal) -> bytes:
        """The id of a goal; it can be found by it from now on."""
        return goal.id or self._table.name(goal, new_goal_id(), self._now())

    def start_waiting(self, goal: Goal, claim: Claim) -> None:
        """Start a goal whose turn has come, unless it has ended meanwhile."""
        if goal.body is claim:
            goal.body = None
            self.execution.move(goal, GoalEvent.EXECUTE)
            self.execution.start(goal, claim.context)

    def evict(self, goal: Goal, reason: str) -> None:
        """Cancel a goal by the server's own decision, unless it is being canceled already."""
        if goal.status.is_active and not goal.reason and goal.status is not _CANCELING:
            goal.reason = reason
            if goal.body is not None:
                goal.body.cancel()

    def leave_slot(self) -> None:
        """Give places to nobody any more."""
        self.execution.release = self.slot = None

    def _enter(self, goal: Goal) -> None:
        """Give a goal its place, or a place to wait in."""
        claim = goal.body = Claim(self, goal)
        entry = None if self.slot is None else self.slot.enter(claim)
        if entry is not None and entry.admission is Admission.REJECT:
            self._table.forget(goal)
            raise GoalRejected(entry.reason)
        if self.execution.board is not None:
            self.execution.board.note(goal)
        if self._hooks:
            self._hooks.tell(goal, GoalStatus.UNKNOWN, _ACCEPTED)
        if goal.ended:  # a hook has canceled it
            return
        if entry is None or entry.admission is Admission.START:
            goal.body = None
            self.execution.move(goal, GoalEvent.EXECUTE)
            return
        for each in (entry.displaced, *entry.evicted):
            if each is not None:
                each.evict(entry.reason)

    def _release(self, goal: Goal) -> Callable[[], None] | None:
        """Give a goal's place to the next one; answer what starts that one."""
        slot = cast("Slot[Claim]", self.slot)
        following, overdue = slot.leave(goal), slot.overdue()
        if overdue is not None:
            for each in overdue.evicted:
                each.evict(overdue.reason)
        return None if following is None else following.start
