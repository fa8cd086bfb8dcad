"""Runs the bodies of a server's goals, each in a task, and ends the goals with them.

A body always runs in a task of its own, no matter how the client waits for the goal. The server
owns the task, and therefore cancels the task and waits for its end.

A generator body is not iterated with ``async for``. With ``async for``, a body canceled at a
``yield`` would get GeneratorExit instead of the cancellation. A timeout or task group around the
``yield`` would not work. Instead, the task steps the generator itself. If a cancellation or error
occurs between two steps, it raises the exception at the ``yield``. In every case, it closes the
generator.

A step is the part of a body between two awaits. During a long step nothing else in the event loop
can run, so long steps are reported.

Source: PEP 525; PEP 789 for the hazards of generators; asyncio's debug mode, for the report of slow
callbacks; rclpy ``action/server.py`` for the names and the behaviour of the handle.
"""

from __future__ import annotations

import logging
import math
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine
from contextvars import Context, copy_context
from time import monotonic
from typing import Any, Final, Generic, Self, TypeAlias, TypeVar, cast

from turtleact.errors import (
    STOPPED,
    Abort,
    Cancel,
    InvalidMessage,
    summary,
    text_of,
)
from turtleact.goals.observers import BodyFailed
from turtleact.goals.records import Resumed
from turtleact.goals.server import GoalServer, LocalActionServer
from turtleact.goals.state import CURRENT_GOAL, Cancelable, Goal, GoalEvent, GoalStatus
from turtleact.interfaces import Message, stamp_of
from turtleact.interfaces.standard import Time
from turtleact.tasks import is_cancellation, wait_while

__all__ = [
    "BLOCKING",
    "BURST",
    "BodyRunner",
    "BodyTask",
    "GoalHandle",
]

logger = logging.getLogger("turtleact.server")

BLOCKING = 0.5
"""Steps that take longer than this time are reported (s, wall clock)."""

BURST: Final = 16
"""After this many messages in a row, a generator that never waits must let other tasks run."""

Steps: TypeAlias = AsyncGenerator[object, None]

_ENDS_PROGRAM = (KeyboardInterrupt, SystemExit)

# Members of enums that each goal needs. Python 3.11 looks them up slowly in their classes.
_CANCELING = GoalStatus.CANCELING
_EXECUTE = GoalEvent.EXECUTE
_SUCCEED = GoalEvent.SUCCEED


G = TypeVar("G", bound=Message)
R = TypeVar("R", bound=Message)
F = TypeVar("F", bound=Message)


