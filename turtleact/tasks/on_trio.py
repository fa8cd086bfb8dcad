"""Implements tasks and signals on trio."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from contextvars import Context, copy_context
from typing import TYPE_CHECKING

from anyio.lowlevel import RunVar

from turtleact.tasks.base import Cancelable

if TYPE_CHECKING:
    import trio

__all__ = ["TrioSignal", "TrioTask", "TrioTasks"]


class TrioTasks:
    """Runs coroutines in system tasks of trio, each in its own cancel scope.

    A system task can outlive the task that starts it, as a goal can outlive its client. The owner
    of a task waits for the task's end. trio ends a program only after the last task has ended, even
    if that task ignores its cancellation.
    """

    can_let_go = False

    def __init__(self) -> None:
        import trio

        self._trio = trio
        self._token = trio.lowlevel.current_trio_token()
        try:
            self._stop = _stop.get()
        except LookupError:
            self._stop = _Stop()
            _stop.set(self._stop)
        self.cancelled: type[BaseException] = trio.Cancelled

    def spawn(
        self,
        body: Coroutine[object, object, None],
        name: str,
        context: Context | None = None,
    ) -> TrioTask:
        """Run a coroutine in a new task. Its first step runs after this method has returned."""
        task = TrioTask(self._trio.CancelScope())
        self._trio.lowlevel.spawn_system_task(
            task.run, body, name=name, context=copy_context() if context is None else context
        )
        return task

    def is_shielded(self, task: Cancelable) -> bool:  # noqa: ARG002  # for asyncio
        """Return False, because trio's cancellation respects shields by itself."""
        return False

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Schedule a callback for the loop's next turn."""
        self._token.run_sync_soon(callback)

    def from_anywhere(self, callback: Callable[[], object]) -> None:
        """Schedule a callback from any thread. If the event loop has ended, do nothing."""
        with suppress(self._trio.RunFinishedError):
            self._token.run_sync_soon(callback)

    def signal(self) -> TrioSignal:
        """Make a new signal."""
        return TrioSignal(self._trio.lowlevel.ParkingLot())

    async def checkpoint(self) -> None:
        """Let all other tasks that are ready run."""
        # trio runs the tasks of a batch in random order. After one checkpoint, a task that was
        # spawned just before may still be waiting for its turn; after two it has had it.
        await self._trio.lowlevel.checkpoint()
        await self._trio.lowlevel.checkpoint()

    def is_canceled(self) -> bool:
        """Whether the running task has been cancelled; on trio, always True.

        Callers ask only after trio has raised ``Cancelled``, which happens only in cancelled
        tasks.
        """
        return True

    def stop_program(self, error: BaseException) -> None:
        """Cancel the `stoppable` blocks. Each of these blocks then raises ``error``.

        A system task must not raise the error itself, because trio treats that as an internal
        error.
        """
        self._stop.error = error
        for block in self._stop.blocks:
            block.cancel()

    @contextmanager
    def stoppable(self) -> Iterator[None]:
        """Return a context manager for a block that `stop_program` can cancel.

        The cancelled block raises the error that ends the program.
        """
        stop = self._stop
        scope = self._trio.CancelScope()
        stop.blocks.append(scope)
        try:
            with scope:
                yield
        except BaseException:
            if not (scope.cancel_called and stop.error):
                raise
        finally:
            stop.blocks.remove(scope)
        # The cancellation may have ended the block with other errors, perhaps wrapped by nurseries.
        # The program must still end with the error that stopped it.
        if scope.cancel_called and stop.error:
            raise stop.error


class _Stop:
    """Holds the error that ends the program, and the `stoppable` blocks to cancel.

    Each event loop has its own `_Stop` object.
    """

    def __init__(self) -> None:
        self.error: BaseException | None = None
        self.blocks: list[trio.CancelScope] = []


_stop: RunVar[_Stop] = RunVar("turtleact_stop")


class TrioTask:
    """Runs a coroutine in its own cancel scope."""

    __slots__ = ("_scope",)

    def __init__(self, scope: trio.CancelScope) -> None:
        self._scope = scope

    async def run(self, body: Coroutine[object, object, None]) -> None:
        """Run the coroutine to its end."""
        with self._scope:
            await body

    def cancel(self) -> None:
        """Cancel the coroutine at its next ``await`` and at every later one."""
        self._scope.cancel()


class TrioSignal:
    """A signal that uses trio's `ParkingLot`."""

    __slots__ = ("_lot",)

    def __init__(self, lot: trio.lowlevel.ParkingLot) -> None:
        self._lot = lot

    def fire(self) -> None:
        """Wake every task that is waiting."""
        self._lot.unpark_all()

    async def wait(self) -> None:
        """Wait until the signal fires the next time. Cancelling: safe."""
        await self._lot.park()

    @property
    def waiters(self) -> int:
        """How many tasks are waiting."""
        return self._lot.statistics().tasks_waiting
