"""The server of one action in this process: accepts, cancels and restores goals.

`turtleact.goals.state` has the rules for a goal's states, `turtleact.goals.policies` decides which
goals may run, and `execution` runs bodies. Clients in the same process call the `LocalActionServer`
and share its `Goal` objects. Requests from other processes arrive through `endpoints`.

Source: rcl_action ``action_server.c``; rclpy ``action/server.py``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection
from contextvars import copy_context
from functools import partial
from typing import cast

import anyio
import msgspec

from turtleact.errors import GoalRejected, ServerUnavailable
from turtleact.goals.body import ServerOptions, check_options
from turtleact.goals.callbacks import Callbacks
from turtleact.goals.durable import DurableGoals
from turtleact.goals.execution import Execution, Served
from turtleact.goals.goal_server import cancel_and_wait
from turtleact.goals.ids import new_goal_id
from turtleact.goals.observers import Observers
from turtleact.goals.policies import Admission, Slot
from turtleact.goals.records import GoalRecord
from turtleact.goals.state import (
    CURRENT_GOAL,
    CancelCode,
    Goal,
    GoalEvent,
    GoalOrder,
    GoalStatus,
    GoalTable,
    cancel_code,
    select,
)
from turtleact.interfaces import Action, Message, snapshotter, stamp_of
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo
from turtleact.tasks import GRACE, Background, Signal, Tasks

__all__ = ["SHUTDOWN", "LocalActionServer", "SlotRequest", "restore_all"]

# Members of enums that each goal needs. Python 3.11 looks them up slowly in their classes.
_ACCEPTED = GoalStatus.ACCEPTED
_EXECUTING = GoalStatus.EXECUTING
_CANCELING = GoalStatus.CANCELING
_CANCEL_GOAL = GoalEvent.CANCEL_GOAL

SHUTDOWN = "shutdown"
"""The default reason for goals that end because their server closes."""


class SlotRequest:
    """A goal's request for a place in a slot. The server cancels a waiting goal with `cancel`.

    Attributes:
        goal: The goal.
        action: The fully qualified name of the goal's action.
        context: The sender's context, in which the body will run.
    """

    __slots__ = ("_server", "action", "context", "goal")

    def __init__(self, server: LocalActionServer, goal: Goal) -> None:
        self._server = server
        self.goal = goal
        self.action = server.name
        self.context = copy_context()

    @property
    def label(self) -> str:
        """The goal's name, as in "busy with <name>". If the goal has no id yet, give it one."""
        return f"goal {self._server.name_goal(self.goal).hex()} of {self.action}"

    def start(self) -> None:
        """Start the goal when its turn has come.

        This does nothing if the goal has ended meanwhile, or if the server is stopping and leaves
        the goal in its journal.
        """
        execution = self._server.execution
        if self.goal.body is self and not execution.is_suspended:
            self.goal.body = None
            execution.move(self.goal, GoalEvent.EXECUTE)
            execution.start(self.goal, self.context)

    def cancel(self) -> None:
        """End the goal, which has not yet got a place in the slot."""
        self._server.execution.drop(self.goal)

    def evict(self, reason: str) -> None:
        """Cancel the goal for ``reason``: end it if it still waits, otherwise cancel its body."""
        self._server.evict(self.goal, reason)