class BodyRunner:
    """Runs the goals of one server: starts each body, and ends the goal when the body ends.

    Args:
        server: The server.

    Attributes:
        server: The server, as passed to the constructor.
        bodies: The running bodies.
    """

    def __init__(self, server: LocalActionServer) -> None:
        self.server = server
        self.bodies: set[BodyTask] = set()
        self._tasks = server.tasks
        server.start = self.start
        server.stop_bodies = self.stop
        server.count_bodies = lambda: len(self.bodies)

    def start(self, goal: Goal, context: Context | None) -> None:
        """Run a goal's body in its own task, with ``context`` or a copy of the current context.

        If an observer has already canceled the goal, the goal ends at once.
        """
        server = self.server
        if goal.status is GoalStatus.ACCEPTED:
            server.move(goal, _EXECUTE)
        if goal.status is _CANCELING or goal.reason:
            server.end_canceled(goal)
        if goal.is_ending:
            return
        if "enter_body" in server.observers.wanted:
            context = copy_context() if context is None else context
            context.run(server.observers.enter_body, goal)
        body = goal.body = BodyTask(self, goal)
        self.bodies.add(body)
        body.start(context)

    def close_body(self, body: BodyTask, error: BaseException) -> None:
        """End a goal whose body has ended. ``error`` is StopIteration if the body has returned."""
        try:
            if isinstance(error, StopIteration):
                self._succeed(body.goal, error.value)
            else:
                self._fail(body.goal, error)
        except BaseException as raised:  # an observer stops the program
            self._fail(body.goal, raised)
        finally:
            self.let_go(body)

    def let_go(self, body: BodyTask) -> None:
        """Forget a body that has ended, or that never starts."""
        self.bodies.discard(body)
        self.server.idle.fire()

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        """Warn about a step that blocked the event loop.

        If the whole process was suspended during the step, the warning is a false alarm.
        """
        logger.warning(
            "the body of %s blocked the event loop for %.1f s (goal %s), so nothing else could run:"
            " use 'await asyncio.sleep' instead of 'time.sleep', and run long work in a thread with"
            " 'await anyio.to_thread.run_sync' (ignore this if the process was suspended)",
            self.server.name,
            seconds,
            goal.hex,
        )

    # how a goal ends

    def _succeed(self, goal: Goal, result: object) -> None:
        try:
            checked = self.server.check_result(result)
        except InvalidMessage as error:
            why = f"the body's result does not fit: {error}"
            if result is None:
                why = "no result: the body must return a Result"
            self.server.end(goal, GoalEvent.ABORT, None, why)
        else:
            self.server.end(goal, _SUCCEED, checked, "")

    def _fail(self, goal: Goal, error: BaseException) -> None:
        server, canceling = self.server, goal.status is _CANCELING
        error = _verdict_in(error) or error
        if is_cancellation(error, self._tasks):
            server.end_canceled(goal)
            # The traceback leads to the frames that have thrown the cancellation in, and they refer
            # to the cancellation: a cycle for each goal, which only the garbage collector frees.
            error.__traceback__ = None
        elif (stop := _stop_in(error)) is not None:
            server.end(goal, GoalEvent.ABORT, None, STOPPED)
            self._tasks.stop_program(stop)
        elif isinstance(error, Abort):
            self._end_with(goal, GoalEvent.ABORT, error.result, text_of(error.reason))
        elif isinstance(error, Cancel) and (canceling or goal.reason):
            event = GoalEvent.CANCELED if canceling else GoalEvent.ABORT
            self._end_with(goal, event, error.result, "" if canceling else goal.reason)
        else:
            problem = "the body of %s failed (goal %s)"
            logger.error(problem, server.name, goal.hex, exc_info=error)
            if server.observers.are_any:
                server.observers.noted(goal, BodyFailed(error))
            server.end(goal, GoalEvent.ABORT, None, summary(error))

    def _end_with(self, goal: Goal, event: GoalEvent, result: object, reason: str) -> None:
        """End a goal with the result that its body's exception carries.

        If the result is invalid, end the goal without it, and add the problem to ``reason``.
        """
        if result is not None:
            try:
                result = self.server.check_result(result)
            except InvalidMessage as error:
                problem = f"(its result does not fit: {error})"
                result, reason = None, f"{reason} {problem}" if reason else problem
        self.server.end(goal, event, result, reason)

    # closing

    async def stop(self, reason: str) -> None:
        """Wait until all bodies have ended or are given up, shielded from cancellation.

        A body that ignores its cancellation for the server's ``grace`` is given up: its goal ends
        ABORTED, and the log tells in which line the body waits. asyncio can abandon the task of
        such a body. trio cannot, so on trio this method keeps waiting.

        Args:
            reason: The reason for goals that end because their bodies are given up.
        """
        server = self.server
        await wait_while(lambda: self.bodies, server.idle, server.grace)
        for body in list(self.bodies):
            logger.error(
                "the body of %s ignores its cancellation at %s, so it is given up (goal %s)",
                server.name,
                body.position,
                body.goal.hex,
            )
            body.cancel()  # once more, in case the body has swallowed the first
            server.end(body.goal, GoalEvent.ABORT, None, body.goal.reason or reason)
        if self.bodies and not self._tasks.can_let_go:
            logger.error(
                "the server of %s waits until its bodies end: trio cannot abandon a task",
                server.name,
            )
            await wait_while(lambda: self.bodies, server.idle, math.inf)


