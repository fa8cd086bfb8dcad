"""The task of one goal's body: its steps, its cancellation, and where it stands.

A body always runs in a task of its own, however its client waits. The task belongs to the server,
which cancels it and waits for its end.

A step is what a body does between two waits. A step that takes long keeps everybody else in the
event loop from running, so it is reported.

Source: asyncio's debug mode, for the report of slow callbacks.
"""

from __future__ import annotations

from collections.abc import Coroutine
from contextvars import Context
from time import monotonic
from typing import Any, Protocol, Self

from turtleact.goal import Cancelable, Goal
from turtleact.tasks import Tasks

__all__ = ["BLOCKING", "BodyTask"]

BLOCKING = 0.5
"""A step that takes longer is reported (s, wall clock)."""


class Runner(Protocol):
    """What a body task asks of the server that runs it; see `turtleact.server.execution`."""

    def run(self, goal: Goal, task: BodyTask) -> Coroutine[object, object, None]:
        """Run the goal's body to its end; never raises but for what stops the program."""

    def end_unstarted(self, goal: Goal) -> None:
        """End a goal that is cancelled before the first step of its body."""

    def report_blocking(self, goal: Goal, seconds: float) -> None:
        """Tell the log of a step that has blocked the event loop."""


class BodyTask(Coroutine[object, object, None]):
    """A goal's body, as the coroutine that its task runs.

    Args:
        runner: Runs the body and ends the goal.
        goal: The goal.
        tasks: The tasks of the event loop.

    Attributes:
        body: The coroutine or generator of the user's function, once it is made.
    """

    __slots__ = ("_goal", "_is_cancel_due", "_runner", "_running", "_task", "_tasks", "body")

    def __init__(self, runner: Runner, goal: Goal, tasks: Tasks) -> None:
        self.body: object = None
        self._runner = runner
        self._goal = goal
        self._tasks = tasks
        self._running: Coroutine[object, object, None] | None = None
        self._task: Cancelable | None = None
        self._is_cancel_due = False

    def start(self, name: str, context: Context | None) -> None:
        """Start the task, in a copy of the current context unless given.

        With eager start the first step runs in here, and may end the goal or have it cancelled.
        """
        self._task = self._tasks.spawn(self, name, context, is_eager=True)
        if self._is_cancel_due and not self._goal.ended:
            self.cancel()

    def cancel(self) -> None:
        """Let a cancellation arrive at the body's next await that is not shielded.

        A body that has not begun never begins.
        """
        if self._running is None:
            self._runner.end_unstarted(self._goal)
        elif self._task is None:  # in its first step, started eagerly: there is no task yet
            self._is_cancel_due = True
        else:
            # `asyncio.Task.cancel` would break into an anyio shield. The cancellation is kept
            # until the end of the step in which the body leaves the shield; see `send`.
            self._is_cancel_due = self._tasks.is_shielded(self._task)
            if not self._is_cancel_due:
                self._task.cancel()

    @property
    def position(self) -> str:
        """The file, line and function where the body waits; empty once it has ended."""
        for attribute in ("cr_frame", "ag_frame"):
            frame = getattr(self.body, attribute, None)
            if frame is not None:
                code = frame.f_code
                return f"{code.co_filename}:{frame.f_lineno} in {code.co_qualname}"
        return ""

    # the protocol of coroutines: the event loop calls these

    def send(self, value: Any) -> object:  # noqa: ANN401  # whatever the loop sends
        """Run one step."""
        running = self._running
        if running is None:
            if self._goal.ended:  # cancelled before it began
                raise StopIteration
            running = self._running = self._runner.run(self._goal, self)
        began = monotonic()
        try:
            waits_for = running.send(value)
        finally:
            if (took := monotonic() - began) > BLOCKING:
                self._runner.report_blocking(self._goal, took)
        if self._is_cancel_due:
            self.cancel()
        return waits_for

    def throw(self, error: Any, *_: object) -> object:  # noqa: ANN401  # no type and traceback
        """Run one step that begins with an exception."""
        running = self._running
        if running is None:  # the program ends, and cancels a task that has not begun
            self._runner.end_unstarted(self._goal)
            raise error
        began = monotonic()
        try:
            waits_for = running.throw(error)
        finally:
            if (took := monotonic() - began) > BLOCKING:
                self._runner.report_blocking(self._goal, took)
        if self._is_cancel_due:
            self.cancel()
        return waits_for

    def close(self) -> None:
        """Close the body."""
        if self._running is not None:
            self._running.close()

    def __await__(self) -> Self:
        return self

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> object:
        return self.send(None)
