"""Virtual time for whole programs: an event loop that jumps to its next timer instead of waiting.

`anyio.sleep`, `asyncio.timeout`, ``loop.time()`` and the clocks of nodes in this event loop all use
the same virtual time. It begins at 0 and stands still while any task can run. When all tasks wait,
time jumps to the next timer, with two exceptions:

- If the loop has given work to a thread (``asyncio.to_thread``, ``run_in_executor``, or
  ``anyio.to_thread.run_sync`` with its default limiter), time stands still until the thread is
  done. Therefore, if the thread itself waits for virtual time, it waits forever. Work in other
  threads does not hold time back.
- If a socket, a pipe or a child process is open, time jumps only after ``patience`` real seconds in
  which nothing has arrived, because nobody can know whether something will still arrive.

Source: trio's ``MockClock`` for the idea; asyncio's ``BaseEventLoop._run_once``, which asks its
selector to wait until the next timer.
"""

from __future__ import annotations

import asyncio
import math
import selectors
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, TypeVar, TypeVarTuple, Unpack

import anyio
import anyio.to_thread

from turtleact.errors import SimError

if TYPE_CHECKING:
    import trio

__all__ = ["run", "virtual_backend"]

T = TypeVar("T")
Ts = TypeVarTuple("Ts")

Backend: TypeAlias = Literal["asyncio", "trio"]

PATIENCE: Final = 0.01


def run(
    async_fn: Callable[[Unpack[Ts]], Awaitable[T]],
    *args: *Ts,
    backend: Backend = "asyncio",
    patience: float = PATIENCE,
) -> T:
    """Run a coroutine function in virtual time, as `anyio.run` does in real time.

    Args:
        async_fn: The coroutine function.
        *args: The arguments of the coroutine function.
        backend: The event loop: ``"asyncio"`` or ``"trio"``.
        patience: How long sockets, pipes and child processes must be silent before time jumps (s of
            real time, 0 or more). With `math.inf`, virtual time stands still while any socket, pipe
            or child process is open.

    Returns:
        The result of ``async_fn``.

    Raises:
        SimError: if the backend or the patience is not valid.
    """
    name, options = virtual_backend(backend, patience=patience)
    return anyio.run(async_fn, *args, backend=name, backend_options=options)


def virtual_backend(
    backend: Backend = "asyncio", *, patience: float = PATIENCE
) -> tuple[str, dict[str, Any]]:
    """Return an anyio backend with virtual time, for example for an ``anyio_backend`` fixture.

    Use each backend for a single run. The run begins at time 0.

    Args:
        backend: The event loop: ``"asyncio"`` or ``"trio"``.
        patience: See `run`.

    Returns:
        The backend's name and its options.

    Raises:
        SimError: if the backend or the patience is not valid.
    """
    if not patience >= 0:
        raise SimError(f"patience must be 0 or more seconds, not {patience}")
    if backend == "asyncio":
        return backend, {"loop_factory": partial(VirtualEventLoop, patience)}
    if backend == "trio":
        from trio.testing import MockClock

        clock = MockClock(autojump_threshold=0)
        return backend, {"clock": clock, "instruments": [_Hold(clock, patience)]}
    raise SimError(f"virtual time runs on asyncio and on trio, not on {backend!r}")


# asyncio


