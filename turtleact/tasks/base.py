"""The interface to an event loop's tasks, the same for asyncio and trio."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from contextlib import AbstractContextManager
from contextvars import Context
from typing import Protocol

from turtleact.goal import Cancelable

__all__ = ["GRACE", "Signal", "Tasks", "is_cancellation"]

GRACE = 5.0
"""How long to wait for a cancelled task before giving it up, unless the user says otherwise (s)."""


class Signal(Protocol):
    """Wakes every task that waits for it. A signal does not remember earlier fires."""

    def fire(self) -> None:
        """Wake every task that waits now."""

    async def wait(self) -> None:
        """Wait for the next fire. Cancelling: safe, nothing is lost."""

    @property
    def waiters(self) -> int:
        """How many wait now."""


class Tasks(Protocol):
    """The task functions of one kind of event loop.

    Attributes:
        cancelled: The exception that cancels a task.
        can_let_go: Whether the loop can end while a task ignores its cancellation; trio's cannot.
    """

    cancelled: type[BaseException]
    can_let_go: bool

    def spawn(
        self,
        body: Coroutine[object, object, None],
        name: str,
        context: Context | None = None,
        *,
        is_eager: bool = False,
    ) -> Cancelable:
        """Run a coroutine in a new task.

        The caller owns the task: it cancels the task and waits for its end. The coroutine handles
        its own exceptions. Its first step runs soon. With ``is_eager``, on asyncio from Python 3.12
        on, the first step has run before this returns.
        """

    def is_shielded(self, task: Cancelable) -> bool:
        """Whether cancelling a task would break into a shielded scope; trio never does."""

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Schedule a callback that may spawn tasks; asyncio never runs it within this call."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Schedule a callback from any thread; does nothing once the loop is closed."""

    def signal(self) -> Signal:
        """Make a new signal."""

    async def checkpoint(self) -> None:
        """Let other tasks run once."""

    def is_canceled(self) -> bool:
        """Whether somebody has cancelled the running task; True if the loop cannot tell."""

    def stop_program(self, error: BaseException) -> None:
        """End the program because a task raised `SystemExit` or `KeyboardInterrupt`."""

    def stoppable(self) -> AbstractContextManager[None]:
        """Make a block that `stop_program` ends, for loops whose tasks cannot end the program."""


def is_cancellation(error: BaseException, tasks: Tasks) -> bool:
    """Whether an exception is a cancellation, or a group that contains nothing else."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(tasks.cancelled)[1] is None
    return isinstance(error, tasks.cancelled)
