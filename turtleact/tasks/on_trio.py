"""System tasks of trio, and parking lots to wait in."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from contextvars import Context, copy_context
from typing import TYPE_CHECKING

from anyio.lowlevel import RunVar

from turtleact.goal import Cancelable

if TYPE_CHECKING:
    import trio

__all__ = ["TrioSignal", "TrioTask", "TrioTasks"]


class TrioTasks:
    """System tasks of trio, each in a cancel scope of its own.

    They outlive the task that starts them, as a goal outlives its client; their owner waits for
    them. trio ends no program before its last task, whatever that ignores.
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
        *,
        is_eager: bool = False,  # noqa: ARG002  # for asyncio
    ) -> TrioTask:
        """Run a coroutine in a task of its own; its first step runs soon."""
        task = TrioTask(self._trio.CancelScope())
        self._trio.lowlevel.spawn_system_task(
            task.run, body, name=name, context=copy_context() if context is None else context
        )
        return task

    def is_shielded(self, task: Cancelable) -> bool:  # noqa: ARG002  # for asyncio
        """Trio's cancellation heeds shields by itself."""
        return False

    def call_soon(self, callback: Callable[[], object]) -> None:
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
        """Let all others that are ready run."""
        # trio runs the tasks of a batch in random order. After one checkpoint, a task that was
        # spawned just before may still be waiting for its turn; after two it has had it.
        await self._trio.lowlevel.checkpoint()
        await self._trio.lowlevel.checkpoint()

    def is_canceled(self) -> bool:
        """Trio raises nothing else: nobody can await what was cancelled."""
        return True

    def stop_program(self, error: BaseException) -> None:
        """Cancel the `stoppable` blocks, which raise ``error`` at their end.

        A system task must not raise it: trio takes that for a bug of its own.
        """
        self._stop.error = error
        for block in self._stop.blocks:
            block.cancel()

    @contextmanager
    def stoppable(self) -> Iterator[None]:
        """A block that `stop_program` cancels; it raises the error instead of the cancellation."""
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
        # Whatever else came of the cancellation, perhaps wrapped by nurseries, the program ends
        # with the error that has stopped it.
        if scope.cancel_called and stop.error:
            raise stop.error


class _Stop:
    """What ends the program, shared by all that runs in one event loop."""

    def __init__(self) -> None:
        self.error: BaseException | None = None
        self.blocks: list[trio.CancelScope] = []


_stop: RunVar[_Stop] = RunVar("turtleact_stop")


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

    @property
    def waiters(self) -> int:
        """How many wait now."""
        return self._lot.statistics().tasks_waiting