class LocalActionServer:
    """Implements `turtleact.goals.goal_server.GoalServer` for one action.

    Args:
        served: The action, its name and its body.
        options: The user's options.
        tasks: The functions that start and manage tasks on asyncio or trio.
        now: Returns the current time (ns since the epoch).
        slot: The slot in which goals run; None if goals never wait for one another.

    Attributes:
        served: The action, its name and its body, as passed to the constructor.
        name: The fully qualified name of the action.
        is_open: Whether the server accepts goals.
        execution: Runs the bodies.
        observers: The objects that are told of each change of a goal.
        slot: The slot, as passed to the constructor; None after the server has closed.
        grace: How long a canceled body may clean up (s, event loop time).
        durable: The goals in the server's journal; None if the server has no journal.
        pauses: Pauses and resumes the goals.
        slot_name: The name of the slot that the server shares with others; empty if there is none.
        closing_reason: The reason for goals that end because the server closes.

    Raises:
        InvalidOption: if the value of an option is not allowed.
    """

    def __init__(
        self,
        served: Served,
        options: ServerOptions,
        tasks: Tasks,
        now: Callable[[], int],
        slot: Slot[SlotRequest] | None,
    ) -> None:
        check_options(options)
        self.served = served
        self.name = served.name
        self.is_open = True
        self.closing_reason = SHUTDOWN
        self.grace = options.get("grace", GRACE)
        self.from_anywhere = tasks.from_anywhere
        self._tasks = tasks
        self._now = now
        self.slot = slot
        self.slot_name = options.get("slot") or ""
        self._callbacks = Callbacks(served.name, options, tasks)
        self.durable = self._open_durable(options)
        self._accepts_slowly = self._callbacks.ask_about_goals or self.durable is not None
        self._cancels_lost = options.get("on_client_lost", "keep") == "cancel"
        self._table = GoalTable(options.get("result_timeout", 10.0))
        release = None if slot is None else self._release
        self.execution = Execution(served, self._table, tasks, now, release, options)
        self.execution.durable = self.durable
        self.pauses = self.execution.pauses
        self.observers: Observers = self.execution.observers
        goal_type = cast("type[Message]", served.action_type.Goal)
        self._check_goal = cast("Callable[[object], Message]", snapshotter(goal_type, root="goal"))
        self._preparing: Counter[object] = Counter()  # goals not decided yet, counted by sender
        self._lost: set[object] = set()  # those of these senders that have gone
        self._accepting: dict[bytes, anyio.Event] = {}  # goals on their way to the disk, by id
        self._cancels: dict[Goal, Background] = {}  # goals whose cancel_callback has not answered

    def _open_durable(self, options: ServerOptions) -> DurableGoals | None:
        journal = options.get("journal")
        if journal is None:
            return None
        on_restart, keep = options.get("on_restart", "abort"), options.get("result_timeout", 10.0)
        action_type = cast("type[Action]", self.served.action_type)
        return DurableGoals(journal, action_type, self.name, on_restart, keep)

    @property
    def is_idle(self) -> bool:
        """Whether no goal waits or runs."""
        return not (self._table.active or self.execution.bodies)

    # accepting goals

    async def send_goal(self, order: GoalOrder) -> Goal:
        """Accept a goal, and start its body or let the goal wait for its turn.

        Cancelling: cancels the goal and waits at most ``order.cancel_timeout`` s for its end.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if the goal is rejected.
        """
        goal = await self.take(order, is_streamed=True)
        # Yield once, so that the body has begun when the client gets its handle. A cancel that the
        # client sends next then reaches the running body.
        if goal.runner is None:
            try:
                await self._tasks.checkpoint()
            except self._tasks.cancelled:
                await cancel_and_wait(self, goal, order.cancel_timeout)
                raise
        return goal

    async def run_goal(self, order: GoalOrder) -> Goal:
        """Accept a goal and wait for its end. Raises the same errors as `send_goal`.

        Cancelling: cancels the goal and waits at most ``order.cancel_timeout`` s for its end.
        """
        goal = await self.take(order)
        if not goal.ended:
            signal = self.signal(goal)
            try:
                while not goal.ended:  # the caller has the goal: no need to keep it in the table
                    await signal.wait()
            except self._tasks.cancelled:
                await cancel_and_wait(self, goal, order.cancel_timeout)
                raise
        return goal

    async def take(self, order: GoalOrder, *, is_streamed: bool = False) -> Goal:
        """Accept a goal after asking the ``goal_callback``, if there is one.

        If ``is_streamed`` is true, the goal's feedback is kept for a client that reads it later.
        """
        try:
            if self.durable is not None:
                return await self._take_durably(order, self.durable, is_streamed=is_streamed)
            request = await self._prepare(order)
            return self._admit(self._new_goal(order, request, is_streamed=is_streamed))
        except GoalRejected as rejected:
            self.observers.goal_rejected(rejected.reason)
            # Whoever sends again until the goal is accepted must not keep all others from running.
            await self._tasks.checkpoint()
            raise

    def take_nowait(self, order: GoalOrder, *, is_streamed: bool = False) -> Goal | None:
        """Accept a goal without waiting, or return None if accepting it may take time.

        With a ``goal_callback`` or a journal, accepting may take time.
        """
        if self._accepts_slowly:
            return None
        try:
            return self._admit(self._new_goal(order, order.request, is_streamed=is_streamed))
        except GoalRejected as rejected:
            self.observers.goal_rejected(rejected.reason)
            raise

    async def _take_durably(
        self, order: GoalOrder, durable: DurableGoals, *, is_streamed: bool
    ) -> Goal:
        """Accept a goal once it is on disk, or return the known goal with the same id.

        Cancelling: a cancellation during the write to disk takes effect at the caller's next await.
        """
        await durable.restored.wait()
        goal_id = order.goal_id or new_goal_id()
        while (held := self.find(goal_id)) is None and goal_id in self._accepting:
            await self._accepting[goal_id].wait()
        if held is not None:
            return self._join(held, self._check_goal(order.request), is_streamed=is_streamed)
        decided = self._accepting[goal_id] = anyio.Event()
        try:
            order = msgspec.structs.replace(order, goal_id=goal_id)
            return await self._accept_durably(order, durable, is_streamed=is_streamed)
        finally:
            del self._accepting[goal_id]
            decided.set()

    async def _accept_durably(
        self, order: GoalOrder, durable: DurableGoals, *, is_streamed: bool
    ) -> Goal:
        """Write a goal to the journal and admit it, or return the known goal with the same id."""
        request = await self._prepare(order)
        goal = self._new_goal(order, request, is_streamed=is_streamed)
        # A crash in the body's first step must count, so the record of a goal that starts at once
        # says EXECUTING from the beginning.
        status = _EXECUTING if self.slot is None else _ACCEPTED
        known = await durable.accept(goal, status)
        if known is not None:
            held = self._find_known(known, durable)
            return self._join(held, goal.request, is_streamed=is_streamed)
        try:
            if not self.is_open:  # it may have been closed while the disk was waited for
                raise GoalRejected(self._why_closed)
            return self._admit(goal)
        except GoalRejected:
            await durable.withdraw(goal)
            raise

    def _join(self, goal: Goal, request: object, *, is_streamed: bool) -> Goal:
        """Return a known goal if its request equals ``request``; otherwise raise GoalRejected."""
        if self.durable is None or not self.durable.is_same(goal, request):
            raise GoalRejected(f"the id {goal.hex} belongs to another goal")
        goal.is_streamed = goal.is_streamed or is_streamed
        return goal

    def _find_known(self, record: GoalRecord, durable: DurableGoals) -> Goal:
        """Return the goal of a record. If the server has forgotten the goal, restore it."""
        goal = self.find(record.id)
        if goal is None:
            if not durable.owns(record) or not record.ended:
                raise GoalRejected(f"the id {record.id.hex()} belongs to another goal")
            goal = durable.ended(record, self._now())
            goal.ended = self._now()
            self._table.hold_ended(goal)
        return goal

    async def _prepare(self, order: GoalOrder) -> object:
        """Ask the ``goal_callback``, and return the request of the goal.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if the goal is rejected, or its client has disconnected in the meantime.
        """
        request, sender = order.request, order.sender
        self._preparing[sender] += 1
        try:
            if self._callbacks.ask_about_goals:
                request = self._check_goal(request)
                await self._callbacks.may_start(request)
            has_gone = self._cancels_lost and not getattr(sender, "is_open", True)
            if has_gone or sender in self._lost:
                raise GoalRejected("its client has gone")
            return request
        finally:
            self._preparing[sender] -= 1
            if not self._preparing[sender]:
                del self._preparing[sender]
                self._lost.discard(sender)

    @property
    def _why_closed(self) -> str:
        return f"the server of '{self.name}' is shutting down"

    def _new_goal(self, order: GoalOrder, request: object, *, is_streamed: bool = False) -> Goal:
        """Make an ACCEPTED goal.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if the server is closed.
        """
        if not self.is_open:
            raise GoalRejected(self._why_closed)
        on_feedback = order.on_feedback
        if on_feedback is not None:  # runs in the sender's context, not the body's
            on_feedback = partial(copy_context().run, on_feedback)  # type: ignore[call-arg]
        return Goal(
            self._check_goal(request),
            self._now(),
            id=order.goal_id,
            on_feedback=on_feedback,
            is_streamed=is_streamed,
            parent=CURRENT_GOAL.get(),
            sender=order.sender,
        )

    def _admit(self, goal: Goal) -> Goal:
        """Add a goal to the goals that the server holds, then start the goal or let it wait.

        Raises:
            GoalRejected: if the slot rejects the goal, or the server has a goal with that id.
        """
        if not self._table.add(goal):
            raise GoalRejected(f"the server still holds a goal with the id {goal.hex}")
        if goal.parent is not None:
            self.pauses.enter(goal, goal.parent)
        if self.slot is None:
            self._show(goal)
            self._begin(goal)
        else:
            self._enter(goal, self.slot)
        return goal

    def _show(self, goal: Goal) -> None:
        """Tell the observers of a new goal. They may cancel the goal."""
        if self.observers.are_any:
            self.observers.goal_changed(goal, GoalStatus.UNKNOWN, _ACCEPTED)

    def _begin(self, goal: Goal) -> None:
        """Start a goal's body, unless an observer has canceled the goal already."""
        if goal.status is _ACCEPTED:
            self.execution.move(goal, GoalEvent.EXECUTE)
        self.execution.start(goal)

    def _enter(self, goal: Goal, slot: Slot[SlotRequest]) -> None:
        """Request a place in the slot for a goal: the goal starts, waits or is rejected."""
        request = goal.body = SlotRequest(self, goal)
        entry = slot.enter(request)
        if entry.admission is Admission.REJECT:
            self._table.forget(goal)
            self.pauses.end(goal)
            goal.leave_parent()
            raise GoalRejected(entry.reason)
        self._show(goal)
        if entry.admission is Admission.START:
            goal.body = None
            self._begin(goal)
            return
        if goal.is_decided:  # an observer has cancelled it
            return
        for each in (entry.displaced, *entry.evicted):
            if each is not None:
                each.evict(entry.reason)

    def _release(self, goal: Goal) -> Callable[[], None] | None:
        """Free an ended goal's place. Return a function that starts the next goal, or None."""
        slot = self.slot
        if slot is None:  # the server is closed
            return None
        following, overdue = slot.leave(goal), slot.overdue()
        if overdue is not None:
            for each in overdue.evicted:
                each.evict(overdue.reason)
        return None if following is None else following.start

    # goals that are held

    def find(self, goal_id: bytes) -> Goal | None:
        """Return the goal with that id; None if the server does not hold such a goal."""
        return self._table.find(goal_id, self._now())

    async def attach(self, goal_id: bytes) -> Goal | None:
        """Return the goal as `find` does, and keep the goal's feedback for readers from now on."""
        if self.durable is not None:
            await self.durable.restored.wait()
        goal = self.find(goal_id)
        if goal is not None:
            goal.is_streamed = True
        return goal

    def held_ids(self) -> Collection[bytes]:
        """The ids of the goals that the server holds, except for goals that have no id yet."""
        return self._table.ids(self._now())

    def held(self) -> list[Goal]:
        """All goals that the server holds: active goals, and ended goals whose results it keeps."""
        return self._table.held(self._now())

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended. If this call is cancelled, the goal continues."""
        signal = self.signal(goal)
        goal.waiters += 1
        try:
            while not goal.ended:
                await signal.wait()
        finally:
            goal.waiters -= 1
            if not goal.waiters:
                self._table.unpin(goal)

    def signal(self, goal: Goal) -> Signal:
        """Return the signal that fires at each change of a goal."""
        if goal.listener is None:
            goal.listener = self._tasks.signal()
        return goal.listener  # type: ignore[return-value]  # only this method sets it

    def name_goal(self, goal: Goal) -> bytes:
        """Return the goal's id. If the goal has no id yet, give it one."""
        return self.execution.name_goal(goal)

    def info(self, goal: Goal) -> GoalInfo:
        """A goal's id and stamp as a message."""
        return GoalInfo(UUID(self.name_goal(goal)), stamp_of(goal.stamp))

    # canceling

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Cancel the goals that `turtleact.goals.state.select` chooses, and return the answer."""
        wanted = goal_id if goal_id and any(goal_id) else None
        named = self.find(wanted) if wanted else None
        by_id = wanted is not None and not stamp
        held = self._table.active if not by_id else [] if named is None else [named]
        canceled: list[Goal] = []
        kept: list[Goal] = []
        for goal in select(held, wanted, stamp):
            (canceled if await self._ask_and_cancel(goal) else kept).append(goal)
        if canceled and self.durable is not None:
            await self.durable.written()  # a goal that was being canceled is not resumed
        asked = len(canceled) + sum(goal.status.is_active for goal in kept)
        code = cancel_code(named, by_id=by_id, asked=asked, let_go=len(canceled))
        return CancelGoal.Response(int(code), [self.info(goal) for goal in canceled])

    async def cancel_goal(self, goal: Goal) -> CancelGoal.Response:
        """Cancel one goal, and return the answer.

        If the server has forgotten the goal, the answer is UNKNOWN_GOAL_ID.
        """
        if goal.ended and self.find(self.name_goal(goal)) is not goal:
            return CancelGoal.Response(CancelCode.UNKNOWN_GOAL_ID)
        if self._callbacks.ask_about_cancels:
            is_canceled = await self._ask_and_cancel(goal)
        else:
            is_canceled = self._cancel(goal)
        if is_canceled:
            if self.durable is not None:
                await self.durable.written()
            return CancelGoal.Response(goals_canceling=[self.info(goal)])
        is_kept = goal.status.is_active
        return CancelGoal.Response(CancelCode.REJECTED if is_kept else CancelCode.GOAL_TERMINATED)

    def cancel_goal_nowait(self, goal: Goal) -> None:
        """Cancel a goal without waiting.

        If the ``cancel_callback`` is still deciding about this goal, it is not asked again.
        """
        if not self._callbacks.ask_about_cancels:
            self._cancel(goal)
        elif goal.status.is_active and goal not in self._cancels:
            asking = self._ask_later(goal)
            self._cancels[goal] = Background(asking, f"a cancel of {self.name}", self._tasks)

    async def _ask_and_cancel(self, goal: Goal) -> bool:
        """Cancel a goal if the ``cancel_callback`` agrees. Return whether it is being canceled."""
        has_ended = not goal.status.is_active  # perhaps while the user was asked about another goal
        if has_ended or not self._callbacks.ask_about_cancels or goal.status is _CANCELING:
            return self._cancel(goal)
        agreed = await self._callbacks.may_cancel(self.execution.make_handle(goal))
        return agreed and self._cancel(goal)

    async def _ask_later(self, goal: Goal) -> None:
        try:
            await self._ask_and_cancel(goal)
        finally:
            self._cancels.pop(goal, None)

    def _cancel(self, goal: Goal) -> bool:
        """Cancel a goal. Return False if the goal's end is already decided."""
        if goal.is_decided:
            return False
        if goal.status is not _CANCELING:
            self.execution.move(goal, _CANCEL_GOAL)
            if goal.body is not None and not goal.reason:  # else the body was cancelled before
                goal.body.cancel()
        return True

    def evict(self, goal: Goal, reason: str) -> None:
        """Cancel a goal on the server's initiative, unless the goal is already being canceled."""
        is_wanted = goal.status.is_active and goal.status is not _CANCELING
        if is_wanted and not goal.reason and not goal.is_decided:
            if not self.execution.is_suspended:  # a paused goal is still paused after a restart
                self.pauses.end(goal)
            goal.reason = reason
            if goal.body is not None:
                goal.body.cancel()

    # pausing

    async def pause(self, goal: Goal, timeout: float) -> None:
        """Pause a goal, and return when the goal is paused; see `Pauses.pause`."""
        await self.pauses.pause(goal, timeout)

    async def resume(self, goal: Goal) -> None:
        """Resume a paused goal; see `Pauses.resume`."""
        await self.pauses.resume(goal)

    def client_lost(self, sender: object) -> None:
        """With ``on_client_lost="cancel"``, cancel the goals of a client that is gone."""
        if self._cancels_lost:
            if sender in self._preparing:
                self._lost.add(sender)
            for goal in self._table.active:
                if goal.sender == sender:
                    self._cancel(goal)

    # after a restart

    async def wait_until_restored(self) -> None:
        """Wait until `restore_all` has restored the goals in the journal. Cancelling: safe."""
        if self.durable is not None:
            await self.durable.restored.wait()

    def restore(self, record: GoalRecord) -> None:
        """Restore a goal of an earlier process. If the goal is unfinished, resume it or end it."""
        durable = self.durable
        if durable is None or not self.is_open or self.find(record.id) is not None:
            return
        if record.ended:
            self._table.hold_ended(durable.ended(record, self._now()))
            return
        goal = durable.unfinished(record)
        self._table.add(goal)
        if self.observers.are_any:
            self.observers.goal_changed(goal, GoalStatus.UNKNOWN, _ACCEPTED)
        if record.is_paused:
            self.pauses.hold(goal)
        if why := durable.why_not_resumed(record):
            canceling = record.status is _CANCELING
            self.execution.move(goal, GoalEvent.EXECUTE)
            if canceling:
                self.execution.move(goal, GoalEvent.CANCEL_GOAL)
            event = GoalEvent.CANCELED if canceling else GoalEvent.ABORT
            self.execution.end(goal, event, None, "" if canceling else why)
        else:
            durable.restart(record, partial(self._go_on, goal))

    def _go_on(self, goal: Goal) -> None:
        """Start a restored goal, or let it wait for its turn."""
        if not self.is_open or goal.is_decided:
            return
        if self.slot is None:
            self._begin(goal)
            return
        try:
            self._enter(goal, self.slot)
        except GoalRejected as rejected:
            self._table.add(goal)
            self.execution.move(goal, GoalEvent.EXECUTE)
            self.execution.end(goal, GoalEvent.ABORT, None, rejected.reason)

    # closing

    async def _suspend(self, durable: DurableGoals) -> None:
        """Stop the bodies. Unfinished goals continue after a restart."""
        self.execution.is_suspended = True
        for goal in self._table.active:
            if goal.status is not _ACCEPTED:  # waiting goals keep their place in the queue
                self.evict(goal, SHUTDOWN)
        await self.execution.wait_for_bodies(self.grace, SHUTDOWN)
        left = [goal for goal in self._table.active if not goal.is_decided]
        await durable.stop(left)
        for goal in left:
            problem = "its server was stopped; the goal goes on when the server is back"
            self.execution.lose(goal, ServerUnavailable(self.name, problem))

    async def wait_until_idle(self) -> None:
        """Wait until no goal waits or runs. Cancelling: safe."""
        await self.execution.wait_until_idle()

    async def aclose(self) -> None:
        """Stop accepting goals, cancel all goals that run or wait, and wait until they have ended.

        The goals end ABORTED with the `closing_reason`, and everybody who waits for a goal gets its
        result. A body that ignores its cancellation for `grace` seconds is given up; see
        `Execution.wait_for_bodies`.

        With a journal and ``on_restart="resume"``, unfinished goals do not end, but continue after
        a restart. Everybody who waits for an unfinished goal gets `ServerUnavailable`.
        """
        self.is_open = False
        self._callbacks.close()
        if self.durable is not None and self.durable.suspends:
            await self._suspend(self.durable)
        else:
            for goal in self._table.active:
                self.evict(goal, self.closing_reason)
            await self.execution.wait_for_bodies(self.grace, self.closing_reason)
        self.slot = None  # from now on no goal gets a place
        for asking in list(self._cancels.values()):
            await asking.aclose(self.grace)
        await self.pauses.aclose(self.grace)


def restore_all(servers: list[LocalActionServer]) -> None:
    """Restore the goals in the journals of these servers.

    Servers may share a slot. Therefore the goals of all servers are restored in one order: first
    the goals that ran, then those that waited for their turn. If several servers have the same
    action name, a goal goes to the server with the goal's action type. If no server has that type,
    an unfinished goal is not resumed, because the action type has changed.
    """
    durable = [(server, server.durable) for server in servers if server.durable is not None]
    found: dict[bytes, tuple[GoalRecord, LocalActionServer]] = {}
    for server, goals in durable:
        for record in goals.load():
            if record.id not in found or goals.owns(record):
                found[record.id] = record, server
    for record, server in sorted(found.values(), key=_by_turn):
        server.restore(record)
    for _, goals in durable:
        goals.restored.set()


def _by_turn(found: tuple[GoalRecord, LocalActionServer]) -> tuple[bool, int]:
    record, _ = found
    return record.status is not _EXECUTING, record.number