class VirtualEventLoop(asyncio.SelectorEventLoop):
    """asyncio's event loop, with a selector that moves time forward instead of waiting.

    Attributes:
        is_virtual: True, which tells `turtleact.tasks.clock` that the loop's time is virtual.
    """

    is_virtual = True

    def __init__(self, patience: float) -> None:
        self._now = 0.0
        self._jobs = 0
        self._limiter: anyio.CapacityLimiter | None = None
        self._children: list[asyncio.SubprocessTransport] = []
        self._selector_of_events = _Selector(self, patience)
        super().__init__(self._selector_of_events)

    def time(self) -> float:
        """Virtual seconds since the loop was made."""
        return self._now

    def leap(self, seconds: float) -> None:
        """Move time forward by this many seconds."""
        self._now += seconds

    @property
    def has_jobs(self) -> bool:
        """Whether a thread is working for the loop."""
        return self._jobs > 0 or (self._limiter is not None and self._limiter.borrowed_tokens > 0)

    @property
    def has_peers(self) -> bool:
        """Whether a socket, pipe or child process is open, so that data may still arrive."""
        self._children = [child for child in self._children if child.get_returncode() is None]
        own = 1  # the pipe that wakes the loop
        return bool(self._children) or len(self._selector_of_events.get_map()) > own

    def run_forever(self) -> None:
        """Run until the loop is stopped."""
        if self._limiter is None:
            learning = self.create_task(self._learn())
            learning.add_done_callback(asyncio.Future.result)
        super().run_forever()

    async def _learn(self) -> None:
        """Get anyio's default thread limiter, which can be read only in a task."""
        self._limiter = anyio.to_thread.current_default_thread_limiter()

    def run_in_executor(
        self, executor: Executor | None, func: Callable[..., T], *args: object
    ) -> asyncio.Future[T]:
        """Run a function in a thread. Virtual time stands still until the function is done."""
        job = super().run_in_executor(executor, func, *args)
        self._jobs += 1
        job.add_done_callback(self._end_job)
        return job

    def _end_job(self, _: asyncio.Future[Any]) -> None:
        self._jobs -= 1

    async def shutdown_default_executor(self, *timeout: float | None) -> None:
        """Wait for the threads to end. Virtual time stands still during this wait."""
        self._jobs += 1
        try:
            await super().shutdown_default_executor(*timeout)
        finally:
            self._jobs -= 1

    async def subprocess_exec(self, *args: Any, **options: Any) -> Any:  # noqa: ANN401  # as there
        """Start a child process, which counts as open until it ends."""
        return self._remember(await super().subprocess_exec(*args, **options))

    async def subprocess_shell(self, *args: Any, **options: Any) -> Any:  # noqa: ANN401  # as there
        """Start a child process, which counts as open until it ends."""
        return self._remember(await super().subprocess_shell(*args, **options))

    def _remember(self, started: tuple[asyncio.SubprocessTransport, T]) -> object:
        self._children.append(started[0])
        return started


class _Selector(selectors.DefaultSelector):
    """Moves time forward instead of waiting, unless a thread is working or data may arrive."""

    def __init__(self, loop: VirtualEventLoop, patience: float) -> None:
        super().__init__()
        self._loop = loop
        self._patience = patience

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return the events that have arrived; if there are none, move time to the next timer.

        If a callback is ready, asyncio passes 0 as the ``timeout``.
        """
        events = super().select(0)
        if events or (timeout is not None and timeout <= 0):
            return events
        if timeout is None or self._loop.has_jobs:  # there is no timer, or a thread is working
            return super().select(None)
        if self._patience and self._loop.has_peers:
            patience = None if self._patience == math.inf else self._patience
            events = super().select(patience)
            if events:
                return events
        self._loop.leap(timeout)
        return []


# trio


class _Hold:
    """Stops trio's clock from jumping while a thread is working or data may arrive.

    This is a trio instrument. After each step of a task, it sets the clock's
    ``autojump_threshold``: the real time for which all tasks must have waited before the clock
    jumps.
    """

    def __init__(self, clock: trio.testing.MockClock, patience: float) -> None:
        import trio

        self._trio = trio
        self._clock = clock
        self._patience = patience

    def after_task_step(self, task: trio.lowlevel.Task) -> None:  # noqa: ARG002  # trio passes it
        """Decide when virtual time may jump.

        While a thread works, virtual time stands still. While a socket is open, virtual time jumps
        only after all tasks have waited for ``patience`` seconds of wall time.
        """
        threshold = 0.0
        if self._trio.to_thread.current_default_thread_limiter().borrowed_tokens:
            threshold = math.inf
        elif self._patience and self._has_peers():
            threshold = self._patience
        if threshold != self._clock.autojump_threshold:
            self._clock.autojump_threshold = threshold

    def _has_peers(self) -> bool:
        polled = self._trio.lowlevel.current_statistics().io_statistics
        epoll, kqueue = ("tasks_waiting_read", "tasks_waiting_write"), ("tasks_waiting", "monitors")
        own = 1  # the socket that wakes trio
        return sum(getattr(polled, name, 0) for name in epoll + kqueue) > own
