"""How a goal is carried out: its body is run, its feedback published, its end made the goal's end.

A body runs in a task of its own, begun at once, or inside the task of the client that awaits it.

A generator is never iterated with ``async for``: a cancellation that lands while it stands at a
``yield`` would reach it as GeneratorExit only, and a timeout or task group around that ``yield``
would break. One task drives it; what arrives between two steps is thrown in at its ``yield``; it
is closed on every path.

Source: PEP 525; PEP 789 for the hazards of generators.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Coroutine
from contextvars import Context, ContextVar
from functools import partial
from typing import TYPE_CHECKING, ClassVar, TypeAlias, cast

from turtleact.body import ActionType, Body, Steps
from turtleact.clock import Clock
from turtleact.errors import (
    Abort,
    Cancel,
    InvalidMessage,
    InvalidTransition,
)
from turtleact.feedback import FeedbackLog
from turtleact.goal import Goal, GoalEvent, GoalStatus, GoalTable
from turtleact.interfaces import Message, snapshotter
from turtleact.server.stepping import Borrowed, Owned, finish, is_closed_by_loop
from turtleact.summaries import STOPPED, STOPS, summary, text_of
from turtleact.tasks import Scope, Signal, Tasks, is_cancellation

if TYPE_CHECKING:
    from turtleact.server.status import StatusSource
    from turtleact.transports.base import Publication

__all__ = ["CURRENT_GOAL", "Execution", "Watch"]

logger = logging.getLogger("turtleact.server")

Check: TypeAlias = Callable[[object], Message]
Running: TypeAlias = Coroutine[object, object, None]
Watch: TypeAlias = Callable[[Goal, GoalStatus, GoalStatus], object]

CURRENT_GOAL: ContextVar[Goal | None] = ContextVar("CURRENT_GOAL", default=None)
"""The goal whose body runs here: the parent of those that it sends."""

BURST = 16
"""After so many messages in a row, a generator that never waits lets others run."""

_ACCEPTED = GoalStatus.ACCEPTED
_CANCELING = GoalStatus.CANCELING
_SUCCEED = GoalEvent.SUCCEED


class Execution:
    """Carries out the goals of one server.

    Args:
        name: The action's name, for messages and logs.
        action_type: The action.
        body: The function to run.
        clock: Says when a goal ended.
        tasks: Starts what runs by itself.
        table: Where goals are held.
        make_handle: Makes the handle that a body may want.

    Attributes:
        check_result: The checked copy of a result.
        also_feedback: Told of each feedback message, with its goal; must not raise.
        emit: Takes feedback as a body gives it, if that can do without a copy, and answers whether
            it has; must not raise.
        outlet: Where feedback goes besides: bodies wait while it is congested.
        watch: Told of each change of a goal's state, before and after; must not raise.
        board: Where others see how all goals stand; told of each change too.
        release: Told of each goal that has ended; may answer what starts another.
        ended: Fires whenever a goal has ended. Like the six above None, until somebody wants it.
    """

    #: Whether a body's goal is noted as the parent of those that it sends: from the first slot on,
    #: as nothing else asks for it, and it takes time and memory.
    notes_parents: ClassVar[bool] = False

    def __init__(
        self,
        name: str,
        action_type: ActionType[Message, Message, Message],
        body: Body,
        *,
        clock: Clock,
        tasks: Tasks,
        table: GoalTable,
        make_handle: Callable[[Goal], object],
    ) -> None:
        self._name = name
        self._call = body.call
        self._is_generator = body.is_generator
        self._wants_handle = body.wants_handle
        self._now = clock.now
        self._tasks = tasks
        self._table = table
        self._make_handle = make_handle
        self._result_type = cast("type[Message]", action_type.Result)
        feedback_type = cast("type[Message]", action_type.Feedback)
        self._check_feedback = cast("Check", snapshotter(feedback_type, root="feedback"))
        self.check_result = cast("Check", snapshotter(self._result_type, root="result"))
        self.also_feedback: Callable[[Goal, object], object] | None = None
        self.emit: Callable[[Goal, object], bool] | None = None
        self.outlet: Publication | None = None
        self.watch: Watch | None = None
        self.board: StatusSource | None = None
        self.release: Callable[[Goal], Callable[[], object] | None] | None = None
        self.ended: Signal | None = None

    # starting

    def start(self, goal: Goal, context: Context | None = None) -> None:
        """Run a goal's body in a task of its own; on asyncio its first step has run then.

        Args:
            goal: The goal.
            context: What the task runs in; a copy of the current context if left out.
        """
        owned = Owned(goal, self, self._tasks)
        task = self._tasks.spawn(self.run(goal, owned), self._name, context)
        if not goal.ended:
            owned.task = task
            goal.body = owned
            if goal.status is _CANCELING or goal.reason:  # asked for in its own first step
                owned.cancel()

    async def lend(
        self,
        goal: Goal,
        running: Running,
        waits_for: object,
        context: Context,
        outer: Scope | None,
    ) -> None:
        """Run a body in the caller's own task, to its end (asyncio alone).

        Cancelling: the goal is asked to cancel, its end awaited, the cancellation raised again.

        Args:
            goal: The goal.
            running: `run` of that goal, after its first step.
            waits_for: What the first step gave.
            context: What the first step ran in.
            outer: The scope that the caller was in before it.
        """
        borrowed = Borrowed(context, goal, self, self._tasks, outer)
        goal.body = borrowed
        if goal.status is _CANCELING or goal.reason:  # asked for in its own first step
            borrowed.cancel()
        await borrowed.go_on(running, waits_for)

    # running

    async def run(self, goal: Goal, owned: Owned | None = None) -> None:
        """Run a body and make its end the goal's end; raises only what stops the program.

        Args:
            goal: The goal.
            owned: What its steps go through, if it has a task of its own.
        """
        if Execution.notes_parents:
            CURRENT_GOAL.set(goal)
        if goal.status is _CANCELING or goal.reason:  # before its first step
            self._end_canceled(goal)
            return
        try:
            if self._wants_handle:
                running = self._call(goal.request, self._make_handle(goal))
            else:
                running = self._call(goal.request)
            if self._is_generator:
                running = self._drive(goal, running)  # type: ignore[arg-type]  # see Body
            if owned is not None:
                owned.body = running  # type: ignore[assignment]  # see Body
                running = owned
            result = await running  # type: ignore[misc]  # see Body
        except BaseException as error:
            if is_closed_by_loop(error):
                raise
            self._fail(goal, error)
            if isinstance(error, KeyboardInterrupt | SystemExit):
                if owned is None:
                    raise
                self._tasks.soon(partial(_throw, error))  # or it would break into who starts it
            return
        try:  # few names and short calls here: each takes its place in every goal's frame
            if result is None or not self._is_generator:  # else `_drive` has done it
                result = self.check_result(result)
        except InvalidMessage as error:
            self._end_without_result(goal, result, error)
        else:
            self.end(goal, _SUCCEED, result)

    async def _drive(self, goal: Goal, steps: Steps) -> object:
        """Run a generator to its end; the answer is its result, or None if it gave none."""
        result_type, check, step = self._result_type, self._check_feedback, steps.asend
        countdown = BURST
        try:
            item = await step(None)
            while type(item) is not result_type:
                try:
                    emit = self.emit
                    if emit is None or not emit(goal, item):
                        message, log = check(item), goal.feedback
                        if goal.listener or goal.on_feedback or goal.ended or self.also_feedback:
                            status, reason = goal.status, goal.reason
                            self._hand_on(goal, message)
                            if goal.status is not status or goal.reason is not reason:
                                countdown = 1  # who was told has canceled it: see to it at once
                        elif log is not None:  # nobody is to be told: a shorter `_hand_on`
                            log.items.append(message)  # `_pause` trims it
                            goal.last_feedback = message
                        elif goal.is_streamed:
                            self._hand_on(goal, message)
                    countdown -= 1
                    if not countdown:
                        countdown = BURST
                        await self._pause(goal)
                except GeneratorExit:
                    raise
                except BaseException as error:
                    item = await steps.athrow(error)
                else:
                    item = await step(None)
        except StopAsyncIteration:
            return None
        except BaseException:
            await steps.aclose()
            raise
        try:
            result = self.check_result(item)  # now: the body may go on changing it
        except InvalidMessage as misfit:
            await steps.aclose()
            raise Abort(f"the body's result does not fit: {misfit}") from None
        await finish(steps)
        return result

    async def _pause(self, goal: Goal) -> None:
        """Let others run; if the sender reads and is far behind, let it catch up."""
        await self._tasks.checkpoint()
        if self.outlet is not None and self.outlet.is_congested:
            await self.outlet.drained()
        log = goal.feedback
        if log is None:
            return
        log.trim()
        if log.read is not None:
            log.weigh()
        if log.is_full:
            drained = log.drained = self._tasks.signal()
            try:
                while log.is_full:
                    await drained.wait()
            finally:
                log.drained = None

    def publish(self, goal: Goal, feedback: object) -> None:
        """Take a snapshot of feedback and hand it to all who read."""
        message = self._check_feedback(feedback)
        self._hand_on(goal, message)

    def _hand_on(self, goal: Goal, message: Message) -> None:
        if goal.ended or goal.status is _ACCEPTED:
            raise InvalidTransition(goal.status, "feedback", goal.hex)
        goal.last_feedback = message
        if goal.is_streamed:
            log = goal.feedback
            if log is None:
                log = goal.feedback = FeedbackLog()
            log.append(message)
            if goal.listener is not None:
                goal.listener.fire()
        if goal.on_feedback is not None:
            try:
                goal.on_feedback(message)
            except STOPS:
                raise
            except BaseException:  # a cancellation too: nobody has canceled this body
                logger.exception("the feedback_callback of goal %s failed", goal.hex)
        if self.also_feedback is not None:
            self.also_feedback(goal, message)

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        """Warn of a step that kept all others from running; a process that was stopped looks so."""
        logger.warning(
            "a step of the body of %s took %.1f s (goal %s): nothing else could run meanwhile;"
            " unless the process was stopped, await what waits, and move long work to"
            " anyio.to_thread.run_sync",
            self._name,
            seconds,
            goal.hex,
        )

    def abandon(self, goal: Goal) -> None:
        """Cancel a body once more, which may have swallowed the first time; let its caller go."""
        if isinstance(goal.body, Borrowed):
            goal.body.abandon()
        elif goal.body is not None:
            goal.body.cancel()

    # changing and ending

    def move(self, goal: Goal, event: GoalEvent) -> None:
        """Change a goal's state, and tell who watches.

        Raises:
            InvalidTransition: if the event is not allowed now; nothing has changed.
        """
        before = goal.status
        goal.apply(event)
        if self.board is not None:
            self.board.note(goal)
        if self.watch is not None:
            self.watch(goal, before, goal.status)

    def mark_canceling(self, goal: Goal) -> None:
        """Make a goal CANCELING, unless it is so already or has ended."""
        if goal.status.is_active and goal.status is not _CANCELING:
            self.move(goal, GoalEvent.CANCEL_GOAL)

    def drop(self, goal: Goal) -> None:
        """End a goal that waits to be started and never will be."""
        if goal.status is GoalStatus.ACCEPTED:
            self.move(goal, GoalEvent.EXECUTE)
        self._end_canceled(goal)

    def end(self, goal: Goal, event: GoalEvent, result: object, reason: str = "") -> None:
        """End a goal; one that was left behind at the shutdown has been answered already."""
        if goal.ended:
            return
        if result is not None:
            goal.result = result
        elif goal.result is None:
            goal.result = self._result_type()
        if goal.reason is not reason:
            goal.reason = reason
        if goal.body is not None:
            goal.body = None
        if goal.parent is not None or goal.on_feedback is not None:
            goal.parent = goal.on_feedback = None  # or a chain of goals would never be forgotten
        before = goal.status
        goal.apply(event)
        self._table.end(goal, self._now())
        start_next = None if self.release is None else self.release(goal)
        if self.board is not None:
            self.board.note(goal)
        if self.watch is not None:
            self.watch(goal, before, goal.status)
        if start_next is not None:
            self._tasks.soon(start_next)
        if self.ended is not None:
            self.ended.fire()

    def _end_without_result(self, goal: Goal, given: object, error: InvalidMessage) -> None:
        why = "no result" if given is None else f"the body's result does not fit: {error}"
        self.end(goal, GoalEvent.ABORT, None, why)

    def _fail(self, goal: Goal, error: BaseException) -> None:
        if isinstance(goal.body, Borrowed) and goal.body.is_caller_canceled:
            self.mark_canceling(goal)
        canceling = goal.status is _CANCELING
        if isinstance(error, KeyboardInterrupt | SystemExit):
            self.end(goal, GoalEvent.ABORT, None, STOPPED)
        elif isinstance(error, Abort):
            self._end_with(goal, GoalEvent.ABORT, error.result, text_of(error.reason))
        elif isinstance(error, Cancel) and (canceling or goal.reason):
            event = GoalEvent.CANCELED if canceling else GoalEvent.ABORT
            self._end_with(goal, event, error.result, "" if canceling else goal.reason)
        elif is_cancellation(error, self._tasks):
            self._end_canceled(goal)
        else:
            logger.error("the body of goal %s of %s failed", goal.hex, self._name, exc_info=error)
            self.end(goal, GoalEvent.ABORT, None, summary(error))

    def _end_canceled(self, goal: Goal) -> None:
        if goal.status is _CANCELING:
            self.end(goal, GoalEvent.CANCELED, None)
        else:
            self.end(goal, GoalEvent.ABORT, None, goal.reason or "canceled from within")

    def _end_with(self, goal: Goal, event: GoalEvent, result: object, reason: str) -> None:
        """End a goal with a result that the body chose, if it fits."""
        if result is not None:
            try:
                result = self.check_result(result)
            except InvalidMessage as error:
                result, reason = None, f"{reason} (its result does not fit: {error})"
        self.end(goal, event, result, reason)


def _throw(error: BaseException) -> None:
    raise error
