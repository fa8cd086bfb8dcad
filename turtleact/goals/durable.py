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
from collections.abc import Awaitable, Callable
from contextvars import Context
from functools import partial
from typing import cast

import anyio
import msgspec

from turtleact.errors import (
    GoalRejected,
    ServerUnavailable,
    TurtleactError,
    encodable,
)
from turtleact.goals.body import ServerOptions
from turtleact.goals.observers import GoalObserver, Lost
from turtleact.goals.records import GoalChange, GoalJournal, GoalRecord, Resumed
from turtleact.goals.server import LocalActionServer, new_goal_id
from turtleact.goals.state import TRANSITIONS, Goal, GoalEvent, GoalRequest, GoalStatus
from turtleact.interfaces import Action, Message, WireFormat, type_hash
from turtleact.interfaces.standard import CancelGoal
from turtleact.tasks import Tasks

__all__ = ["DurableGoals", "Restoring"]

_CANCELING = GoalStatus.CANCELING

Consider = Callable[[GoalRequest], Awaitable[GoalRequest]]


class DurableGoals(GoalObserver):
    """Records the goals of one server in a journal, and restores them.

    Args:
        server: The server.
        options: The server's options, with ``journal`` and ``on_restart``.
        consider: Asks the ``goal_callback`` about a goal; None if there is no such callback.
        starts_at_once: Whether goals start as soon as they are accepted, because there is no slot.

    Attributes:
        resumes: Whether unfinished goals continue after a restart.
        is_built_in: Whether the action is built into turtleact. turtleact withdraws a built-in
            action when another server for an action of the same name opens.
        restored: An event that is set when the server holds the goals of the earlier process again.
    """

    def __init__(
        self,
        server: LocalActionServer,
        options: ServerOptions,
        consider: Consider | None,
        *,
        starts_at_once: bool,
    ) -> None:
        self.resumes = options.get("on_restart") == "resume"
        self.is_built_in = False
        self.restored = anyio.Event()
        self._resumed: dict[bytes, Resumed[Message, Message]] = {}
        self._server = server
        self._journal = cast("GoalJournal", options["journal"])
        self._consider = consider
        self._name = server.name
        self._accepting: dict[bytes, anyio.Event] = {}  # goals on their way to the disk, by id
        self._starts_at_once = starts_at_once
        self._is_suspended = False
        action_type = cast("type[Action]", server.spec.action_type)
        self._action_type = action_type
        self._type_hash = type_hash(action_type)
        self._goals = WireFormat(action_type.Goal)
        self._feedback = WireFormat(action_type.Feedback)
        self._results = WireFormat(action_type.Result)
        self._wrap(server)

    def _wrap(self, server: LocalActionServer) -> None:
        server.resumed = self._resumed
        server.observers.add(self)
        server.admit = self.admit
        server.wait_until_restored = self.restored.wait
        server.keep_partial_result = self.keep_partial_result
        self._start, server.start = server.start, self.start
        self._catch_up, server.catch_up = server.catch_up, self.catch_up
        self._deliver, server.deliver = server.deliver, self.deliver
        self._end, server.end = server.end, self.end
        self._conclude, server.conclude = server.conclude, self.conclude
        self._cancel, server.cancel = server.cancel, self.cancel
        if self.resumes and not self._journal.aborts_at_close:
            server.stop = self.suspend

    # accepting

    async def admit(self, request: GoalRequest) -> Goal:
        """Accept a goal once it is on disk, or return the known goal with the same id.

        Cancelling: a cancellation during the write to disk takes effect at the caller's next await.
        """
        await self.restored.wait()
        goal_id = request.goal_id or new_goal_id()
        while (held := self._server.find(goal_id)) is None and goal_id in self._accepting:
            await self._accepting[goal_id].wait()
        if held is not None:
            return self._join(held, self._server.check_goal(request.message))
        decided = self._accepting[goal_id] = anyio.Event()
        try:
            return await self._write_and_take(msgspec.structs.replace(request, goal_id=goal_id))
        finally:
            del self._accepting[goal_id]
            decided.set()

    async def _write_and_take(self, request: GoalRequest) -> Goal:
        """Write a goal to the journal and take it, or return the known goal with the same id."""
        if self._consider is not None:
            request = await self._consider(request)
        goal = self._server.new_goal(request)
        known = await self._accept(goal)
        if known is not None:
            return self._join(self._find_known(known), goal.request)
        try:
            self._server.check_open()  # it may have been closed while the disk was waited for
            return self._server.take(goal)
        except GoalRejected:
            with anyio.CancelScope(shield=True):
                await self._journal.withdraw(goal.id)
            raise

    async def _accept(self, goal: Goal) -> GoalRecord | None:
        """Write a new goal to disk.

        If the journal has a goal with this id already, return that goal's record instead.

        Cancelling: takes effect only when the goal has been written.

        Raises:
            GoalRejected: if the journal cannot write the goal.
        """
        # A crash in the body's first step must count, so the record of a goal that starts at once
        # says EXECUTING from the beginning.
        status = GoalStatus.EXECUTING if self._starts_at_once else GoalStatus.ACCEPTED
        record = GoalRecord(
            id=goal.id,
            action=self._name,
            type_name=self._action_type.type_name,
            type_hash=self._type_hash,
            request=self._goals.encode(goal.request),
            stamp=goal.stamp,
            accepted=time.time_ns(),
            status=status,
            is_built_in=self.is_built_in,
            is_nested=goal.parent is not None,
            sender=goal.sender if isinstance(goal.sender, bytes) else b"",
        )
        try:
            with anyio.CancelScope(shield=True):
                known = await self._journal.accept(record)
        except TurtleactError as error:
            raise GoalRejected(f"the journal cannot take it: {error}") from error
        return known

    def _join(self, goal: Goal, message: object) -> Goal:
        """Return a known goal if its goal message is the same; otherwise raise GoalRejected."""
        known = goal.request
        if known is None or self._goals.encode(known) != self._goals.encode(message):
            raise GoalRejected(f"the id {goal.hex} belongs to another goal")
        return goal

    def _find_known(self, record: GoalRecord) -> Goal:
        """Return the goal of a record. If the server has forgotten the goal, restore it."""
        goal = self._server.find(record.id)
        if goal is None:
            if not self.owns(record) or not record.ended:
                raise GoalRejected(f"the id {record.id.hex()} belongs to another goal")
            goal = self._restore_ended(record)
            goal.ended = self._server.now()
            self._server.table.hold_ended(goal)
        return goal

    # while it runs

    def start(self, goal: Goal, context: Context | None) -> None:
        """Run a goal's body, unless the server is being stopped and the goal stays unfinished."""
        if not self._is_suspended:
            self._start(goal, context)

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:  # noqa: ARG002
        """Record a goal's new state. A goal that starts at once is EXECUTING from its record on."""
        is_start = after is GoalStatus.EXECUTING and not self._starts_at_once
        if (is_start or after is _CANCELING) and not goal.is_ending:
            self._journal.progress(goal.id, GoalChange(status=after))

    def pause_changed(self, goal: Goal, is_paused: bool) -> None:
        """Record that a goal was paused or resumed."""
        if not goal.is_ending:
            self._journal.progress(goal.id, GoalChange(is_paused=is_paused))

    def deliver(self, goal: Goal, message: Message) -> None:
        """Record feedback, and publish it after it has been written.

        If the disk is full, the feedback is published although it is not on disk yet.
        """
        change = GoalChange(feedback=self._feedback.encode(message), crashes=0)
        self._journal.progress(goal.id, change, partial(self._deliver_written, goal, message))

    def _deliver_written(self, goal: Goal, message: Message) -> None:
        if not goal.ended:  # else the server was stopped meanwhile
            self._deliver(goal, message)

    def keep_partial_result(self, goal: Goal) -> None:
        """Record a goal's partial result."""
        change = GoalChange(partial_result=self._results.encode(goal.result))
        self._journal.progress(goal.id, change)

    async def catch_up(self, goal: Goal) -> None:
        """Wait until the journal and the readers of feedback have caught up."""
        await self._journal.written()
        await self._catch_up(goal)

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Cancel goals, and answer when the disk says so: a canceled goal is not resumed."""
        response = await self._cancel(goal_id, stamp)
        if response.goals_canceling:
            await self._journal.written()
        return response

    def end(self, goal: Goal, event: GoalEvent, result: object, reason: str) -> None:
        """Decide how a goal ends.

        While the server is being stopped, the goal ends only if it has succeeded or a client has
        canceled it; any other goal stays unfinished in the journal.
        """
        if self._is_suspended and goal.status is not _CANCELING and event is not GoalEvent.SUCCEED:
            goal.body = None
            return
        self._end(goal, event, result, reason)

    def conclude(self, goal: Goal, event: GoalEvent, reason: str) -> None:
        """Record a goal's end, and announce the end after it has been written to disk."""
        now, keep_ns = time.time_ns(), self._server.table.keep_ns
        change = GoalChange(
            status=TRANSITIONS[goal.status, event],
            result=self._results.encode(goal.result),
            reason=encodable(reason),
            ended=now,
            expires=0 if keep_ns is None else now + keep_ns,
        )
        self._journal.end(goal.id, change, partial(self._announce, goal, event, reason))

    def _announce(self, goal: Goal, event: GoalEvent, reason: str) -> None:
        if not goal.ended:  # else the server was stopped meanwhile
            self._conclude(goal, event, reason)

    # closing

    async def suspend(self) -> None:
        """Stop the bodies. Unfinished goals continue after a restart.

        Everybody who waits for an unfinished goal gets `ServerUnavailable`.
        """
        server = self._server
        self._is_suspended = True
        for goal in server.table.active:
            if goal.status is not GoalStatus.ACCEPTED:  # waiting goals keep their place
                server.evict(goal, server.closing_reason)
        await server.stop_bodies(server.closing_reason)
        left = [goal for goal in server.table.active if not goal.is_ending]
        # The journal learns that an orderly shutdown, not a crash, interrupts these goals.
        for goal in left:
            self._journal.progress(goal.id, GoalChange(is_stopped=True))
        with anyio.CancelScope(shield=True):
            await self._journal.written()
        for goal in left:
            self._lose(goal)

    def _lose(self, goal: Goal) -> None:
        """Tell everybody who waits for a goal that its server has stopped before the goal ended."""
        problem = "its server was stopped; the goal goes on when the server is back"
        goal.is_ending = True
        before = goal.status
        goal.error, goal.status = ServerUnavailable(self._name, problem), GoalStatus.UNKNOWN
        self._server.retire(goal)
        if self._server.observers.are_any:
            self._server.observers.noted(goal, Lost(before))

    # after a restart

    def load(self) -> list[GoalRecord]:
        """Return the journal's records with this action's name.

        The types in the records may differ, because actions of different types may share a name. A
        built-in action and a user's action of the same name do not get each other's records.
        """
        found = self._journal.load(self._name)
        return [record for record in found if record.is_built_in == self.is_built_in]

    def restore(self, record: GoalRecord) -> None:
        """Restore a goal of an earlier process. If the goal is unfinished, resume it or end it."""
        server = self._server
        if not server.is_open or server.find(record.id) is not None:
            return
        if record.ended:
            server.table.hold_ended(self._restore_ended(record))
            return
        goal = self._restore_unfinished(record)
        server.table.add(goal)
        if why := self._why_not_resumed(record):
            server.show(goal)
            goal.reason = why
            if record.status is _CANCELING:
                server.move(goal, GoalEvent.EXECUTE)
                server.move(goal, GoalEvent.CANCEL_GOAL)
            server.end_canceled(goal)
        else:
            if record.is_paused:
                server.pauses.hold(goal)
            # The record is written first, so that a start that crashes the process is counted.
            status = GoalStatus.EXECUTING if self._starts_at_once else None
            change = GoalChange(crashes=self._crashes(record), is_stopped=False, status=status)
            self._journal.progress(record.id, change, partial(self._go_on, goal))

    def _go_on(self, goal: Goal) -> None:
        """Start a restored goal, or let it wait for its turn."""
        if not self._server.is_open or goal.is_ending:
            return
        try:
            self._server.begin(goal)
        except GoalRejected as rejected:
            self._server.table.add(goal)
            goal.reason = rejected.reason
            self._server.end_canceled(goal)

    def owns(self, record: GoalRecord) -> bool:
        """Whether a record has the name and the type of this action."""
        names = (record.action, record.type_name)
        return names == (self._name, self._action_type.type_name)

    def _restore_ended(self, record: GoalRecord) -> Goal:
        """Return an ended goal, restored from its record."""
        # The graph's clock may be virtual and start anew, so the wall clock tells how long ago the
        # goal ended. That clock may have been set back.
        ago = max(0, time.time_ns() - record.ended)
        goal = self._goal(record)
        goal.result = self._decode(self._results, record, record.result)
        if goal.result is None:
            goal.result = self._action_type.Result()
        goal.status, goal.reason = record.status, record.reason
        goal.ended, goal.is_ending = max(1, self._server.now() - ago), True
        return goal

    def _restore_unfinished(self, record: GoalRecord) -> Goal:
        """Restore an unfinished goal, its last feedback and its partial result from ``record``."""
        goal = self._goal(record)
        feedback = self._decode(self._feedback, record, record.feedback)
        partial_result = self._decode(self._results, record, record.partial_result)
        self._resumed[goal.id] = Resumed(feedback, partial_result)
        goal.log.last, goal.result = feedback, partial_result
        goal.log.is_kept = True  # for a client that comes back a little later
        return goal

    def _why_not_resumed(self, record: GoalRecord) -> str:
        """Return why an unfinished goal cannot continue; empty if it can."""
        limit, crashes = self._journal.max_starts, self._crashes(record)
        if record.status is _CANCELING:
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

    def _crashes(self, record: GoalRecord) -> int:
        has_crashed = record.status is GoalStatus.EXECUTING and not record.is_stopped
        return record.crashes + has_crashed

    def _goal(self, record: GoalRecord) -> Goal:
        request = self._decode(self._goals, record, record.request)
        changed = self._server.tasks.signal()
        return Goal(record.id, request, changed, record.stamp, sender=record.sender or None)

    def _decode(self, format: WireFormat, record: GoalRecord, data: bytes) -> Message | None:
        """Decode a recorded message; None if there is no message, or if its type has changed."""
        if not data or record.type_hash != self._type_hash:
            return None
        return format.decode(data)


