"""Coroutines run step by step: in the caller's own task, and with an eye on the clock.

A step is what happens between two waits. One that takes long keeps everybody else in the event loop
from running. A cancellation that finds a coroutine in a shielded scope is kept until the end of
the step in which it leaves that scope; trio does so by itself.

Source: ``asyncio.timeout`` for how a cancellation of one's own is told from that of others;
asyncio's debug mode for what is told of slow callbacks.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine, Generator
from contextvars import Context
from math import inf
from time import monotonic
from types import coroutine
from typing import Any, Protocol, Self, TypeVar, cast

from turtleact.body import Steps
from turtleact.goal import Cancelable, Goal
from turtleact.tasks import GRACE, Scope, Tasks

__all__ = ["BLOCKING", "Borrowed", "Owned", "finish", "is_closed_by_loop"]

T = TypeVar("T")

logger = logging.getLogger("turtleact.server")

BLOCKING = 0.5
"""A step that takes longer is reported (s)."""


class Reporter(Protocol):
    """Whom to tell of a step that has blocked the loop."""

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        """Say whose step it was, and how long it took."""

    def mark_canceling(self, goal: Goal) -> None:
        """Note that the caller's cancellation is the goal's."""


class Owned:
    """A goal's body that has a task of its own; awaiting it runs the body.

    Args:
        goal: The goal.
        reporter: Told of each step that blocks the loop.
        tasks: The tasks of the event loop.

    Attributes:
        body: The coroutine, to be set before this is awaited.
        task: The task; to be set before it is canceled.
    """

    __slots__ = ("_goal", "_is_due", "_reporter", "_tasks", "body", "task")

    body: Coroutine[object, object, object]
    task: Cancelable

    def __init__(self, goal: Goal, reporter: Reporter, tasks: Tasks) -> None:
        self._goal = goal
        self._reporter = reporter
        self._tasks = tasks
        self._is_due = False

    def cancel(self) -> None:
        """Let a cancellation arrive at the body's next await that is not shielded."""
        self._is_due = _is_shielded(self._tasks, self.task, None)
        if not self._is_due:
            self._tasks.cancel(self.task, f"{_BY_GOAL}{id(self):x}")

    def __await__(self) -> Self:
        return self

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> object:
        return self.send(None)

    def send(self, value: object) -> object:
        """Run one step."""
        began = monotonic()
        try:
            waits_for = self.body.send(value)
        finally:
            if (took := monotonic() - began) > BLOCKING:
                self._reporter.report_blocking(self._goal, took)
        if self._is_due:
            self.cancel()
        return waits_for

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Run one step that begins with an exception."""
        began = monotonic()
        try:
            waits_for = self.body.throw(error)
        finally:
            if (took := monotonic() - began) > BLOCKING:
                self._reporter.report_blocking(self._goal, took)
        if self._is_due:
            self.cancel()
        return waits_for

    def close(self) -> None:
        """Close the coroutine."""
        self.body.close()


class Borrowed:
    """A coroutine that runs inside the caller's own task (asyncio alone).

    `cancel` cancels the coroutine alone: the caller's task goes on once it has ended. A
    cancellation of the caller reaches the coroutine too, and is raised again at the end, whatever
    the coroutine made of it.

    A timeout or task group within the coroutine cancels the same task. Whose a cancellation was
    can be told once the coroutine has left these, for they take their own back: what is then left
    in ``Task.cancelling()`` came from outside. Those of anyio and of goals say at once whose they
    are.

    Args:
        context: What the coroutine runs in, a copy of the caller's: what it sets there stays there.
        goal: The goal that the coroutine runs for.
        reporter: Told of each step that blocks the loop, and of the caller's cancellation.
        tasks: The tasks of the event loop.
        outer: The scope that the caller was in before the first step.
    """

    __slots__ = (
        "_asked",
        "_before",
        "_context",
        "_goal",
        "_is_abandoned",
        "_is_due",
        "_is_on_its_way",
        "_outer",
        "_reporter",
        "_task",
        "_tasks",
        "_thrown",
        "_timer",
    )

    def __init__(
        self, context: Context, goal: Goal, reporter: Reporter, tasks: Tasks, outer: Scope | None
    ) -> None:
        task = cast("asyncio.Task[object]", asyncio.current_task())
        self._context = context
        self._goal = goal
        self._reporter = reporter
        self._tasks = tasks
        self._outer = outer
        self._task: asyncio.Task[object] | None = task
        is_on_its_way = task._must_cancel  # type: ignore[attr-defined]
        self._before = task.cancelling() - is_on_its_way
        self._asked = 0
        self._is_due = False
        self._is_on_its_way = False
        self._is_abandoned = False
        self._thrown: asyncio.CancelledError | None = None
        self._timer: asyncio.TimerHandle | None = None

    def cancel(self) -> None:
        """Let a cancellation arrive at the coroutine's next await that is not shielded."""
        if self._task is None:
            return
        self._is_due = not self._is_abandoned and _is_shielded(self._tasks, self._task, self._outer)
        if not self._is_due:
            self._asked += 1
            self._is_on_its_way = True
            self._task.cancel(f"{_BY_GOAL}{id(self):x}")

    def abandon(self) -> None:
        """Let the caller go on alone: the coroutine goes on, canceled, in a task of its own."""
        self._is_abandoned = True
        self.cancel()

    @property
    def is_caller_canceled(self) -> bool:
        """Whether somebody else has canceled the task; sure at the coroutine's end, not before."""
        task = self._task
        return task is not None and task.cancelling() > self._before + self._asked

    @coroutine
    def go_on(
        self, body: Coroutine[object, object, T], waits_for: object
    ) -> Generator[object, object, T | None]:
        """Run a coroutine that has had its first step, and waits for what it gave out then.

        A caller that is canceled waits `GRACE` seconds for the end, and abandons the coroutine.

        Args:
            body: The coroutine.
            waits_for: What its first ``send`` gave.
        """
        in_context, tasks = self._context.run, self._tasks
        value, began = None, inf
        try:
            while True:
                try:
                    answer = yield waits_for
                except GeneratorExit:
                    in_context(body.close)
                    raise
                except BaseException as thrown:
                    self._note(thrown)
                    if self._is_abandoned:
                        self._part(body)
                        break
                    began = monotonic()
                    tasks.depth += 1
                    waits_for = in_context(body.throw, thrown)
                else:
                    began = monotonic()
                    tasks.depth += 1
                    waits_for = in_context(body.send, answer)
                tasks.depth -= 1
                if (took := monotonic() - began) > BLOCKING:
                    self._reporter.report_blocking(self._goal, took)
                began = inf
                if self._is_due:
                    self.cancel()
        except StopIteration as end:
            value = end.value
        finally:
            if began < inf:  # in a step
                tasks.depth -= 1
            task = self._give_back()
            if (took := monotonic() - began) > BLOCKING:
                self._reporter.report_blocking(self._goal, took)
        if self._is_on_its_way:  # the end came before the cancellation
            try:
                yield None
            except asyncio.CancelledError as late:
                self._thrown = late
        if self._thrown is not None and task.cancelling() > self._before:
            try:
                raise self._thrown
            finally:
                self._thrown = None  # or the exception would hold itself
        return value

    def _note(self, thrown: BaseException) -> None:
        """Remember a cancellation that may be the caller's; a failed future is thrown in too."""
        if isinstance(thrown, asyncio.CancelledError):
            is_ours, self._is_on_its_way = self._is_on_its_way, False
            if self.is_caller_canceled and not (is_ours and self._thrown):
                self._thrown = thrown
                if self._is_from_outside(thrown):
                    self._reporter.mark_canceling(self._goal)
                if self._timer is None:
                    loop = asyncio.get_running_loop()
                    self._timer = loop.call_later(GRACE, self.abandon)

    def _is_from_outside(self, thrown: asyncio.CancelledError) -> bool:
        """Whether a scope or goal of the caller has canceled it; False if that cannot be told."""
        reason = str(thrown.args[0]) if thrown.args else ""
        if reason.startswith(_BY_GOAL):
            return reason != f"{_BY_GOAL}{id(self):x}"
        own = self._tasks.scopes(cast("asyncio.Task[object]", self._task), self._outer)
        return reason.startswith(_BY_SCOPE) and not any(
            reason.startswith(f"{_BY_SCOPE}{id(scope):x}") for scope in own
        )

    def _part(self, body: Coroutine[object, object, object]) -> None:
        """Go on with the coroutine, which waits, in a task of its own: its first step cancels."""
        from turtleact.tasks.on_asyncio import hand_over  # trio need not wait for its import

        loop = asyncio.get_running_loop()
        task = asyncio.Task(body, loop=loop, context=self._context)
        caller = cast("asyncio.Task[object]", self._task)
        hand_over(caller, list(self._tasks.scopes(caller, self._outer)), task)  # type: ignore[arg-type]  # asyncio's
        task.cancel()
        self._goal.body = task
        _ABANDONED.add(task)
        task.add_done_callback(_ABANDONED.discard)

    def _give_back(self) -> asyncio.Task[object]:
        """Take no more requests, and take those back that were made."""
        task = cast("asyncio.Task[object]", self._task)
        self._task = None
        if self._timer is not None:
            self._timer.cancel()
        for _ in range(self._asked):
            task.uncancel()
        return task


