"""Runs a goal's body in a task, can cancel the body, and ends the goal after the body has ended.

A body always runs in a task of its own, no matter how the client waits for the goal. The server
owns the task, and therefore cancels the task and waits for its end.

A step is the part of a body between two awaits. During a long step nothing else in the event loop
can run, so long steps are reported.

Source: asyncio's debug mode, for the report of slow callbacks.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from contextvars import Context
from time import monotonic
from typing import Any, Protocol, Self

from turtleact.goals.state import Cancelable, Goal
from turtleact.tasks import Tasks

__all__ = ["BLOCKING", "BodyTask"]

BLOCKING = 0.5
"""Steps that take longer than this time are reported (s, wall clock)."""


class Runner(Protocol):
    """What a body task needs from the server; see `turtleact.goals.execution`."""

    def open_body(self, goal: Goal, task: BodyTask) -> Coroutine[object, object, object]:
        """Return the coroutine that runs the goal's body. Called in the body's task."""

    def close_body(self, goal: Goal, task: BodyTask, error: BaseException) -> None:
        """End a goal whose body has ended. ``error`` is StopIteration if the body has returned."""

    def end_unstarted(self, goal: Goal) -> None:
        """End a goal that was canceled before its body took the first step."""

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        """Log a step that has blocked the event loop."""


class BodyTask(Coroutine[object, object, None]):
    """The coroutine of a body's task. It runs the body step by step, and then ends the goal.

    This object resumes the body itself, because it measures how long each step takes. The task runs
    this object as its coroutine, because a separate coroutine would need 290 bytes for each goal.

    Args:
        runner: Opens the body and ends the goal.
        goal: The goal.
        tasks: The functions for tasks on the event loop, asyncio or trio.

    Attributes:
        body: The coroutine or generator that the user's function returned; None until the function
            has been called.
    """

    __slots__ = (
        "_goal",
        "_is_cancel_due",
        "_is_dropped",
        "_runner",
        "_steps",
        "_task",
        "_tasks",
        "body",
    )

    def __init__(self, runner: Runner, goal: Goal, tasks: Tasks) -> None:
        self.body: object = None
        self._runner = runner
        self._goal = goal
        self._tasks = tasks
        self._steps: Coroutine[object, object, object] | None = None
        self._task: Cancelable | None = None
        self._is_cancel_due = False
        self._is_dropped = False

    def start(self, name: str, context: Context | None) -> None:
        """Start the task in ``context``, or in a copy of the current context."""
        self._task = self._tasks.spawn(self, name, context)

    def cancel(self) -> None:
        """Cancel the body at its next await outside a shield.

        If the body has not started yet, it never starts.
        """
        # There are three cases. (1) The body has not begun: `send` never begins it. The goal ends
        # now, or stays unfinished in the journal while the server is suspended. (2) The task is in
        # an anyio shield, which `asyncio.Task.cancel` would break: `send` cancels after the step
        # that leaves the shield. (3) Otherwise the task is cancelled now.
        if self._steps is None:
            self._is_dropped = True
            self._runner.end_unstarted(self._goal)
        elif self._task is not None:
            self._is_cancel_due = self._tasks.is_shielded(self._task)
            if not self._is_cancel_due:
                self._task.cancel()

    @property
    def position(self) -> str:
        """The file, line and function where the body waits; empty once the body has ended."""
        for attribute in ("cr_frame", "ag_frame"):
            frame = getattr(self.body, attribute, None)
            if frame is not None:
                code = frame.f_code
                return f"{code.co_filename}:{frame.f_lineno} in {code.co_qualname}"
        return ""

    # The coroutine protocol; the event loop calls these methods.

    def send(self, value: Any) -> object:  # noqa: ANN401  # whatever the loop sends
        """Run one step of the body."""
        return self._step(self._begin if self._steps is None else self._steps.send, value)

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Raise an exception in the body, which then runs one step."""
        if self._steps is not None:
            return self._step(self._steps.throw, error)
        # The program ends and cancels a task that has not begun.
        self._runner.end_unstarted(self._goal)
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
        if self._is_dropped or self._goal.is_decided:
            raise StopIteration
        self._steps = self._runner.open_body(self._goal, self)
        return self._steps.send(value)

    def _step(self, resume: Callable[[Any], object], value: object) -> object:
        """Resume the body, and report the step if it blocks the event loop for long."""
        began = monotonic()
        try:
            waits_for = resume(value)
        except BaseException as error:
            self._task = None  # breaks the cycle with the task, so that both are freed at once
            self._runner.close_body(self._goal, self, error)
            raise StopIteration from None  # the task has ended, too
        finally:
            if (took := monotonic() - began) > BLOCKING:
                self._runner.report_blocking(self._goal, took)
        if self._is_cancel_due:
            self.cancel()
        return waits_for