class Restoring:
    """Restores the goals of servers that open in the same turn of the event loop together.

    Servers that share a slot must be restored together. A program opens them without an await in
    between, so on the next turn of the loop all of them are there.

    Args:
        tasks: The functions for tasks in the servers' event loop.
    """

    def __init__(self, tasks: Tasks) -> None:
        self._tasks = tasks
        self._servers: list[DurableGoals] = []

    def add(self, server: DurableGoals | None) -> None:
        """Restore a server's goals on the loop's next turn. Without a journal, do nothing."""
        if server is not None:
            if not self._servers:
                self._tasks.from_anywhere(self._restore)
            self._servers.append(server)

    def _restore(self) -> None:
        """Restore the goals in the journals of these servers.

        Servers may share a slot. Therefore the goals of all servers are restored in one order:
        first the goals that ran, then those that waited for their turn. If several servers have the
        same action name, a goal goes to the server with the goal's action type. If no server has
        that type, an unfinished goal is not resumed, because the action type has changed.
        """
        servers, self._servers = self._servers, []
        found: dict[bytes, tuple[GoalRecord, DurableGoals]] = {}
        for server in servers:
            for record in server.load():
                if record.id not in found or server.owns(record):
                    found[record.id] = record, server
        for record, server in sorted(found.values(), key=_by_turn):
            server.restore(record)
        for server in servers:
            server.restored.set()


def _by_turn(found: tuple[GoalRecord, DurableGoals]) -> tuple[bool, int]:
    record, _ = found
    return record.status is not GoalStatus.EXECUTING, record.number
