"""Runs goals: starts the body, publishes its feedback, and ends the goal when the body ends.

Generators are never iterated with ``async for``. With it, a generator that is suspended at a
``yield`` during a cancellation would only see GeneratorExit, and a timeout or task group around
that ``yield`` would break. Here one task steps the generator. A cancellation or error between two
steps is raised at the ``yield``. The task closes the generator on every path.

Source: PEP 525; PEP 789 for the hazards of generators.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Awaitable, Callable, Coroutine
from contextvars import Context, copy_context
from functools import partial
from types import CoroutineType
from typing import NamedTuple, Protocol, TypeAlias, cast

from turtleact.body import ActionType, Body, ServerOptions, Steps
from turtleact.errors import Abort, Cancel, InvalidMessage, InvalidTransition, TurtleactError
from turtleact.feedback import FeedbackLog
from turtleact.goal import CURRENT_GOAL, Goal, GoalEvent, GoalStatus, GoalTable
from turtleact.goal_id import new_goal_id
from turtleact.interfaces import Message, snapshotter
from turtleact.observers import BodyFailed, Lost, Observers
from turtleact.server.body_task import BodyTask
from turtleact.server.durable import DurableGoals
from turtleact.server.pausing import Pauses
from turtleact.summaries import CUT_OFF, STOPPED, STOPS, loggable, summary, text_of
from turtleact.tasks import Home, Signal, Tasks, is_cancellation, wait_while

__all__ = ["Execution", "FeedbackOutlet", "Served"]

logger = logging.getLogger("turtleact.server")

Check: TypeAlias = Callable[[object], Message]

_ENDS_PROGRAM = (KeyboardInterrupt, SystemExit)

# Members of enums that each goal needs. Python 3.11 looks them up slowly in their classes.
_CANCELING = GoalStatus.CANCELING
_CANCEL_GOAL, _SUCCEED, _CANCELED = GoalEvent.CANCEL_GOAL, GoalEvent.SUCCEED, GoalEvent.CANCELED

BURST = 16
"""After this many messages in a row, a generator that never waits must let other tasks run."""


class Served(NamedTuple):
    """What a server offers: its action, the action's name and its body.

    Attributes:
        name: The fully qualified name of the action.
        action_type: The action.
        body: The body to run.
        make_handle: Makes the handle for bodies and callbacks.
        home: The event loop in which the server must be used.
        node: The fully qualified name of the node.
    """

    name: str
    action_type: ActionType[Message, Message, Message]
    body: Body
    make_handle: Callable[[Execution, Goal], object]
    home: Home
    node: str


class FeedbackOutlet(Protocol):
    """The feedback topic, as long as somebody reads it."""

    @property
    def is_congested(self) -> bool:
        """Whether bodies should wait before they publish more."""

    def emit(self, goal: Goal, feedback: object) -> bool:
        """Send a body's feedback if nobody needs a copy; return whether it was sent."""

    def publish(self, goal: Goal, message: Message) -> None:
        """Send a checked copy of feedback."""

    async def drained(self) -> None:
        """Wait until the topic is not congested. Cancelling: safe."""