class BodyTask(Coroutine[object, object, None]):
    """The coroutine of a body's task. It runs the body step by step, and then ends the goal.

    This object resumes the body itself, because it measures how long each step takes. The task runs
    this object as its coroutine, because a separate coroutine would need 290 bytes for each goal.

    Args:
        runner: The runner of the server.
        goal: The goal.

    Attributes:
        runner: The runner, as passed to the constructor.
        goal: The goal, as passed to the constructor.
        source: The coroutine or generator that the user's function returned; None until the
            function has been called.
        gate: What the body awaits before its next step; None if the body may go on.
        children: The goals that the body has sent, each with its server. Goals that have ended may
            be among them.
        on_child: Called with each goal that the body sends, and the goal's server.
    """

    __slots__ = (
        "_is_cancel_due",
        "_is_dropped",
        "_prune_at",
        "_steps",
        "_task",
        "children",
        "gate",
        "goal",
        "on_child",
        "runner",
        "source",
    )

    def __init__(self, runner: BodyRunner, goal: Goal) -> None:
        self.goal = goal
        self.source: Any = None
        self.gate: Callable[[], Awaitable[None]] | None = None
        self.children: dict[Goal, GoalServer] = {}
        self.on_child: Callable[[Goal, GoalServer], None] | None = None
        self.runner = runner
        self._steps: Coroutine[object, object, object] | None = None
        self._task: Cancelable | None = None
        self._is_cancel_due = False
        self._is_dropped = False
        self._prune_at = 16

    def start(self, context: Context | None) -> None:
        """Start the task in ``context``, or in a copy of the current context."""
        server = self.runner.server
        self._task = server.tasks.spawn(self, server.name, context)

    def cancel(self) -> None:
        """Cancel the body at its next await outside a shield.

        If the body has not started yet, it never starts.
        """
        # There are three cases. (1) The body has not begun: `send` never begins it. The goal ends
        # now. (2) The task is in an anyio shield, which `asyncio.Task.cancel` would break: `send`
        # cancels after the step that leaves the shield. (3) Otherwise the task is cancelled now.
        if self._steps is None:
            self._is_dropped = True
            self._end_unstarted()
        elif self._task is not None:
            if self.gate is not None:
                self.goal.changed.fire()  # a shielded body must leave the gate, too
            self._is_cancel_due = self.runner.server.tasks.is_shielded(self._task)
            if not self._is_cancel_due:
                self._task.cancel()

    def add_child(self, goal: Goal, server: GoalServer) -> None:
        """Note a goal that this body has sent."""
        # Not each time: a body may have sent thousands that still run.
        if len(self.children) >= self._prune_at:
            self.children = {each: its for each, its in self.children.items() if not each.ended}
            self._prune_at = 2 * len(self.children) + 16
        self.children[goal] = server
        if self.on_child is not None:
            self.on_child(goal, server)

    @property
    def position(self) -> str:
        """The file, line and function where the body waits; empty once the body has ended."""
        for attribute in ("cr_frame", "ag_frame"):
            frame = getattr(self.source, attribute, None)
            if frame is not None:
                code = frame.f_code
                return f"{code.co_filename}:{frame.f_lineno} in {code.co_qualname}"
        return ""

    async def wait_at_gate(self) -> None:
        """Wait until there is no gate."""
        while self.gate is not None:
            await self.gate()

    # The coroutine protocol; the event loop calls these methods.

    def send(self, value: Any) -> object:  # noqa: ANN401  # whatever the loop sends
        """Run one step of the body."""
        return self._step(self._begin if self._steps is None else self._steps.send, value)

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Raise an exception in the body, which then runs one step."""
        if self._steps is not None:
            return self._step(self._steps.throw, error)
        # The program ends and cancels a task that has not begun.
        self._end_unstarted()
        raise error

    def close(self) -> None:
        """Close the body."""
        if self._steps is not None:
            self._steps.close()

    def __await__(self) -> Self:
        return self

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> object:
        return self._step(self._begin if self._steps is None else self._steps.send, None)

    def _begin(self, value: Any) -> object:  # noqa: ANN401  # as `send`
        """Run the first step, unless the body has been cancelled or the goal has ended already."""
        if self._is_dropped or self.goal.is_ending:
            raise StopIteration
        CURRENT_GOAL.set(self.goal)  # only in this task's context
        self._steps = self._open() if self.gate is None else self._open_after_gate()
        return self._steps.send(value)

    def _open(self) -> Coroutine[object, object, object]:
        """Call the user's function, and return the coroutine that does the work."""
        server, goal = self.runner.server, self.goal
        body = server.spec.body
        self.source = body.call(goal.request, lambda: server.make_handle(goal))
        return self._drive(self.source) if body.is_generator else self.source

    async def _open_after_gate(self) -> object:
        """Run the body of a goal that begins paused, once the goal is resumed."""
        await self.wait_at_gate()
        return await self._open()

    async def _drive(self, steps: Steps) -> Message:
        """Run a generator to its end, and return its result.

        Raises:
            Abort: if the generator yielded no result, or a result that does not fit.
        """
        # Everything that happens between two steps belongs to the body: a feedback message that
        # does not fit, a cancellation during a pause, an error while publishing. It is thrown in at
        # the `yield`, where the body can handle it. If the body does not, the exception comes back
        # out of `athrow` and the generator is finished; `aclose` then does nothing.
        server, goal, step = self.runner.server, self.goal, steps.asend
        countdown = BURST
        try:
            item = await step(None)
            while type(item) is not server.result_type:
                try:
                    status, reason = goal.status, goal.reason
                    server.publish(goal, item)
                    if goal.status is not status or goal.reason is not reason:
                        countdown = 1  # a callback has cancelled the goal: deliver that now
                    if self.gate is not None:
                        await self.wait_at_gate()
                    countdown -= 1
                    if not countdown:
                        countdown = BURST
                        await server.catch_up(goal)
                except GeneratorExit:
                    raise
                except BaseException as error:
                    item = await steps.athrow(error)
                else:
                    item = await step(None)
        except StopAsyncIteration:
            raise Abort("no result: the last value yielded must be a Result") from None
        except BaseException:
            await steps.aclose()
            raise
        try:
            result = server.check_result(item)  # copied now, since the body may change it later
        except InvalidMessage as misfit:
            await steps.aclose()
            raise Abort(f"the body's result does not fit: {misfit}") from None
        await _finish(server.name, steps)
        return result

    def _end_unstarted(self) -> None:
        """End the goal before its body has taken the first step."""
        self.runner.server.end_canceled(self.goal)
        self.runner.let_go(self)

    def _step(self, resume: Callable[[Any], object], value: object) -> object:
        """Resume the body, and report the step if it blocks the event loop for long."""
        began = monotonic()
        try:
            waits_for = resume(value)
        except BaseException as error:
            self._task = None  # breaks the cycle with the task, so that both are freed at once
            self.runner.close_body(self, error)
            raise StopIteration from None  # the task has ended, too
        finally:
            if (took := monotonic() - began) > BLOCKING:
                self.runner.report_blocking(self.goal, took)
        if self._is_cancel_due:
            self.cancel()
        return waits_for


