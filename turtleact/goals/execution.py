"""Runs goals: starts the body, publishes its feedback, and ends the goal when the body ends.

A generator body is not iterated with ``async for``. With ``async for``, a body canceled at a
``yield`` would get GeneratorExit instead of the cancellation. A timeout or task group around the
``yield`` would not work. Instead, one task steps the generator. If a cancellation or error occurs
between two steps, the task raises the exception at the ``yield``. In every case, the task closes
the generator.

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

from turtleact.errors import Abort, Cancel, InvalidMessage, InvalidTransition, TurtleactError
from turtleact.goals.body import ActionType, Body, ServerOptions, Steps
from turtleact.goals.body_task import BodyTask
from turtleact.goals.durable import DurableGoals
from turtleact.goals.feedback import FeedbackLog
from turtleact.goals.ids import new_goal_id
from turtleact.goals.observers import BodyFailed, Lost, Observers
from turtleact.goals.pausing import Pauses
from turtleact.goals.state import CURRENT_GOAL, Goal, GoalEvent, GoalStatus, GoalTable
from turtleact.interfaces import Message, snapshotter
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
        make_handle: A function that makes the goal handle for bodies and callbacks.
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
    """The feedback topic of a server, which is used only while somebody reads the topic."""

    @property
    def is_congested(self) -> bool:
        """Whether bodies should wait before they publish more."""

    def publish(self, goal: Goal, message: Message) -> None:
        """Send a message that is already a checked copy of the feedback."""

    async def drained(self) -> None:
        """Wait until the topic is not congested. Cancelling: safe."""


class Execution:
    """Runs the goals of one server.

    Args:
        served: The action, its name and its body.
        table: The goals that the server holds.
        tasks: The functions that start and manage tasks on asyncio or trio.
        now: A function that returns the current time (ns since the epoch).
        release: A function called with each goal that ends. It may return a function that starts
            the next goal. ``release`` is None if goals never wait for one another.
        options: The server's options. This class uses only the options for pausing.

    Attributes:
        served: The action, its name and its body, as passed to the constructor.
        check_result: A function that validates a result and returns a copy of it.
        observers: The objects that are told of each change of a goal; some also get feedback.
        outlet: The feedback topic; None while nobody reads it.
        bodies: The tasks of the running bodies, each with its goal.
        durable: The goals in the server's journal; None if it has none.
        pauses: The object that pauses and resumes the goals.
        is_suspended: Whether the server is stopping bodies without ending their goals. The journal
            keeps these goals, which continue after a restart.
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
        """Run a goal's body in its own task, with ``context`` or a copy of the current context.

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
        """Run the body of a goal that begins paused, once the goal is resumed."""
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
        """End a goal whose body has ended. ``error`` is StopIteration if the body has returned."""
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
                    status, reason = goal.status, goal.reason
                    self.publish(goal, item)
                    if goal.status is not status or goal.reason is not reason:
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
        await self._finish(steps)
        return result

    async def _yield_turn(self, goal: Goal) -> None:
        """Let other tasks run, and wait while the journal or a reader of feedback is far behind."""
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
        """Publish feedback, unless the server was stopped meanwhile.

        The journal calls this function when the feedback is on disk, or when the disk is full.
        """
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
                problem = "the feedback_callback of a goal of %s failed%s"
                logger.error(problem, self.served.name, goal.suffix, exc_info=told)
        if self.outlet is not None:
            self.outlet.publish(goal, message)
        if self.observers.want_feedback:
            self.observers.feedback_published(goal, message)

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        """Warn about a step that blocked the event loop.

        If the whole process was suspended during the step, the warning is a false alarm.
        """
        logger.warning(
            "the body of %s blocked the event loop for %.1f s%s, so nothing else could run:"
            " use 'await asyncio.sleep' instead of 'time.sleep', and run long work in a thread with"
            " 'await anyio.to_thread.run_sync' (ignore this if the process was suspended)",
            self.served.name,
            seconds,
            goal.suffix,
        )

    def make_handle(self, goal: Goal) -> object:
        """Make the handle of a goal for its body and the callbacks."""
        return self.served.make_handle(self, goal)

    # changing and ending

    def name_goal(self, goal: Goal) -> bytes:
        """Return the goal's id. If the goal has no id yet, give it one."""
        return goal.id or self._table.name(goal, new_goal_id(), self._now())

    def move(self, goal: Goal, event: GoalEvent) -> None:
        """Change a goal's state and tell the observers.

        Raises:
            InvalidTransition: if the goal's state does not allow the event. The goal then keeps its
                state.
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

        With a journal, the end is announced once it is on disk.

        This does nothing if the goal's end is already decided, for example because the body was
        given up. While `is_suspended` is true, the goal ends only if it has succeeded or a client
        has canceled it; any other goal stays unfinished in the journal.
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
        start_next = None if self._release is None else self._release(goal)
        if self.observers.are_any:
            self.observers.noted(goal, Lost(before))
        if goal.listener is not None:
            goal.listener.fire()
        self._call_back(goal)
        if start_next is not None:  # the goal of another server that shares the slot
            self._tasks.call_soon(start_next)

    def _announce_written_end(self, goal: Goal, event: GoalEvent, reason: str) -> None:
        """Announce that a goal has ended, unless the server was stopped meanwhile.

        The journal calls this function when the goal's end is on disk.
        """
        if not goal.ended:
            self._announce_end(goal, event, reason)
            self._ended.fire()

    def _announce_end(self, goal: Goal, event: GoalEvent, reason: str) -> None:
        """End a goal, and tell its observers and those who wait for it."""
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
        generates = self._body.is_generator
        if result is None or not generates:  # `_drive` has checked the others
            try:
                result = self.check_result(result)
            except InvalidMessage as error:
                why = f"the body's result does not fit: {error}"
                if result is None:
                    ending = (
                        "the last value yielded must be" if generates else "the body must return"
                    )
                    why = f"no result: {ending} a Result"
                self.end(goal, GoalEvent.ABORT, None, why)
                return
        self.end(goal, _SUCCEED, result)

    async def _finish(self, steps: Steps) -> None:
        """Resume a generator that has yielded its result, so that it can end.

        If the generator fails or yields again, its result stays the same.
        """
        try:
            extra = type(await steps.asend(None)).__name__
            problem = (
                "the body of %s yielded %s after its result: this is ignored, and the body ends"
            )
            logger.warning(problem, self.served.name, extra)
            await steps.aclose()
        except StopAsyncIteration:
            return
        except (GeneratorExit, KeyboardInterrupt, SystemExit):
            raise
        except Exception as error:
            problem = "the body of %s failed after it had yielded its result; the result stands"
            logger.error(problem, self.served.name, exc_info=loggable(error))
        except BaseException:
            problem = (
                "the body of %s was canceled after it had yielded its result; the result stands"
            )
            logger.info(problem, self.served.name)

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
        elif goal.is_decided and isinstance(error, InvalidTransition) and error.goal_id == goal.hex:
            # The body was given up, which the log says already, and then gave feedback or a partial
            # result. This error only tells the body that its goal has ended.
            pass
        else:
            name, told = self.served.name, loggable(error)
            logger.error("the body of %s failed%s", name, goal.suffix, exc_info=told)
            if self.observers.are_any:
                self.observers.noted(goal, BodyFailed(error))
            self.end(goal, GoalEvent.ABORT, None, summary(error))

    def _end_canceled(self, goal: Goal) -> None:
        """End a goal whose body was cancelled or has not started.

        The goal ends CANCELED if a client has canceled the goal, otherwise ABORTED.
        """
        if goal.status is _CANCELING:
            self.end(goal, _CANCELED, None)
        else:
            self.end(goal, GoalEvent.ABORT, None, goal.reason or CUT_OFF)

    def _end_with(self, goal: Goal, event: GoalEvent, result: object, reason: str) -> None:
        """End a goal with the result that its body's exception carries.

        If the result is invalid, end the goal without it, and add the problem to ``reason``.
        """
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
        """Wait until all bodies have ended or are given up, shielded from cancellation.

        A body that ignores its cancellation for ``grace`` seconds (event loop time) is given up:
        its goal ends ABORTED, and the log tells in which line the body waits. asyncio can abandon
        the task of such a body. trio cannot, so on trio this method keeps waiting.

        Args:
            grace: How long bodies may clean up (s).
            reason: The reason for goals that end because their bodies are given up.
        """
        await wait_while(lambda: self.bodies, self._ended, grace)
        for task, goal in list(self.bodies.items()):
            logger.error(
                "the body of %s ignores its cancellation at %s, so it is given up%s",
                self.served.name,
                task.position,
                goal.suffix,
            )
            task.cancel()  # once more, in case the body has swallowed the first
            self.end(goal, GoalEvent.ABORT, None, goal.reason or reason)
        if self.durable is not None and not self.is_suspended:
            await wait_while(lambda: self._table.active, self._ended, grace)
        if self.bodies and not self._tasks.can_let_go:
            logger.error(
                "the server of %s waits until its bodies end: trio cannot abandon a task",
                self.served.name,
            )
            await wait_while(lambda: self.bodies, self._ended, math.inf)


async def _awaiting(running: Awaitable[object]) -> object:
    return await running


def _stop_in(error: BaseException) -> BaseException | None:
    """Return the `SystemExit` or `KeyboardInterrupt` in an error or a group of errors, or None.

    asyncio's task groups raise these exceptions unchanged. trio's nurseries put them into groups.
    """
    if isinstance(error, BaseExceptionGroup):
        return next(filter(None, map(_stop_in, error.exceptions)), None)
    return error if isinstance(error, _ENDS_PROGRAM) else None
