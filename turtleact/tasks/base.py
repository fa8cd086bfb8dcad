"""What an event loop offers, whichever it is."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from contextlib import AbstractContextManager
from contextvars import Context
from typing import Protocol

from turtleact.goal import Cancelable

__all__ = ["GRACE", "Signal", "Tasks", "is_cancellation"]

GRACE = 5.0
"""How long a cancelled task is waited for before it is given up, unless the user says (s)."""


class Signal(Protocol):
    """Many wait, one fires, all go on. A signal does not remember earlier fires."""

    def fire(self) -> None:
        """Wake all that wait now."""

    async def wait(self) -> None:
        """Wait for the next fire. Cancelling: safe, nothing is lost."""

    @property
    def waiters(self) -> int:
        """How many wait now."""


class Tasks(Protocol):
    """What one kind of event loop offers.

    Attributes:
        cancelled: The exception that cancels a task.
        can_let_go: Whether the loop can end while a task ignores its cancellation. trio cannot.
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
        """Run a coroutine in a task of its own, in a copy of the current context unless given.

        The caller owns the task: it cancels it and waits for its end. The coroutine handles its own
        exceptions. Its first step runs soon; with ``is_eager`` it has run when this returns, on
        asyncio from Python 3.12 on.
        """

    def is_shielded(self, task: Cancelable) -> bool:
        """Whether cancelling a task would break into a shielded scope; trio never does."""

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Call something that may spawn a task, but not within this very call on asyncio."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread; nothing happens once the loop is gone."""

    def signal(self) -> Signal:
        """A new signal."""

    async def checkpoint(self) -> None:
        """Let others run, once."""

    def is_canceled(self) -> bool:
        """Whether somebody has cancelled the running task; True where that cannot be told."""

    def stop_program(self, error: BaseException) -> None:
        """End the program with a `SystemExit` or `KeyboardInterrupt` that a task has raised."""

    def stoppable(self) -> AbstractContextManager[None]:
        """A block that `stop_program` ends, on loops where a task cannot do that by itself."""


def is_cancellation(error: BaseException, tasks: Tasks) -> bool:
    """Whether an exception is the event loop's cancellation, or a group of nothing else."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(tasks.cancelled)[1] is None
    return isinstance(error, tasks.cancelled)
