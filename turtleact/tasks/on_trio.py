"""System tasks of trio, and parking lots to wait in."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterator
from contextlib import suppress
from contextvars import Context, copy_context
from typing import TYPE_CHECKING

from turtleact.goal import Cancelable
from turtleact.tasks.base import Scope

if TYPE_CHECKING:
    import trio

__all__ = ["TrioSignal", "TrioTask", "TrioTasks"]


class TrioTasks:
    """System tasks of trio, each in a cancel scope of its own."""

    can_borrow = False
    depth = 0

    def __init__(self) -> None:
        import trio

        self._trio = trio
        self._token = trio.lowlevel.current_trio_token()
        self.cancelled: type[BaseException] = trio.Cancelled

    def spawn(
        self, body: Coroutine[object, object, None], name: str, context: Context | None = None
    ) -> TrioTask:
        """Run a coroutine in a task of its own; its first step runs soon."""
        task = TrioTask(self._trio.CancelScope())
        self._trio.lowlevel.spawn_system_task(
            task.run, body, name=name, context=copy_context() if context is None else context
        )
        return task

    def scope(self) -> None:
        """Trio's own scopes heed shields."""

    def scopes(self, task: Cancelable, outer: Scope | None) -> Iterator[Scope]:  # noqa: ARG002
        """Trio's own scopes heed shields."""
        return iter(())

    def cancel(self, task: Cancelable, reason: str) -> None:  # noqa: ARG002
        """Cancel a task; trio needs no reason."""
        task.cancel()

    def soon(self, callback: Callable[[], object]) -> None:
        """Call something now: what it spawns begins later."""
        callback()

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Call something soon, from any thread; nothing happens once the loop is gone."""
        with suppress(self._trio.RunFinishedError):
            self._token.run_sync_soon(callback)

    def signal(self) -> TrioSignal:
        """A new signal."""
        return TrioSignal(self._trio.lowlevel.ParkingLot())

    async def checkpoint(self) -> None:
        """Let others run, once."""
        await self._trio.lowlevel.checkpoint()

    def is_canceled(self) -> bool:
        """Trio raises nothing else: nobody can await what was canceled."""
        return True


class TrioTask:
    """A coroutine in a cancel scope."""

    __slots__ = ("_scope",)

    def __init__(self, scope: trio.CancelScope) -> None:
        self._scope = scope

    async def run(self, body: Coroutine[object, object, None]) -> None:
        """Run the coroutine to its end."""
        with self._scope:
            await body

    def cancel(self) -> None:
        """Let a cancellation arrive at the coroutine's next await, and at each one after it."""
        self._scope.cancel()


class TrioSignal:
    """A parking lot."""

    __slots__ = ("_lot",)

    def __init__(self, lot: trio.lowlevel.ParkingLot) -> None:
        self._lot = lot

    def fire(self) -> None:
        """Wake all that wait now."""
        self._lot.unpark_all()

    async def wait(self) -> None:
        """Wait for the next fire. Cancelling: safe, nothing is lost."""
        await self._lot.park()
