"""An action's server: takes goals, runs their bodies in tasks of its own, and outlives them.

It decides which goals are taken and which are let go; what may happen to a goal stands in
`turtleact.goal`, how its body is run in `turtleact.execution`, how messages travel in
`turtleact.transports`. It holds every body that runs, cancels it, and waits for its end when it is
closed.

A client in the same process is handed this very object, and the `Goal` that it made.

Source: rclpy ``action/server.py`` for names and meaning.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator
from contextvars import copy_context
from functools import partial
from inspect import isawaitable
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar, Unpack, cast

import anyio

from turtleact.body import ActionType, Body, ServerOptions
from turtleact.errors import GoalRejected, Reject
from turtleact.execution import Execution, mark_canceling, summary
from turtleact.goal import (
    CancelResponse,
    Goal,
    GoalEvent,
    GoalResponse,
    GoalStatus,
    GoalTable,
    cancel_code,
    failure,
    select,
)
from turtleact.goal_id import new_goal_id
from turtleact.interfaces import Message, snapshotter
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo, Time
from turtleact.tasks import Signal, Tasks
from turtleact.transports.base import Closeable

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["ActionServer", "ServerGoalHandle"]

logger = logging.getLogger("turtleact.server")

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)

OnFeedback: TypeAlias = Callable[[object], object]

_EXECUTING = GoalStatus.EXECUTING
_SUCCEEDED = GoalStatus.SUCCEEDED

GRACE = 5.0
"""How long a server that is closed waits for its bodies (s)."""


class ServerGoalHandle(Generic[G, R, F]):
    """What a body holds of its goal.

    Attributes:
        node: The node that serves the goal.
    """

    __slots__ = ("_goal", "_server", "node")

    def __init__(self, server: ActionServer[G, R, F], goal: Goal) -> None:
        self._server = server
        self._goal = goal
        self.node = server.node

    @property
    def goal_id(self) -> bytes:
        """The goal's 16 bytes."""
        return self._server.name_goal(self._goal)

    @property
    def stamp(self) -> Time:
        """When the goal was accepted."""
        return _time(self._goal.stamp)

    @property
    def status(self) -> GoalStatus:
        """The goal's state."""
        return self._goal.status

    @property
    def request(self) -> G:
        """The goal message."""
        return cast("G", self._goal.request)

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a client has asked to cancel the goal, and the server agreed."""
        return self._goal.status is GoalStatus.CANCELING

    def publish_feedback(self, feedback: F) -> None:
        """Send feedback: a snapshot is taken, so the message may be changed and sent again.

        Raises:
            InvalidMessage: if it is not this action's Feedback, or a value does not fit its type.
            InvalidTransition: if the goal is neither EXECUTING nor CANCELING.
        """
        self._server.execution.publish(self._goal, feedback)

    def set_partial_result(self, result: R) -> None:
        """Set what is reported should the goal be canceled or aborted.

        Raises:
            InvalidMessage: if it is not this action's Result, or a value does not fit its type.
        """
        self._goal.result = self._server.execution.check_result(result)


class ActionServer(Generic[G, R, F]):
    """Serves one action under one name; made by `turtleact.Node.action_server`.

    Attributes:
        name: The fully qualified name.
        action_type: The action.
        node: What a body sees as ``handle.node``.
        is_open: Whether it takes goals.
        asks_first: Whether a goal must be put to the user's ``goal_callback`` before it is begun.
    """

    def __init__(
        self,
        node: Node,
        action_type: ActionType[G, R, F],
        name: str,
        execute: Callable[..., object],
        *,
        tasks: Tasks,
        **options: Unpack[ServerOptions],
    ) -> None:
        self.node = node
        self.name = name
        self.action_type = action_type
        self.is_open = True
        self.registration: Closeable | None = None
        self._now = node.clock.now
        self._tasks = tasks
        self.asks_first = options.get("goal_callback") is not None
        self._goal_callback = options.get("goal_callback")
        self._cancel_callback = options.get("cancel_callback")
        self._can_borrow = tasks.can_borrow and self._cancel_callback is None
        self._table = GoalTable(options.get("result_timeout", 10.0))
        goal_type = cast("type[Message]", action_type.Goal)
        self._check_goal = cast("Callable[[object], Message]", snapshotter(goal_type, root="goal"))
        self.execution = Execution(
            name,
            action_type,
            Body(name, execute),
            clock=node.clock,
            tasks=tasks,
            table=self._table,
            make_handle=partial(ServerGoalHandle, self),
        )

    # what a client in the same process calls

    async def ask(self, request: object) -> None:
        """Put a goal to the user's ``goal_callback``; only needed if `asks_first`.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if it is not taken.
        """
        message = self._check_goal(request)
        callback = cast("Callable[[Message], object]", self._goal_callback)
        try:
            answer = callback(message)
            if isawaitable(answer):
                answer = await answer
        except Reject as verdict:
            raise GoalRejected(verdict.reason) from None
        except Exception as error:
            logger.exception("the goal_callback of %s failed; the goal is rejected", self.name)
            raise GoalRejected(f"the goal_callback failed: {summary(error)}") from None
        if answer is GoalResponse.REJECT:
            raise GoalRejected("the goal_callback rejected it")
        if answer is not GoalResponse.ACCEPT:
            raise GoalRejected(f"the goal_callback answered {answer!r}, not a GoalResponse")

    def begin(self, request: object, goal_id: bytes | None, on_feedback: OnFeedback | None) -> Goal:
        """Take up a goal and start its body; its feedback is kept for a reader.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if it is not taken.
        """
        goal = self._admit(request, goal_id, on_feedback, is_streamed=True)
        self.execution.start(goal)
        return goal

    def call(
        self, request: object, goal_id: bytes | None, on_feedback: OnFeedback | None
    ) -> Generator[object, object, object]:
        """Take up a goal, run its body to its end, in the caller's own task if possible.

        Canceling the caller cancels the goal, and waits for its end. What `SendGoal.__await__`
        gives: a generator, as a coroutine would have to be wrapped there.

        Returns:
            The result.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if it is not taken.
            GoalAborted, GoalCanceled: if it ends so.
        """
        if self.asks_first:
            yield from self.ask(request).__await__()
        goal = self._admit(request, goal_id, on_feedback)
        if self._can_borrow:
            running, context = self.execution.run(goal), copy_context()
            try:
                waits_for = context.run(running.send, None)
            except StopIteration:
                pass
            else:
                yield from self.execution.lend(goal, running, waits_for, context).__await__()
        else:
            self.execution.start(goal)
            yield from self._wait_out(goal).__await__()
        if goal.status is _SUCCEEDED:
            return goal.result
        raise failure(goal)

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended. Cancelling: safe, the goal goes on."""
        signal = self.signal(goal)
        goal.waiters += 1
        log = goal.feedback
        if log is not None and log.drained is not None:
            log.drained.fire()  # who only waits for the end does not hold the body up
        try:
            while not goal.ended:
                await signal.wait()
        finally:
            goal.waiters -= 1

    async def cancel_and_wait(self, goal: Goal) -> None:
        """Ask a goal to cancel and wait for its end, shielded, `GRACE` seconds at most."""
        with anyio.move_on_after(GRACE, shield=True):
            await self._let_go(goal)
            await self.wait_for_end(goal)

    def signal(self, goal: Goal) -> Signal:
        """The signal that fires at each change of a goal."""
        if goal.listener is None:
            goal.listener = self._tasks.signal()
        return goal.listener  # type: ignore[return-value]  # nobody else puts one there

    def name_goal(self, goal: Goal) -> bytes:
        """The id of a goal; it can be found by it from now on."""
        return goal.id or self._table.name(goal, new_goal_id(), self._now())

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Answer a cancel request: by id, by stamp (ns), by both, or for every goal."""
        wanted = goal_id if goal_id and any(goal_id) else None
        named = self._table.find(wanted, self._now()) if wanted else None
        by_id = wanted is not None and not stamp
        held = self._table.active if not by_id else [] if named is None else [named]
        let_go: list[Goal] = []
        kept: list[Goal] = []
        for goal in select(held, wanted, stamp):
            (let_go if await self._let_go(goal) else kept).append(goal)
        asked = len(let_go) + sum(goal.status.is_active for goal in kept)
        code = cancel_code(named, by_id=by_id, asked=asked, let_go=len(let_go))
        return CancelGoal.Response(int(code), [self._info(goal) for goal in let_go])

    async def aclose(self) -> None:
        """Take no more goals, cancel those that run, and wait for their end.

        They end ABORTED with the reason "shutdown"; a body that has not ended after `GRACE`
        seconds is left behind, and logged. Every waiter gets its answer.
        """
        self.is_open = False
        if self.registration is not None:
            self.registration.close()
        ended = self.execution.ended = self.execution.ended or self._tasks.signal()
        for goal in self._table.active:
            is_told = goal.reason or goal.status is GoalStatus.CANCELING  # and may be cleaning up
            goal.reason = goal.reason or "shutdown"
            if goal.body is not None and not is_told:
                goal.body.cancel()
        with anyio.move_on_after(GRACE, shield=True):
            while self._table.active:
                await ended.wait()
        for goal in self._table.active:
            logger.error("goal %s of %s has not ended; it is left behind", goal.hex, self.name)
            self.execution.end(goal, GoalEvent.ABORT, None, goal.reason)

    # taking a goal

    def _admit(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        *,
        is_streamed: bool = False,
    ) -> Goal:
        """Hold a goal that is to start at once."""
        if not self.is_open:
            raise GoalRejected(f"the server of '{self.name}' is shutting down")
        goal = Goal(
            self._check_goal(request), self._now(), _EXECUTING, goal_id, on_feedback, is_streamed
        )
        if not self._table.add(goal):
            raise GoalRejected(f"the server still holds a goal of the id {goal.hex}")
        return goal

    # canceling a goal

    async def _wait_out(self, goal: Goal) -> None:
        """Wait until a goal has ended. Cancelling: cancels the goal, and waits for its end."""
        try:
            await self.wait_for_end(goal)
        except self._tasks.cancelled:
            await self.cancel_and_wait(goal)
            raise

    async def _let_go(self, goal: Goal) -> bool:
        """Ask whether a goal may be canceled, and cancel it; False if not, or if it has ended."""
        asks = self._cancel_callback is not None and goal.status is not GoalStatus.CANCELING
        if asks and not await self._ask_to_cancel(goal):
            return False
        if goal.status.is_active and goal.status is not GoalStatus.CANCELING:
            mark_canceling(goal)
            if goal.body is not None and not goal.reason:  # else it has been canceled already
                goal.body.cancel()
        return goal.status.is_active

    async def _ask_to_cancel(self, goal: Goal) -> bool:
        """Put a goal to the user's cancel_callback."""
        callback = cast("Callable[..., object]", self._cancel_callback)
        try:
            answer = callback(ServerGoalHandle(self, goal))
            if isawaitable(answer):
                answer = await answer
        except Exception:
            logger.exception("the cancel_callback of %s failed; the goal goes on", self.name)
            return False
        return answer is CancelResponse.ACCEPT

    def _info(self, goal: Goal) -> GoalInfo:
        return GoalInfo(UUID(self.name_goal(goal)), _time(goal.stamp))


def _time(nanoseconds: int) -> Time:
    return Time(*divmod(nanoseconds, 1_000_000_000))