class Execution:
    """Runs the goals of one server.

    Args:
        served: The action, its name and its body.
        table: The goals that the server holds.
        tasks: The task functions of the event loop.
        now: A function that returns the current time (ns since the epoch).
        release: Called when a goal ends. It may return a callable that starts the next goal. None
            if goals never wait for one another.
        options: The server's options, for pausing.

    Attributes:
        served: The argument ``served``.
        check_result: Checks and copies a result.
        observers: The objects that hear of each change of a goal and, if they want it, of feedback.
        outlet: The feedback topic; None while nobody reads it.
        bodies: The tasks of the running bodies, with their goals.
        durable: The goals in the server's journal, if it has one.
        pauses: Pauses goals.
        is_suspended: Whether bodies are being stopped while their goals stay unfinished in the
            journal.
    """

    def __init__(
        self,
        served: Served,
        table: GoalTable,
        tasks: Tasks,
        now: Callable[[], int],
        release: Callable[[Goal], Callable[[], object] | None] | None,
        options: ServerOptions,
    ) -> None:
        self.served = served
        self.observers = Observers(served.name)
        self.durable: DurableGoals | None = None
        self.pauses = Pauses(served.body, options, self, tasks, now)
        self.outlet: FeedbackOutlet | None = None
        self.is_suspended = False
        self.bodies: dict[BodyTask, Goal] = {}
        self._body, self._name = served.body, served.name
        self._table = table
        self._tasks = tasks
        self._now = now
        self._release = release
        self._ended: Signal = tasks.signal()
        self._result_type = cast("type[Message]", served.action_type.Result)
        feedback_type = cast("type[Message]", served.action_type.Feedback)
        self._check_feedback = cast("Check", snapshotter(feedback_type, root="feedback"))
        self.check_result = cast("Check", snapshotter(self._result_type, root="result"))

    # running

    def start(self, goal: Goal, context: Context | None = None) -> None:
        """Run a goal's body in its own task, in ``context`` or a copy of the current context.

        If an observer has already canceled the goal, the goal ends at once.
        """
        if goal.status is _CANCELING or goal.reason:
            self._end_canceled(goal)
        if goal.is_decided:
            return
        if self.observers.want_bodies:
            context = copy_context() if context is None else context
            context.run(self.observers.enter_body, goal)
        task = goal.body = BodyTask(self, goal, self._tasks)
        self.bodies[task] = goal
        task.start(self._name, context)

    def open_body(self, goal: Goal, task: BodyTask) -> Coroutine[object, object, object]:
        """Return the coroutine that runs a goal's body. Called in the body's task."""
        CURRENT_GOAL.set(goal)  # only in this task's context
        goal.runner = self
        if goal.hold is not None:
            return self._run_when_resumed(goal, task)
        return self._call_body(goal, task)

    async def _run_when_resumed(self, goal: Goal, task: BodyTask) -> object:
        """Run a body that begins paused."""
        await self.pauses.stand(goal)
        return await self._call_body(goal, task)

    def _call_body(self, goal: Goal, task: BodyTask) -> Coroutine[object, object, object]:
        body = self._body
        if body.wants_handle:
            running = body.call(goal.request, self.make_handle(goal))
        else:
            running = body.call(goal.request)
        task.body = running
        if isinstance(running, CoroutineType):
            return running
        if body.is_generator:
            return self._drive(goal, cast("Steps", running))
        return _awaiting(cast("Awaitable[object]", running))

    def close_body(self, goal: Goal, task: BodyTask, error: BaseException) -> None:
        """End a goal after its body. ``error`` is StopIteration if the body has returned."""
        try:
            if isinstance(error, StopIteration):
                self._succeed(goal, error.value)
            else:
                self._fail(goal, error)
        except BaseException as raised:  # an observer stops the program
            self._fail(goal, raised)
        finally:
            self.bodies.pop(task, None)
            self._ended.fire()

    async def _drive(self, goal: Goal, steps: Steps) -> object:
        """Run a generator to its end. Return its result, or None if it yielded no result."""
        # Everything that happens between two steps belongs to the body: a feedback message that
        # does not fit, a cancellation during a pause, an error while publishing. It is thrown in at
        # the `yield`, where the body can handle it. If the body does not, the exception comes
        # back out of `athrow` and the generator is finished; `aclose` then does nothing.
        result_type, step = self._result_type, steps.asend
        countdown = BURST
        try:
            item = await step(None)
            while type(item) is not result_type:
                try:
                    if self._publish_or_emit(goal, item):
                        countdown = 1  # a callback has cancelled the goal: deliver that now
                    if goal.hold is not None:
                        await self.pauses.stand(goal)
                    countdown -= 1
                    if not countdown:
                        countdown = BURST
                        await self._yield_turn(goal)
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
            result = self.check_result(item)  # copied now, since the body may change it later
        except InvalidMessage as misfit:
            await steps.aclose()
            raise Abort(f"the body's result does not fit: {misfit}") from None
        await _finish(steps)
        return result

    def _publish_or_emit(self, goal: Goal, feedback: object) -> bool:
        """Publish feedback. Return whether a callback or observer has canceled the goal.

        Without a journal, this repeats the work of `publish`, because another call for each message
        would be too slow.
        """
        if self.durable is not None:
            self.publish(goal, feedback)
            return False  # callbacks and observers hear of it later
        outlet = self.outlet
        if outlet is not None and not self.observers.want_feedback and outlet.emit(goal, feedback):
            return False
        status, reason = goal.status, goal.reason
        message = self._check_feedback(feedback)
        if goal.is_decided:
            raise InvalidTransition(status, "feedback", goal.hex)
        self._announce(goal, message)
        return goal.status is not status or goal.reason is not reason

    async def _yield_turn(self, goal: Goal) -> None:
        """Let other tasks run. If the sender's stream is far behind, wait for it."""
        await self._tasks.checkpoint()
        if self.durable is not None:
            await self.durable.written()
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
        """Copy feedback and pass it to every reader.

        Raises:
            InvalidMessage: if the message is not this action's Feedback, or a value does not fit
                its type.
            InvalidTransition: if the goal is neither EXECUTING nor CANCELING.
        """
        message = self._check_feedback(feedback)
        if goal.is_decided or goal.status is GoalStatus.ACCEPTED:
            raise InvalidTransition(goal.status, "feedback", goal.hex)
        if self.durable is None:
            self._announce(goal, message)
        else:
            self.durable.feedback(goal, message, partial(self._announce_written, goal, message))

    def set_partial_result(self, goal: Goal, result: object) -> None:
        """Set the result to report if the goal is canceled or aborted.

        Raises:
            InvalidMessage: if the message is not this action's Result, or a value does not fit its
                type.
            InvalidTransition: if the goal has ended.
        """
        if goal.is_decided:
            raise InvalidTransition(goal.status, "a partial result", goal.hex)
        goal.result = self.check_result(result)
        if self.durable is not None:
            self.durable.partial_result(goal)

    def _announce_written(self, goal: Goal, message: Message) -> None:
        """Pass on feedback that is now in the journal, unless the server was stopped meanwhile."""
        if not goal.ended:
            self._announce(goal, message)

    def _announce(self, goal: Goal, message: Message) -> None:
        """Pass a copy of feedback to every reader."""
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
            except BaseException as error:  # also a stray cancellation: this body was not cancelled
                told = loggable(error)
                logger.error("the feedback_callback of goal %s failed", goal.hex, exc_info=told)
        if self.outlet is not None:
            self.outlet.publish(goal, message)
        if self.observers.want_feedback:
            self.observers.feedback_published(goal, message)

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        """Warn about a step that blocked the event loop. A suspended process looks the same."""
        logger.warning(
            "a step of the body of %s took %.1f s (goal %s): nothing else could run meanwhile;"
            " unless the process was stopped, await what waits, and move long work to"
            " anyio.to_thread.run_sync",
            self.served.name,
            seconds,
            goal.hex,
        )

    def make_handle(self, goal: Goal) -> object:
        """Make the handle of a goal for its body and the callbacks."""
        return self.served.make_handle(self, goal)

    # changing and ending

    def name_goal(self, goal: Goal) -> bytes:
        """Return the goal's id. A goal without an id gets one, and can then be found by it."""
        return goal.id or self._table.name(goal, new_goal_id(), self._now())

    def move(self, goal: Goal, event: GoalEvent) -> None:
        """Change a goal's state and tell the observers.

        Raises:
            InvalidTransition: if the state does not allow the event. Nothing changed.
        """
        before = goal.status
        goal.apply(event)
        if event is _CANCEL_GOAL:
            self.pauses.end(goal)
        if self.durable is not None and not goal.is_decided:
            self.durable.moved(goal)
        if self.observers.are_any:
            self.observers.goal_changed(goal, before, goal.status)

    def drop(self, goal: Goal) -> None:
        """End a goal that waits for its turn."""
        if goal.status is GoalStatus.ACCEPTED:
            self.move(goal, GoalEvent.EXECUTE)
        self._end_canceled(goal)
        self._ended.fire()  # no body ends here, which would fire it

    def end_unstarted(self, goal: Goal) -> None:
        """End a goal that was canceled before its body took the first step."""
        if not goal.is_decided:
            task = goal.body
            self._end_canceled(goal)
            if isinstance(task, BodyTask):
                self.bodies.pop(task, None)
                self._ended.fire()

    def end(self, goal: Goal, event: GoalEvent, result: object, reason: str = "") -> None:
        """Decide how a goal ends, and announce the end.

        With a journal, announce it once it is on disk.

        If the goal's end is decided already, for example because its body was given up, this does
        nothing. While `is_suspended` is true, a goal ends only by a success or a client's cancel.
        """
        if goal.is_decided:
            return
        goal.body = None
        if self.is_suspended and goal.status is not _CANCELING and event is not _SUCCEED:
            return
        if goal.is_paused or goal.hold is not None or goal.children:
            self.pauses.leave(goal)
        goal.is_decided = True
        if result is not None:
            goal.result = result
        elif goal.result is None:
            goal.result = self._result_type()
        if self.durable is None:
            self._announce_end(goal, event, reason)
        else:
            announce = partial(self._announce_written_end, goal, event, reason)
            self.durable.end(goal, event, reason, announce)

    def lose(self, goal: Goal, error: TurtleactError) -> None:
        """Tell everybody who waits for a goal that its server has stopped before the goal ended."""
        goal.is_decided = True
        before = goal.status
        goal.error, goal.status = error, GoalStatus.UNKNOWN
        goal.leave_parent()
        self._table.end(goal, self._now())
        if self.observers.are_any:
            self.observers.noted(goal, Lost(before))
        if goal.listener is not None:
            goal.listener.fire()
        self._call_back(goal)

    def _announce_written_end(self, goal: Goal, event: GoalEvent, reason: str) -> None:
        """End a goal after its end is in the journal, unless the server was stopped meanwhile."""
        if not goal.ended:
            self._announce_end(goal, event, reason)
            self._ended.fire()

    def _announce_end(self, goal: Goal, event: GoalEvent, reason: str) -> None:
        """End a goal, and tell its readers and waiters."""
        goal.reason = reason
        if goal.parent is not None:
            goal.leave_parent()
        goal.on_feedback = None
        before = goal.status
        goal.apply(event)
        self._table.end(goal, self._now())
        start_next = None if self._release is None else self._release(goal)
        # The next goal gets the place before observers hear of the end, but starts only later: it
        # must not run inside the step of the body that has just ended.
        if self.observers.are_any:
            self.observers.goal_changed(goal, before, goal.status)
        if goal.end_callbacks:
            self._call_back(goal)
        if start_next is not None:
            self._tasks.call_soon(start_next)

    def _call_back(self, goal: Goal) -> None:
        callbacks, goal.end_callbacks = goal.end_callbacks, ()
        for callback in callbacks:
            callback()

    def _succeed(self, goal: Goal, result: object) -> None:
        if result is None or not self._body.is_generator:  # `_drive` has checked the others
            try:
                result = self.check_result(result)
            except InvalidMessage as error:
                why = "no result" if result is None else f"the body's result does not fit: {error}"
                self.end(goal, GoalEvent.ABORT, None, why)
                return
        self.end(goal, _SUCCEED, result)

    def _fail(self, goal: Goal, error: BaseException) -> None:
        canceling = goal.status is _CANCELING
        if is_cancellation(error, self._tasks):
            self._end_canceled(goal)
            # The traceback leads to the frames that have thrown the cancellation in, and they refer
            # to the cancellation: a cycle for each goal, which only the garbage collector frees.
            error.__traceback__ = None
        elif (stop := _stop_in(error)) is not None:
            self.end(goal, GoalEvent.ABORT, None, STOPPED)
            self._tasks.stop_program(stop)
        elif isinstance(error, Abort):
            self._end_with(goal, GoalEvent.ABORT, error.result, text_of(error.reason))
        elif isinstance(error, Cancel) and (canceling or goal.reason):
            event = GoalEvent.CANCELED if canceling else GoalEvent.ABORT
            self._end_with(goal, event, error.result, "" if canceling else goal.reason)
        else:
            name, told = self.served.name, loggable(error)
            logger.error("the body of goal %s of %s failed", goal.hex, name, exc_info=told)
            if self.observers.are_any:
                self.observers.noted(goal, BodyFailed(error))
            self.end(goal, GoalEvent.ABORT, None, summary(error))

    def _end_canceled(self, goal: Goal) -> None:
        """End a goal that was canceled: CANCELED if a client asked for that, otherwise ABORTED."""
        if goal.status is _CANCELING:
            self.end(goal, _CANCELED, None)
        else:
            self.end(goal, GoalEvent.ABORT, None, goal.reason or CUT_OFF)

    def _end_with(self, goal: Goal, event: GoalEvent, result: object, reason: str) -> None:
        """End a goal with the body's own result, if the result fits its type."""
        if result is not None:
            try:
                result = self.check_result(result)
            except InvalidMessage as error:
                result, reason = None, f"{reason} (its result does not fit: {error})"
        self.end(goal, event, result, reason)

    # closing

    async def wait_until_idle(self) -> None:
        """Wait until no goal waits or runs. Cancelling: safe."""
        while self._table.active or self.bodies:
            await self._ended.wait()

    async def wait_for_bodies(self, grace: float, reason: str) -> None:
        """Wait until all bodies have ended, shielded from cancellation. Give up slow bodies.

        A body that ignores its cancellation for ``grace`` seconds (event loop time) is given up:
        its goal ends ABORTED, and the log says where the body stands. asyncio can abandon the task
        of such a body. trio cannot, so on trio this keeps waiting.

        Args:
            grace: How long bodies may clean up (s).
            reason: The reason of goals that end because their bodies are given up.
        """
        await wait_while(lambda: self.bodies, self._ended, grace)
        for task, goal in list(self.bodies.items()):
            logger.error(
                "the body of %s ignores its cancellation and is given up: goal %s, at %s",
                self.served.name,
                goal.hex,
                task.position,
            )
            task.cancel()  # once more, in case the body has swallowed the first
            self.end(goal, GoalEvent.ABORT, None, goal.reason or reason)
        if self.durable is not None and not self.is_suspended:
            await wait_while(lambda: self._table.active, self._ended, grace)
        if self.bodies and not self._tasks.can_let_go:
            logger.error("%s waits for its bodies: trio cannot let go of a task", self.served.name)
            await wait_while(lambda: self.bodies, self._ended, math.inf)


async def _awaiting(running: Awaitable[object]) -> object:
    return await running


async def _finish(steps: Steps) -> None:
    """Resume a generator that has yielded its result. The result stands, whatever happens then."""
    try:
        extra = await steps.asend(None)
        logger.warning("a body yielded %s after its result; it is closed", type(extra).__name__)
        await steps.aclose()
    except StopAsyncIteration:
        return
    except (GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except Exception as error:
        problem = "a body failed after it had yielded its result; the result stands"
        logger.error(problem, exc_info=loggable(error))
    except BaseException:
        logger.info("a body was canceled after it had yielded its result; the result stands")


def _stop_in(error: BaseException) -> BaseException | None:
    """The `SystemExit` or `KeyboardInterrupt` that ends the program, alone or in a group.

    asyncio's task groups raise such an exception unchanged. trio's nurseries wrap it.
    """
    if isinstance(error, BaseExceptionGroup):
        return next(filter(None, map(_stop_in, error.exceptions)), None)
    return error if isinstance(error, _ENDS_PROGRAM) else None
