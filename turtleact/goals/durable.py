"""Records an action server's goals in a journal, and continues them after a restart.

A server with a journal accepts a goal only after the goal is on disk, and announces a goal's end
only after the end is on disk. It publishes feedback after the feedback has been written. If the
disk is full, it publishes feedback that is not on disk yet, so that the goal can continue. The
journal keeps the order of these changes.

Sources: Temporal, where a retried activity gets the details of its last heartbeat; DBOS, where a
workflow's id makes a repeated call harmless.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import cast

import anyio

from turtleact.errors import GoalRejected, InvalidMessage, TurtleactError
from turtleact.goals.records import GoalChange, GoalJournal, GoalRecord, OnRestart, Resumed
from turtleact.goals.state import Goal, GoalEvent, GoalStatus
from turtleact.interfaces import Action, Message, WireFormat, type_hash
from turtleact.summaries import encodable

__all__ = ["DurableGoals"]

_STATUS_AFTER = {
    GoalEvent.SUCCEED: GoalStatus.SUCCEEDED,
    GoalEvent.ABORT: GoalStatus.ABORTED,
    GoalEvent.CANCELED: GoalStatus.CANCELED,
}


class DurableGoals:
    """Records the goals of one server in a journal, and restores them.

    Args:
        journal: The journal.
        action_type: The class of the action.
        name: The fully qualified name of the action.
        on_restart: What to do with goals that an earlier process has left unfinished.
        result_timeout: How long results are kept (s). If None, there is no limit.

    Attributes:
        resumes: Whether unfinished goals continue after a restart.
        is_built_in: Whether the action is built into turtleact. turtleact withdraws a built-in
            action when another server for an action of the same name opens.
        restored: An event that is set when the server holds the goals of the earlier process again.
    """

    def __init__(
        self,
        journal: GoalJournal,
        action_type: type[Action],
        name: str,
        on_restart: OnRestart,
        result_timeout: float | None,
    ) -> None:
        self.resumes = on_restart == "resume"
        self.is_built_in = False
        self.restored = anyio.Event()
        self._journal = journal
        self._action_type = action_type
        self._type_hash = type_hash(action_type)
        self._name = name
        self._keep_ns = None if result_timeout is None else round(result_timeout * 1e9)
        self._goals = WireFormat(action_type.Goal)
        self._feedback = WireFormat(action_type.Feedback)
        self._results = WireFormat(action_type.Result)

    @property
    def suspends(self) -> bool:
        """Whether goals stay unfinished when the server closes, and continue after a restart."""
        return self.resumes and not self._journal.aborts_at_close

    # accepting

    async def accept(self, goal: Goal, status: GoalStatus) -> GoalRecord | None:
        """Write a new goal to disk.

        If the journal has a goal with this id already, return that goal's record instead.

        ``status`` is EXECUTING if the goal starts at once, and ACCEPTED if it may have to wait.

        Cancelling: takes effect only when the goal has been written.

        Raises:
            GoalRejected: if the journal cannot write the goal.
        """
        sender = goal.sender if isinstance(goal.sender, bytes) else b""
        record = GoalRecord(
            id=self._id(goal),
            action=self._name,
            type_name=self._action_type.type_name,
            type_hash=self._type_hash,
            request=self._goals.encode(goal.request),
            stamp=goal.stamp,
            accepted=time.time_ns(),
            status=status,
            is_built_in=self.is_built_in,
            is_nested=goal.parent is not None,
            sender=sender,
        )
        try:
            with anyio.CancelScope(shield=True):
                known = await self._journal.accept(record)
        except TurtleactError as error:
            raise GoalRejected(f"the journal cannot take it: {error}") from error
        return known

    async def withdraw(self, goal: Goal) -> None:
        """Remove the record of a goal that was rejected after the record had been written."""
        with anyio.CancelScope(shield=True):
            await self._journal.withdraw(self._id(goal))

    def is_same(self, goal: Goal, request: object) -> bool:
        """Whether ``request`` equals the goal message with which a goal was sent."""
        known = goal.request
        return known is not None and self._goals.encode(known) == self._goals.encode(request)

    # while it runs

    def moved(self, goal: Goal) -> None:
        """Record a goal's new state."""
        self._journal.progress(self._id(goal), GoalChange(status=goal.status))

    def feedback(self, goal: Goal, message: Message, publish: Callable[[], object]) -> None:
        """Record feedback, and publish it after it has been written.

        If the disk is full, the feedback is published although it is not on disk yet.
        """
        change = GoalChange(feedback=self._feedback.encode(message), crashes=0)
        self._journal.progress(self._id(goal), change, publish)

    def partial_result(self, goal: Goal) -> None:
        """Record a goal's partial result."""
        change = GoalChange(partial_result=self._results.encode(goal.result))
        self._journal.progress(self._id(goal), change)

    def paused(self, goal: Goal) -> None:
        """Record that a goal was paused or resumed."""
        self._journal.progress(self._id(goal), GoalChange(is_paused=goal.is_paused))

    async def written(self) -> None:
        """Wait until everything recorded so far is written."""
        await self._journal.written()

    def end(
        self, goal: Goal, event: GoalEvent, reason: str, announce: Callable[[], object]
    ) -> None:
        """Record a goal's end, and announce the end after it has been written to disk."""
        now = time.time_ns()
        change = GoalChange(
            status=_STATUS_AFTER[event],
            result=self._results.encode(goal.result),
            reason=encodable(reason),
            ended=now,
            expires=0 if self._keep_ns is None else now + self._keep_ns,
        )
        self._journal.end(self._id(goal), change, announce)

    async def stop(self, goals: list[Goal]) -> None:
        """Record that an orderly shutdown of the server, not a crash, interrupts these goals."""
        for goal in goals:
            self._journal.progress(self._id(goal), GoalChange(is_stopped=True))
        with anyio.CancelScope(shield=True):
            await self._journal.written()

    # after a restart

    def load(self) -> list[GoalRecord]:
        """Return the journal's records with this action's name.

        The types in the records may differ, because actions of different types may share a name. A
        built-in action and a user's action of the same name do not get each other's records.
        """
        found = self._journal.load(self._name)
        return [record for record in found if record.is_built_in == self.is_built_in]

    def owns(self, record: GoalRecord) -> bool:
        """Whether a record has the name and the type of this action."""
        names = (record.action, record.type_name)
        return names == (self._name, self._action_type.type_name)

    def ended(self, record: GoalRecord, now: int) -> Goal:
        """Return an ended goal, restored from its record.

        ``now`` is the current time by the graph's clock (ns since the epoch).
        """
        # The graph's clock may be virtual and start anew, so the wall clock tells how long ago the
        # goal ended. That clock may have been set back.
        ago = max(0, time.time_ns() - record.ended)
        goal = self._goal(record)
        goal.result = self._decode(self._results, record, record.result)
        if goal.result is None:
            goal.result = self._action_type.Result()
        goal.status, goal.reason = record.status, record.reason
        goal.ended, goal.is_decided = max(1, now - ago), True
        return goal

    def unfinished(self, record: GoalRecord) -> Goal:
        """Restore an unfinished goal, its last feedback and its partial result from ``record``."""
        goal = self._goal(record)
        feedback = self._decode(self._feedback, record, record.feedback)
        partial_result = self._decode(self._results, record, record.partial_result)
        goal.resumed = Resumed(feedback, partial_result)
        goal.last_feedback, goal.result = feedback, partial_result
        goal.is_streamed = True  # for a client that comes back a little later
        return goal

    def why_not_resumed(self, record: GoalRecord) -> str:
        """Return why an unfinished goal cannot continue; empty if it can."""
        limit, crashes = self._journal.max_starts, self._crashes(record)
        if record.status is GoalStatus.CANCELING:
            return "it was being canceled"
        if record.type_hash != self._type_hash:
            return f"the type {record.type_name} has changed since the goal was accepted"
        if record.is_nested:
            return "its parent starts it again"
        if not self.resumes:
            return "its server was restarted"
        if limit is not None and crashes >= limit:
            return f"its server has crashed {crashes} times since its newest feedback"
        return ""

    def restart(self, record: GoalRecord, start: Callable[[], object]) -> None:
        """Record that a goal starts again, then start it.

        The record is written first, so that a start that crashes the process is counted.
        """
        change = GoalChange(crashes=self._crashes(record), is_stopped=False)
        self._journal.progress(record.id, change, start)

    def _crashes(self, record: GoalRecord) -> int:
        has_crashed = record.status is GoalStatus.EXECUTING and not record.is_stopped
        return record.crashes + has_crashed

    def _goal(self, record: GoalRecord) -> Goal:
        request = self._decode(self._goals, record, record.request)
        return Goal(request, record.stamp, id=record.id, sender=record.sender or None)

    def _decode(self, format: WireFormat, record: GoalRecord, data: bytes) -> Message | None:
        """Decode a recorded message; None if there is no message, or if its type has changed."""
        if not data or record.type_hash != self._type_hash:
            return None
        try:
            return format.decode(data)
        except InvalidMessage:  # the file was changed by something else
            return None

    @staticmethod
    def _id(goal: Goal) -> bytes:
        return cast("bytes", goal.id)  # every goal of a server with a journal has one
