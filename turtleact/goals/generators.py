"""Turns a body that is an async generator into a coroutine.

A generator body is not iterated with ``async for``. With ``async for``, a body canceled at a
``yield`` would get GeneratorExit instead of the cancellation. A timeout or task group around the
``yield`` would not work. Instead, one task steps the generator. If a cancellation or error occurs
between two steps, the task raises the exception at the ``yield``. In every case, the task closes
the generator.

Source: PEP 525; PEP 789 for the hazards of generators.
"""

from __future__ import annotations

import logging
from collections.abc import AsyncGenerator, Awaitable, Callable
from typing import Any, Final, Protocol, TypeAlias

from turtleact.errors import Abort, InvalidMessage
from turtleact.goals.state import Goal
from turtleact.interfaces import Message

__all__ = ["BURST", "RunningBody", "Steps", "drive"]

logger = logging.getLogger("turtleact.server")

BURST: Final = 16
"""After this many messages in a row, a generator that never waits must let other tasks run."""

Steps: TypeAlias = AsyncGenerator[object, None]


class RunningBody(Protocol):
    """The run of a body, as the body's form sees it; see `turtleact.goals.running.BodyTask`.

    Attributes:
        goal: The goal.
        source: The coroutine or generator that the user's function returned.
        gate: What the body awaits before its next step; None if the body may go on.
    """

    goal: Goal
    source: Any
    gate: Callable[[], Awaitable[None]] | None

    @property
    def action(self) -> str:
        """The name of the action."""

    @property
    def result_type(self) -> type[Message]:
        """The class of the action's results."""

    def make_handle(self) -> object:
        """Make the goal handle for the body."""

    def check_result(self, result: object) -> Message:
        """Return a copy of a result, or raise `InvalidMessage`."""

    def publish(self, feedback: object) -> None:
        """Publish a feedback message."""

    async def wait_at_gate(self) -> None:
        """Wait until there is no gate."""

    async def catch_up(self) -> None:
        """Let other tasks run, and wait while a reader of feedback is far behind."""


async def drive(run: RunningBody, steps: Steps) -> Message:
    """Run a generator to its end, and return its result.

    Raises:
        Abort: if the generator yielded no result, or a result that does not fit.
    """
    # Everything that happens between two steps belongs to the body: a feedback message that does
    # not fit, a cancellation during a pause, an error while publishing. It is thrown in at the
    # `yield`, where the body can handle it. If the body does not, the exception comes back out of
    # `athrow` and the generator is finished; `aclose` then does nothing.
    run.source = steps
    goal, publish, result_type, step = run.goal, run.publish, run.result_type, steps.asend
    countdown = BURST
    try:
        item = await step(None)
        while type(item) is not result_type:
            try:
                status, reason = goal.status, goal.reason
                publish(item)
                if goal.status is not status or goal.reason is not reason:
                    countdown = 1  # a callback has cancelled the goal: deliver that now
                if run.gate is not None:
                    await run.wait_at_gate()
                countdown -= 1
                if not countdown:
                    countdown = BURST
                    await run.catch_up()
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
        result = run.check_result(item)  # copied now, since the body may change it later
    except InvalidMessage as misfit:
        await steps.aclose()
        raise Abort(f"the body's result does not fit: {misfit}") from None
    await _finish(run, steps)
    return result


async def _finish(run: RunningBody, steps: Steps) -> None:
    """Resume a generator that has yielded its result, so that it can end.

    If the generator fails or yields again, its result stays the same.
    """
    try:
        extra = type(await steps.asend(None)).__name__
        problem = "the body of %s yielded %s after its result: this is ignored, and the body ends"
        logger.warning(problem, run.action, extra)
        await steps.aclose()
    except StopAsyncIteration:
        return
    except (GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except Exception as error:
        problem = "the body of %s failed after it had yielded its result; the result stands"
        logger.error(problem, run.action, exc_info=error)
    except BaseException:
        problem = "the body of %s was canceled after it had yielded its result; the result stands"
        logger.info(problem, run.action)