async def finish(steps: Steps) -> None:
    """Let a generator run on behind its result: the result stands, whatever it does."""
    try:
        extra = await steps.asend(None)
        logger.warning("a body yielded %s after its result; it is closed", type(extra).__name__)
        await steps.aclose()
    except StopAsyncIteration:
        return
    except (GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except Exception:
        logger.exception("a body failed after it had yielded its result; the result stands")
    except BaseException:
        logger.info("a body was canceled after it had yielded its result; the result stands")


def is_closed_by_loop(error: BaseException) -> bool:
    """Whether the event loop is gone, and closes the coroutine; not an exception of the body.

    To be asked by the function that awaits the body.
    """
    trace = error.__traceback__
    return isinstance(error, GeneratorExit) and trace is not None and trace.tb_next is None


_BY_GOAL = "Cancelled via goal "
"""The reason that a goal gives begins so; what takes its steps has an id, with which it goes on."""

_BY_SCOPE = "Cancelled via cancel scope "
"""The reason that anyio gives for its cancellations begins so, and goes on with the scope's id."""


def _is_shielded(tasks: Tasks, task: Cancelable, outer: Scope | None) -> bool:
    return any(scope.shield for scope in tasks.scopes(task, outer))


#: Only the event loop would hold them otherwise, and it holds them weakly.
_ABANDONED: set[asyncio.Task[object]] = set()
