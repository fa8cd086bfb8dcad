"""An action's server: takes goals, runs their bodies in tasks of its own, and outlives them.

It decides which goals are taken and which are let go; what may happen to a goal stands in
`turtleact.goal`, who may run in `turtleact.slot`, how a body is run in `execution`, how messages
travel in `turtleact.transports`. It holds every body that runs, cancels it, and waits for its end
when it is closed.

A client in the same process is handed this very object, and the `Goal` that it made.

Source: rclpy ``action/server.py`` for names and meaning.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Generator
from contextvars import copy_context
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar, Unpack, cast

import anyio

from turtleact.body import ActionType, Body, ServerOptions, check_options
from turtleact.goal import (
    CancelCode,
    Goal,
    GoalEvent,
    GoalStatus,
    GoalTable,
    OnFeedback,
    failure,
)
from turtleact.goal_id import new_goal_id
from turtleact.interfaces import Message, stamp_of
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo
from turtleact.server.callbacks import Questions
from turtleact.server.canceling import Canceling
from turtleact.server.claim import Claim
from turtleact.server.execution import Execution
from turtleact.server.goal_handle import ServerGoalHandle
from turtleact.server.hooks import Hooks
from turtleact.server.reception import Reception
from turtleact.server.stepping import BLOCKING
from turtleact.slot import Slot
from turtleact.tasks import DEEPEST, GRACE, Signal, Tasks, wait_while
from turtleact.transports.base import Closeable, Reply

if TYPE_CHECKING:
    from turtleact.node import Node
    from turtleact.server.endpoints import ActionEndpoints

__all__ = ["SHUTDOWN", "ActionServer"]

logger = logging.getLogger("turtleact.server")

G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)

MakeHandle: TypeAlias = Callable[[Goal], ServerGoalHandle[G, R, F]]

_ACCEPTED = GoalStatus.ACCEPTED
_EXECUTING = GoalStatus.EXECUTING
_SUCCEEDED = GoalStatus.SUCCEEDED

SHUTDOWN = "shutdown"
"""Why goals end that a closing server has ended."""


class ActionServer(Generic[G, R, F]):
    """Serves one action under one name; made by `turtleact.Node.action_server`.

    Attributes:
        name: The fully qualified name.
        action_type: The action.
        node: What a body sees as ``handle.node``.
        is_open: Whether it takes goals.
        hooks: What is called at each change of a goal.
    """

    def __init__(
        self,
        node: Node,
        action_type: ActionType[G, R, F],
        name: str,
        execute: Callable[..., object],
        *,
        tasks: Tasks,
        place: Slot[Claim] | None = None,
        **options: Unpack[ServerOptions],
    ) -> None:
        check_options(options)
        self.node = node
        self.name = name
        self.action_type = action_type
        self.is_open = True
        self.registration: Closeable | None = None
        self.endpoints: ActionEndpoints | None = None
        self._now = node.clock.now
        self._tasks = tasks
        self.from_anywhere = tasks.from_anywhere
        cancel_callback = options.get("cancel_callback")
        self._on_client_lost = options.get("on_client_lost", "keep")
        self._questions = Questions(name, tasks)
        self._can_borrow = tasks.can_borrow and cancel_callback is None
        self._table = GoalTable(options.get("result_timeout", 10.0))
        make_handle: MakeHandle[G, R, F] = partial(ServerGoalHandle, self)
        self.execution = Execution(
            name,
            action_type,
            Body(name, execute),
            clock=node.clock,
            tasks=tasks,
            table=self._table,
            make_handle=make_handle,
        )
        self.hooks = Hooks(name, self.execution, make_handle)
        self._canceling = Canceling(
            name,
            cancel_callback,
            questions=self._questions,
            tasks=tasks,
            table=self._table,
            execution=self.execution,
            make_handle=make_handle,
            info=self.info,
        )
        self._reception = Reception(
            name,
            cast("type[Message]", action_type.Goal),
            goal_callback=options.get("goal_callback"),
            keeps=self._on_client_lost == "keep",
            questions=self._questions,
            tasks=tasks,
            slot=place,
            table=self._table,
            execution=self.execution,
            hooks=self.hooks,
            now=self._now,
        )

    @property
    def is_idle(self) -> bool:
        """Whether no goal waits or runs, and nobody waits for an answer."""
        is_asked = self.endpoints is not None and self.endpoints.is_asked
        return not (self._table.active or is_asked)

    # what a client in the same process calls

    async def answer(self, request: object) -> object:
        """Answer a ``SendGoal`` request: the server stands for this service itself."""
        return await cast("ActionEndpoints", self.endpoints).send_goal(request)

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a ``SendGoal`` request that came over a wire."""
        return await cast("ActionEndpoints", self.endpoints).reply(request, caller)

    def reply_now(self, request: object, caller: bytes) -> Reply | None:
        """The same if it takes no waiting."""
        return None if self.endpoints is None else self.endpoints.reply_now(request, caller)

    def begin(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object = None,
        *,
        is_streamed: bool = True,
    ) -> Goal | None:
        """Take up a goal, and start its body unless it has to wait.

        Its feedback is kept for a reader if it ``is_streamed``. None, and nothing done, if `take`
        is to be awaited instead: there is somebody to ask, or others have to have their turn.

        Raises:
            InvalidGoal: if the request does not fit the action.
            GoalRejected: if it is not taken.
        """
        if self._reception.waits_first():
            return None
        return self._begin(request, goal_id, on_feedback, sender, is_streamed=is_streamed)

    async def take(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object = None,
        *,
        is_streamed: bool = True,
    ) -> Goal:
        """As `begin`, after others have had their turn, and the user was asked."""
        request = await self._reception.prepare(request, sender)
        return self._begin(request, goal_id, on_feedback, sender, is_streamed=is_streamed)

    def _begin(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object,
        *,
        is_streamed: bool,
    ) -> Goal:
        goal = self._reception.admit(request, goal_id, on_feedback, sender, is_streamed=is_streamed)
        if goal.status is not _ACCEPTED and not goal.ended:
            self.execution.start(goal)
        return goal

    def call(
        self,
        request: object,
        goal_id: bytes | None,
        on_feedback: OnFeedback | None,
        sender: object = None,
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
        if self._reception.waits_first():
            request = yield from self._reception.prepare(request, sender).__await__()
        goal = self._reception.admit(request, goal_id, on_feedback, sender)
        tasks = self._tasks
        if self._can_borrow and goal.status is _EXECUTING and tasks.depth < DEEPEST:
            running, context, outer = self.execution.run(goal), copy_context(), tasks.scope()
            has_ended, began = False, monotonic()
            tasks.depth += 1
            try:
                waits_for = context.run(running.send, None)
            except StopIteration:
                has_ended = True
            finally:
                tasks.depth -= 1
            if (took := monotonic() - began) > BLOCKING:
                self.execution.report_blocking(goal, took)
            if not has_ended:
                lent = self.execution.lend(goal, running, waits_for, context, outer)
                yield from lent.__await__()
        elif not goal.ended:
            if goal.status is not _ACCEPTED:
                self.execution.start(goal)
            yield from self._wait_out(goal).__await__()
        if goal.status is _SUCCEEDED:
            return goal.result
        raise failure(goal)

    def find(self, goal_id: bytes) -> Goal | None:
        """The goal of that id; None if it was never held, or is not held any more."""
        return self._table.find(goal_id, self._now())

    async def attach(self, goal_id: bytes) -> Goal | None:
        """The goal of that id, if it is held; its feedback is kept from now on."""
        goal = self.find(goal_id)
        if goal is not None:
            goal.is_streamed = True
            if self.endpoints is not None:
                self.endpoints.read_last(goal)
        return goal

    def held_ids(self) -> Collection[bytes]:
        """The ids of those of the goals held that have one."""
        return self._table.ids(self._now())

    def held(self) -> list[Goal]:
        """All goals held: the active ones, and those whose result is kept."""
        return self._table.held(self._now())

    async def wait_for_end(self, goal: Goal) -> None:
        """Wait until a goal has ended. Cancelling: safe, the goal goes on."""
        signal = self.signal(goal)
        goal.waiters += 1
        try:
            while not goal.ended:
                await signal.wait()
        finally:
            goal.waiters -= 1
            if not goal.waiters:
                self._table.unpin(goal)

    async def cancel_and_wait(self, goal: Goal) -> None:
        """Ask a goal to cancel and wait for its end, shielded, `GRACE` seconds at most."""
        with anyio.move_on_after(GRACE, shield=True):
            await self._canceling.ask_and_cancel(goal)
            await self.wait_for_end(goal)

    def signal(self, goal: Goal) -> Signal:
        """The signal that fires at each change of a goal."""
        if goal.listener is None:
            goal.listener = self._tasks.signal()
        return goal.listener  # type: ignore[return-value]  # nobody else puts one there

    def name_goal(self, goal: Goal) -> bytes:
        """The id of a goal; it can be found by it from now on."""
        return goal.id or self._table.name(goal, new_goal_id(), self._now())

    def info(self, goal: Goal) -> GoalInfo:
        """A goal's id and stamp, as sent."""
        return GoalInfo(UUID(self.name_goal(goal)), stamp_of(goal.stamp))

    async def cancel_goal(self, goal: Goal) -> CancelGoal.Response:
        """Answer a request to cancel one goal, which may have been forgotten."""
        goal_id = self.name_goal(goal)
        if goal.ended and self.find(goal_id) is not goal:
            return CancelGoal.Response(CancelCode.UNKNOWN_GOAL_ID)
        return await self.cancel(goal_id, 0)

    async def cancel(self, goal_id: bytes | None, stamp: int) -> CancelGoal.Response:
        """Answer a cancel request: by id, by stamp (ns), by both, or for every goal."""
        return await self._canceling.answer(goal_id, stamp, self._now())

    def cancel_nowait(self, goal: Goal) -> None:
        """Ask a goal to cancel; a ``cancel_callback`` answers in its own time."""
        self._canceling.cancel_nowait(goal)

    def client_lost(self, sender: object) -> None:
        """Note that a client has gone: its goals go on, unless ``on_client_lost`` is "cancel"."""
        if self._on_client_lost == "cancel":
            self._reception.lose(sender)
            for goal in self._table.active:
                if goal.sender == sender:
                    self._canceling.cancel(goal)

    def caller_lost(self, caller: bytes) -> None:
        """Note that a client elsewhere has gone."""
        self.client_lost(caller)

    # the end

    async def aclose(self) -> None:
        """Take no more goals, cancel those that run, drop those that wait, and wait for their end.

        They end ABORTED with the reason "shutdown"; a body that has not ended after `GRACE`
        seconds is left behind, and logged. Every waiter gets its answer.
        """
        self.is_open = False
        self._reception.is_open = False
        self._questions.close()
        if self.registration is not None:
            self.registration.close()
        ended = self.execution.ended = self.execution.ended or self._tasks.signal()
        for goal in self._table.active:
            self._reception.evict(goal, SHUTDOWN)
        await wait_while(lambda: self._table.active, ended, GRACE)
        for goal in self._table.active:
            logger.error("goal %s of %s has not ended; it is left behind", goal.hex, self.name)
            self.execution.abandon(goal)
            self.execution.end(goal, GoalEvent.ABORT, None, goal.reason or SHUTDOWN)
        self._reception.leave_slot()
        await self._canceling.aclose()
        if self.endpoints is not None:
            await self.endpoints.aclose()

    async def _wait_out(self, goal: Goal) -> None:
        """Wait until a goal has ended. Cancelling: cancels the goal, and waits for its end."""
        try:
            await self.wait_for_end(goal)
        except self._tasks.cancelled:
            await self.cancel_and_wait(goal)
            raise