async def _finish(action: str, steps: Steps) -> None:
    """Resume a generator that has yielded its result, so that it can end.

    If the generator fails or yields again, its result stays the same.
    """
    try:
        extra = type(await steps.asend(None)).__name__
        problem = "the body of %s yielded %s after its result: this is ignored, and the body ends"
        logger.warning(problem, action, extra)
        await steps.aclose()
    except StopAsyncIteration:
        return
    except (GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except Exception as error:
        problem = "the body of %s failed after it had yielded its result; the result stands"
        logger.error(problem, action, exc_info=error)
    except BaseException:
        problem = "the body of %s was canceled after it had yielded its result; the result stands"
        logger.info(problem, action)


def _verdict_in(error: BaseException) -> BaseException | None:
    """Return the `Abort` or `Cancel` that is the only exception in groups of errors, or None.

    A body may raise it in a task group, which puts it into a group.
    """
    while isinstance(error, BaseExceptionGroup) and len(error.exceptions) == 1:
        error = error.exceptions[0]
    return error if isinstance(error, Abort | Cancel) else None


def _stop_in(error: BaseException) -> BaseException | None:
    """Return the `SystemExit` or `KeyboardInterrupt` in an error or a group of errors, or None.

    asyncio's task groups raise these exceptions unchanged. trio's nurseries put them into groups.
    """
    if isinstance(error, BaseExceptionGroup):
        return next(filter(None, map(_stop_in, error.exceptions)), None)
    return error if isinstance(error, _ENDS_PROGRAM) else None


class GoalHandle(Generic[G, R, F]):
    """Gives a body access to its goal.

    The subclass `turtleact.ServerGoalHandle` also gives access to the node.
    """

    __slots__ = ("_goal", "_server")

    def __init__(self, server: LocalActionServer, goal: Goal) -> None:
        self._server = server
        self._goal = goal

    @property
    def action_name(self) -> str:
        """The fully qualified name of the action."""
        return self._server.name

    @property
    def goal_id(self) -> bytes:
        """The goal's id, 16 bytes."""
        return self._goal.id

    @property
    def stamp(self) -> Time:
        """When the goal was accepted (ROS time)."""
        return stamp_of(self._goal.stamp)

    @property
    def status(self) -> GoalStatus:
        """The goal's state."""
        return self._goal.status

    @property
    def reason(self) -> str:
        """The reason for aborting the goal, known before or at its end; empty if there is none."""
        return self._goal.reason

    @property
    def request(self) -> G:
        """The goal message."""
        return cast("G", self._goal.request)

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a client has asked to cancel the goal and the server has agreed."""
        return self._goal.status is GoalStatus.CANCELING

    @property
    def resumed(self) -> Resumed[R, F] | None:
        """What an earlier process recorded of this goal; None if the goal began in this process.

        Only a server with a journal resumes goals; see ``on_restart`` of
        `turtleact.Node.action_server`.
        """
        return self._server.resumed.get(self._goal.id)

    @property
    def is_paused(self) -> bool:
        """Whether the goal is paused."""
        return self._server.pauses.is_paused(self._goal)

    @property
    def paused_time(self) -> float:
        """How long the goal has been paused so far (s, by the graph's clock).

        If your body measures time, subtract this value, so that pauses do not count.
        """
        return self._server.pauses.paused_time(self._goal)

    async def pause(self, timeout: float = 5.0) -> None:
        """Pause the goal, and return when the goal is paused.

        The goal's own body must not call this method, because the body would wait for itself.

        Args:
            timeout: How long the body may take to reach a ``yield`` or a checkpoint (s, event loop
                time). If the body takes longer, the goal is not paused and continues.

        Raises:
            PauseRefused: if the goal cannot be paused, or its body takes too long.
        """
        self._server.spec.home.check()
        await self._server.pauses.pause(self._goal, timeout)

    async def resume(self) -> None:
        """Resume a paused goal.

        Raises:
            PauseRefused: if ``on_resume`` fails, and the goal therefore stays paused.
        """
        self._server.spec.home.check()
        await self._server.pauses.resume(self._goal)

    async def checkpoint(self) -> None:
        """Let other tasks run. While the goal is paused, wait here.

        If you declare a coroutine body with ``pausable=True``, it must await this regularly.
        """
        await self._server.tasks.checkpoint()
        if isinstance(self._goal.body, BodyTask):
            await self._goal.body.wait_at_gate()

    def publish_feedback(self, feedback: F) -> None:
        """Send a copy of ``feedback``. You may then change ``feedback`` and send it again.

        Raises:
            InvalidMessage: if ``feedback`` is not this action's Feedback, or a value does not fit
                its type.
            InvalidTransition: if the goal is neither EXECUTING nor CANCELING.
            TurtleactError: if this is called in another thread or event loop.
        """
        self._server.spec.home.check()
        self._server.publish(self._goal, feedback)

    def set_partial_result(self, result: R) -> None:
        """Set the result to report if the goal is canceled or aborted.

        Raises:
            InvalidMessage: if ``result`` is not this action's Result, or a value does not fit its
                type.
            InvalidTransition: if the goal has ended.
            TurtleactError: if this is called in another thread or event loop.
        """
        self._server.spec.home.check()
        self._server.set_partial_result(self._goal, result)
