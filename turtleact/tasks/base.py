"""What an event loop offers, whichever it is."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterator
from contextvars import Context
from typing import Protocol

from turtleact.goal import Cancelable

__all__ = ["DEEPEST", "GRACE", "Scope", "Signal", "Tasks", "is_cancellation"]

GRACE = 5.0
"""How long what was canceled is waited for, before it is left behind (s)."""

DEEPEST = 32
"""So many first steps, each inside the one before, are run at once; the next has to wait its turn.

One takes about six frames of Python's stack, which holds 1,000."""


class Signal(Protocol):
    """Many wait, one fires, all go on."""

    def fire(self) -> None:
        """Wake all that wait now."""

    async def wait(self) -> None:
        """Wait for the next fire. Cancelling: safe, nothing is lost."""


class Scope(Protocol):
    """One of anyio's cancel scopes."""

    shield: bool


class Tasks(Protocol):
    """What one kind of event loop offers."""

    cancelled: type[BaseException]
    can_borrow: bool
    depth: int

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> Cancelable:
        """Run a coroutine in a task of its own, in a copy of the current context unless given."""

    def scope(self) -> Scope | None:
        """The innermost cancel scope of the task that runs now; None where nobody need ask."""

    def scopes(self, task: Cancelable, outer: Scope | None) -> Iterator[Scope]:
        """The cancel scopes that a task has entered inside ``outer``, the innermost first."""

    def cancel(self, task: Cancelable, reason: str) -> None:
        """Cancel a task, with a reason for those who are told of it there (asyncio alone)."""

    def soon(self, callback: Callable[[], object]) -> None:
        """Call something, not within this call if it may run a body's first step."""

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread; nothing happens once the loop is gone."""

    def signal(self) -> Signal:
        """A new signal."""

    async def checkpoint(self) -> None:
        """Let others run, once."""

    def is_canceled(self) -> bool:
        """Whether somebody has canceled the task that runs now; True where that cannot be told."""


def is_cancellation(error: BaseException, tasks: Tasks) -> bool:
    """Whether an exception is the event loop's cancellation, or a group of nothing else."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(tasks.cancelled)[1] is None
    return isinstance(error, tasks.cancelled)
