"""The server of one action in this process: accepts, cancels and ends goals.

This module has the plain path of a goal, without any option:

1. `LocalActionServer.accept` makes a goal, adds it to the table, and calls `begin`.
2. `begin` tells the observers, and calls `start`, which runs the body in a task (`running`).
3. The body calls `publish`, which calls `deliver` with each feedback message.
4. At its end the body calls `end`, which decides the result and calls `conclude`. `conclude` sets
   the final state, lets the goal go with `retire`, and tells the observers.

Each option is a module of its own. It replaces some of the steps above when the server opens
(`turtleact.goals.options`), and calls the replaced step in turn. `turtleact.goals.state` has the
rules for a goal's states. Clients in the same process call the `LocalActionServer` and share its
`Goal` objects. Requests from other processes arrive through `turtleact.goals.server_endpoints`.

Source: rcl_action ``action_server.c``; rclpy ``action/server.py``.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Awaitable, Callable, Mapping
from contextvars import Context
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias, cast

import anyio

from turtleact.errors import CUT_OFF, GoalRejected, InvalidGoalId, InvalidTransition
from turtleact.goals.observers import Observers
from turtleact.goals.state import (
    CURRENT_GOAL,
    FeedbackLog,
    Goal,
    GoalEvent,
    GoalRequest,
    GoalStatus,
    GoalTable,
    cancel_code,
    select,
)
from turtleact.interfaces import Action, Message, snapshotter, stamp_of
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo
from turtleact.tasks import GRACE, LoopGuard, Signal, Tasks, wait_while

if TYPE_CHECKING:
    from turtleact.goals.body import ActionType, Body
    from turtleact.goals.policies import Slot
    from turtleact.goals.records import Resumed

__all__ = [
    "SHUTDOWN",
    "FeedbackPublisher",
    "GoalPauses",
    "GoalServer",
    "LocalActionServer",
    "LocalPauses",
    "ServerSpec",
    "goal_id_bytes",
    "new_goal_id",
]


# Members of enums that each goal needs. Python 3.11 looks them up slowly in their classes.
_ACCEPTED = GoalStatus.ACCEPTED
_CANCELING = GoalStatus.CANCELING
_CANCEL_GOAL = GoalEvent.CANCEL_GOAL

SHUTDOWN = "shutdown"
"""The default reason for goals that end because their server closes."""

_Check: TypeAlias = Callable[[object], Message]


class GoalPauses(Protocol):
    """Pauses and resumes the goals of a server."""

    def is_paused(self, goal: Goal) -> bool:
        """Whether a goal is paused."""

    def hold(self, goal: Goal) -> None:
        """Pause a goal that was sent just now, so that its body starts only after `resume`.

        A goal in another process cannot be held.
        """

    async def pause(self, goal: Goal, timeout: float) -> None:
        """Pause a goal, and return once the goal's body has paused.

        Raises:
            PauseRefused: if the goal cannot be paused, or not within ``timeout`` (s, event loop
                time).
            ServerUnavailable: if the server has gone.
        """

    async def resume(self, goal: Goal) -> None:
        """Resume a paused goal. This raises the same errors as `pause`."""


class LocalPauses(GoalPauses, Protocol):
    """What a server in this process also knows of its pauses."""

    @property
    def paused(self) -> list[Goal]:
        """The paused goals, in the order in which they were paused."""

    def paused_time(self, goal: Goal) -> float:
        """How long a goal has been paused in total (s, by the graph's clock)."""


class GoalServer(Protocol):
    """An action's server, as its clients see it."""

    @property
    def is_open(self) -> bool:
        """Whether the server accepts goals."""

    @property
    def pauses(self) -> GoalPauses:
        """Pauses and resumes the server's goals."""

    @property
    def resumed(self) -> Mapping[bytes, object]:
        """The ids of the goals in this process that began in an earlier process."""

    async def send(self, request: GoalRequest) -> Goal:
        """Send a goal. In the same process, the goal is accepted when this returns.

        Raises:
            InvalidGoal: if the request does not fit the action. In that case, the goal is not sent.
            GoalRejected: if the server rejects the goal.
            ServerUnavailable: if nobody serves the action, or its server goes away.
        """

    async def wait_for_acceptance(self, goal: Goal) -> None:
        """Wait until a goal that was sent is accepted, and raise the errors of `send`."""

    async def attach(self, goal_id: bytes) -> Goal | None:
        """Return the goal with that id, or None if there is none."""

    def cancel(self, goal_id: bytes | None, stamp: int) -> Awaitable[CancelGoal.Response]:
        """Cancel the goals that an id and a stamp (ns) select, and return the server's answer."""

    async def abandon(self, goal: Goal, timeout: float) -> None:
        """Cancel a goal and wait at most ``timeout`` s for its end, shielded from cancellation.

        The caller no longer needs the goal, so errors of the server are not raised.
        """

    def client_lost(self, sender: object) -> None:
        """Tell the server that a client has gone."""


class ServerSpec(NamedTuple):
    """What a server offers: its action, the action's name and its body.

    Attributes:
        name: The fully qualified name of the action.
        action_type: The action.
        body: The body to run.
        make_handle: A function that makes the goal handle for bodies and callbacks.
        home: The event loop in which the server must be used.
        node: The fully qualified name of the node.
    """

    name: str
    action_type: ActionType[Message, Message, Message]
    body: Body
    make_handle: Callable[[LocalActionServer, Goal], object]
    home: LoopGuard
    node: str


class FeedbackPublisher(Protocol):
    """The feedback topic of a server, which is used only while somebody reads the topic."""

    @property
    def is_congested(self) -> bool:
        """Whether bodies should wait before they publish more."""

    def send(self, goal: Goal, message: Message) -> None:
        """Send a message that is already a checked copy of the feedback."""

    async def drained(self) -> None:
        """Wait until the topic is not congested. Cancelling: safe."""


class LocalActionServer:
    """Implements `turtleact.goals.server.GoalServer` for one action.

    Args:
        spec: The action, its name and its body.
        tasks: The functions that start and manage tasks on asyncio or trio.
        now: Returns the current time (ns since the epoch).
        result_timeout: How long to keep a goal after its end (s); None to keep it for ever.
        grace: How long a canceled body may clean up (s, event loop time).

    Attributes:
        spec: The action, its name and its body, as passed to the constructor.
        name: The fully qualified name of the action.
        is_open: Whether the server accepts goals.
        observers: The objects that are told of each change of a goal.
        table: The goals that the server holds.
        tasks: The functions that start and manage tasks on asyncio or trio.
        now: Returns the current time (ns since the epoch).
        grace: How long a canceled body may clean up (s, event loop time).
        idle: A signal that fires when a goal has ended and when a body has ended.
        publisher: The feedback topic; None while nobody reads it.
        slot: The slot in which goals run; None if goals never wait for one another.
        slot_name: The name of the slot that the server shares with others; empty if there is none.
        closing_reason: The reason for goals that end because the server closes.
        pauses: Pauses and resumes the goals.
        resumed: What a journal had of each goal that began in an earlier process, by id.

    The steps that options replace:

    Attributes:
        admit: Accepts a goal that has to wait for its acceptance; None if `accept` can take each
            goal at once.
        may_cancel: Decides whether to cancel a goal; None if each goal may be canceled.
        begin: Starts an accepted goal.
        start: Runs a goal's body, in a context or in a copy of the current context.
        catch_up: Waits until those who must keep up with the feedback have caught up.
        deliver: Passes a feedback message on to all readers.
        keep_partial_result: Called when a goal has a new partial result.
        end: Decides how a goal ends.
        conclude: Brings a goal to its final state.
        retire: Lets a goal go that has ended, or whose server has stopped.
        stop: Cancels all goals and waits until they have ended.
        stop_bodies: Waits until all bodies have ended, or gives them up for a reason.
        count_bodies: Returns how many bodies run.
        cancel: Cancels the goals that an id and a stamp (ns) select, and returns the answer.
        wait_until_restored: Waits until the server holds the goals of an earlier process again.
        client_lost: Called when a client has gone.
        aclose: Closes the server.
    """

    pauses: LocalPauses
    stop_bodies: Callable[[str], Awaitable[None]]
    start: Callable[[Goal, Context | None], None]
    count_bodies: Callable[[], int]

    def __init__(
        self,
        spec: ServerSpec,
        tasks: Tasks,
        now: Callable[[], int],
        result_timeout: float | None = 10.0,
        grace: float = GRACE,
    ) -> None:
        self.spec = spec
        self.name = spec.name
        self.is_open = True
        self.observers = Observers(spec.name)
        self.table = GoalTable(result_timeout)
        self.tasks = tasks
        self.now = now
        self.grace = grace
        self.idle: Signal = tasks.signal()
        self.publisher: FeedbackPublisher | None = None
        self.slot: Slot[Any] | None = None
        self.slot_name = ""
        self.closing_reason = SHUTDOWN
        self.resumed: Mapping[bytes, Resumed[Any, Any]] = {}
        self.admit: Callable[[GoalRequest], Awaitable[Goal]] | None = None
        self.may_cancel: Callable[[Goal], Awaitable[bool]] | None = None
        self.begin: Callable[[Goal], None] = self._begin
        self.catch_up: Callable[[Goal], Awaitable[None]] = self._catch_up
        self.deliver: Callable[[Goal, Message], None] = self._deliver
        self.keep_partial_result: Callable[[Goal], None] = lambda _: None
        self.end: Callable[[Goal, GoalEvent, object, str], None] = self._end
        self.conclude: Callable[[Goal, GoalEvent, str], None] = self._conclude
        self.retire: Callable[[Goal], None] = self._retire
        self.cancel: Callable[[bytes | None, int], Awaitable[CancelGoal.Response]] = self._cancel
        self.wait_until_restored: Callable[[], Awaitable[None]] = self._hold_all
        self.client_lost: Callable[[object], None] = lambda _: None
        self.stop: Callable[[], Awaitable[None]] = self._stop
        self.aclose: Callable[[], Awaitable[None]] = self._aclose
        action = cast("type[Action]", spec.action_type)
        self.result_type = action.Result
        self.check_goal = cast("_Check", snapshotter(action.Goal, root="goal"))
        self.check_result = cast("_Check", snapshotter(action.Result, root="result"))
        self._check_feedback = cast("_Check", snapshotter(action.Feedback, root="feedback"))

    @property
    def is_idle(self) -> bool:
        """Whether no goal waits or runs."""
        return self.table.is_idle and not self.count_bodies()

    def make_handle(self, goal: Goal) -> object:
        """Make the handle of a goal for its body and the callbacks."""
        return self.spec.make_handle(self, goal)

    # accepting goals

    async def send(self, request: GoalRequest) -> Goal:
        """Accept a goal, and start its body or let the goal wait for its turn.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if the goal is rejected.
        """
        try:
            if self.admit is None:
                return self.accept(request)
            return await self.admit(request)
        except GoalRejected as rejected:
            self.observers.goal_rejected(rejected.reason)
            # Whoever sends again until the goal is accepted must not keep all others from running.
            await self.tasks.checkpoint()
            raise

    def accept(self, request: GoalRequest) -> Goal:
        """Make a goal and begin it. The errors are those of `send`."""
        return self.take(self.new_goal(request))

    def new_goal(self, request: GoalRequest) -> Goal:
        """Make an ACCEPTED goal.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if the server is closed.
        """
        self.check_open()
        return Goal(
            request.goal_id or new_goal_id(),
            self.check_goal(request.message),
            self.tasks.signal(),
            self.now(),
            log=FeedbackLog(request.on_feedback),
            parent=CURRENT_GOAL.get(),
            sender=request.sender,
        )

    def take(self, goal: Goal) -> Goal:
        """Add a goal to the goals that the server holds, and begin it.

        Raises:
            GoalRejected: if the goal may not begin, or the server has a goal with that id.
        """
        if not self.table.add(goal):
            raise GoalRejected(f"the server still holds a goal with the id {goal.hex}")
        self.begin(goal)
        return goal

    def check_open(self) -> None:
        """Raise `GoalRejected` if the server is closed."""
        if not self.is_open:
            raise GoalRejected(f"the server of '{self.name}' is shutting down")

    def _begin(self, goal: Goal) -> None:
        self.show(goal)
        self.start(goal, None)

    def show(self, goal: Goal) -> None:
        """Tell the observers of a new goal. They may cancel the goal."""
        if self.observers.are_any:
            self.observers.goal_changed(goal, GoalStatus.UNKNOWN, _ACCEPTED)

    async def wait_for_acceptance(self, goal: Goal) -> None:  # noqa: ARG002  # it is accepted
        """Let the body begin, so that a cancel that the client sends next reaches the body."""
        await self.tasks.checkpoint()

    # goals that are held

    def find(self, goal_id: bytes) -> Goal | None:
        """Return the goal with that id; None if the server does not hold such a goal."""
        return self.table.find(goal_id, self.now())

    def held(self) -> Mapping[bytes, Goal]:
        """All goals by id: active goals, and ended goals whose results the server keeps."""
        return self.table.held(self.now())

    async def attach(self, goal_id: bytes) -> Goal | None:
        """Return the goal as `find` does, once the goals of an earlier process are restored."""
        await self.wait_until_restored()
        return self.find(goal_id)

    async def _hold_all(self) -> None:
        """Return at once, because without a journal there are no goals of an earlier process."""

    # feedback and partial results

    def publish(self, goal: Goal, feedback: object) -> None:
        """Copy feedback and pass it to every reader.

        Raises:
            InvalidMessage: if the message is not this action's Feedback, or a value does not fit
                its type.
            InvalidTransition: if the goal is neither EXECUTING nor CANCELING.
        """
        message = self._check_feedback(feedback)
        if goal.is_ending or goal.status is _ACCEPTED:
            raise InvalidTransition(goal.status, "feedback", goal.hex)
        self.deliver(goal, message)

    def _deliver(self, goal: Goal, message: Message) -> None:
        log = goal.log
        log.append(message)
        if log.is_kept:
            goal.changed.fire()
        if log.on_feedback is not None:
            log.on_feedback(message)
        if self.publisher is not None:
            self.publisher.send(goal, message)
        if "feedback_published" in self.observers.wanted:
            self.observers.feedback_published(goal, message)

    async def _catch_up(self, goal: Goal) -> None:
        """Let other tasks run, and wait while a reader of feedback is far behind."""
        await self.tasks.checkpoint()
        if self.publisher is not None and self.publisher.is_congested:
            await self.publisher.drained()
        log = goal.log
        log.trim()
        if log.read is not None:
            log.weigh()
        if log.is_full:
            drained = log.drained = self.tasks.signal()
            try:
                while log.is_full:
                    await drained.wait()
            finally:
                log.drained = None

    def set_partial_result(self, goal: Goal, result: object) -> None:
        """Set the result to report if the goal is canceled or aborted.

        Raises:
            InvalidMessage: if the message is not this action's Result, or a value does not fit its
                type.
            InvalidTransition: if the goal has ended.
        """
        if goal.is_ending:
            raise InvalidTransition(goal.status, "a partial result", goal.hex)
        goal.result = self.check_result(result)
        self.keep_partial_result(goal)

    # changing and ending

    def move(self, goal: Goal, event: GoalEvent) -> None:
        """Change a goal's state and tell the observers.

        Raises:
            InvalidTransition: if the goal's state does not allow the event. The goal then keeps its
                state.
        """
        before = goal.status
        goal.apply(event)
        if self.observers.are_any:
            self.observers.goal_changed(goal, before, goal.status)

    def _end(self, goal: Goal, event: GoalEvent, result: object, reason: str) -> None:
        """Decide how a goal ends, unless its end is decided already."""
        if goal.is_ending:  # for example because the body was given up
            return
        goal.body, goal.is_ending = None, True
        if result is not None:
            goal.result = result
        elif goal.result is None:
            goal.result = self.result_type()
        self.conclude(goal, event, reason)

    def end_canceled(self, goal: Goal) -> None:
        """End a goal whose body was cancelled or has not started.

        The goal ends CANCELED if a client has canceled the goal, otherwise ABORTED.
        """
        is_canceled = goal.status is _CANCELING
        # A goal that waited for its place has not been EXECUTING, and ROS 2 has no way from
        # ACCEPTED to ABORTED.
        if goal.status is _ACCEPTED:
            self.move(goal, GoalEvent.EXECUTE)
        if is_canceled:
            self.end(goal, GoalEvent.CANCELED, None, "")
        else:
            self.end(goal, GoalEvent.ABORT, None, goal.reason or CUT_OFF)

    def _conclude(self, goal: Goal, event: GoalEvent, reason: str) -> None:
        before = goal.status
        goal.reason = reason
        goal.apply(event)
        self.retire(goal)
        if self.observers.are_any:
            self.observers.goal_changed(goal, before, goal.status)

    def _retire(self, goal: Goal) -> None:
        goal.parent = goal.log.on_feedback = None  # so that they can be freed
        self.table.end(goal, self.now())
        goal.changed.fire()
        self.idle.fire()

    # canceling

    async def _cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Cancel the goals that `turtleact.goals.state.select` chooses, and return the answer."""
        wanted = goal_id if goal_id and any(goal_id) else None
        named = self.find(wanted) if wanted else None
        by_id = wanted is not None and not stamp
        held = self.table.active if not by_id else [] if named is None else [named]
        canceled: list[Goal] = []
        kept: list[Goal] = []
        for goal in select(held, wanted, stamp):
            (canceled if await self._ask_and_cancel(goal) else kept).append(goal)
        asked = len(canceled) + sum(goal.status.is_active for goal in kept)
        code = cancel_code(named, by_id=by_id, asked=asked, let_go=len(canceled))
        infos = [GoalInfo(UUID(goal.id), stamp_of(goal.stamp)) for goal in canceled]
        return CancelGoal.Response(int(code), infos)

    async def _ask_and_cancel(self, goal: Goal) -> bool:
        """Cancel a goal if it may be canceled. Return whether it is being canceled."""
        is_new = goal.status.is_active and goal.status is not _CANCELING
        if self.may_cancel is not None and is_new and not await self.may_cancel(goal):
            return False
        return self.request_cancel(goal)

    def request_cancel(self, goal: Goal) -> bool:
        """Make a goal CANCELING and cancel its body. Return False if its end is decided already."""
        if goal.is_ending:
            return False
        if goal.status is not _CANCELING:
            self.move(goal, _CANCEL_GOAL)
            if goal.body is not None and not goal.reason:  # else the body was cancelled before
                goal.body.cancel()
        return True

    def evict(self, goal: Goal, reason: str) -> None:
        """Cancel a goal on the server's initiative, unless the goal is already being canceled."""
        is_wanted = goal.status.is_active and goal.status is not _CANCELING
        if is_wanted and not goal.reason and not goal.is_ending:
            goal.reason = reason
            if goal.body is not None:
                goal.body.cancel()

    async def abandon(self, goal: Goal, timeout: float) -> None:
        """Cancel a goal and wait at most ``timeout`` s for its end, shielded from cancellation."""
        with anyio.move_on_after(timeout, shield=True):
            await self.cancel(goal.id, 0)
            await goal.wait_for_end()

    # closing

    async def wait_until_idle(self) -> None:
        """Wait until no goal waits or runs. Cancelling: safe."""
        while not self.is_idle:
            await self.idle.wait()

    async def _aclose(self) -> None:
        """Stop accepting goals, cancel all goals that run or wait, and wait until they have ended.

        The goals end ABORTED with the `closing_reason`, and everybody who waits for a goal gets its
        result.
        """
        self.is_open = False
        await self.stop()

    async def _stop(self) -> None:
        for goal in self.table.active:
            self.evict(goal, self.closing_reason)
        await self.stop_bodies(self.closing_reason)
        await wait_while(lambda: not self.table.is_idle, self.idle, self.grace)


def new_goal_id() -> bytes:
    """Return a new goal id, a UUID of version 4 (RFC 9562)."""
    noise = bytearray(os.urandom(16))
    noise[6] = noise[6] & 0x0F | 0x40
    noise[8] = noise[8] & 0x3F | 0x80
    return bytes(noise)


def goal_id_bytes(goal_id: bytes | str | uuid.UUID) -> bytes:
    """Convert a goal id in any form to its 16 bytes.

    Raises:
        InvalidGoalId: if the id is neither 16 bytes nor a UUID nor 32 hexadecimal digits, or is all
            zeros.

    >>> goal_id_bytes("0d4fd2a0d2b74b3f9a3f1f7c2f4f8f2e").hex()
    '0d4fd2a0d2b74b3f9a3f1f7c2f4f8f2e'
    """
    if isinstance(goal_id, str):
        try:
            goal_id = uuid.UUID(goal_id).bytes
        except ValueError:
            problem = "a goal id has 32 hexadecimal digits"
            raise InvalidGoalId(str(goal_id), problem, 0) from None
    if isinstance(goal_id, uuid.UUID):
        goal_id = goal_id.bytes
    if not isinstance(goal_id, bytes) or len(goal_id) != 16:
        raise InvalidGoalId(repr(goal_id), "a goal id has 16 bytes, or is a UUID", 0)
    if not any(goal_id):
        raise InvalidGoalId(goal_id.hex(), "a goal id must not be all zeros", 0)
    return goal_id
