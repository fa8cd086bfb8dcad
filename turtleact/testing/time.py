"""Virtual time for whole programs: an event loop that leaps to its next timer instead of waiting.

`anyio.sleep`, `asyncio.timeout`, ``loop.time()`` and the clocks of nodes opened there tell one
time. It begins at 0, stands still while anything can run, and leaps once all wait, except while
something real is under way:

- While work that the loop has given to a thread goes on (``asyncio.to_thread``,
  ``run_in_executor``, ``anyio.to_thread.run_sync`` with its default limiter), time stands still
  until the thread is done: its end is sure to come.
- While a socket, a pipe or a child process is open, time leaps only after ``patience`` real seconds
  in which nothing came: whether anything will come, nobody can know.

So a thread that itself waits for virtual time waits for ever, and a thread that the loop has not
started holds nothing up.

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
from turtleact.tasks.idle import IdleSelector, WatchedEventLoop

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
        *args: Its arguments.
        backend: The event loop.
        patience: How long sockets, pipes and child processes must be silent before time leaps
            (real s, 0 or more); `math.inf` lets time stand still as long as there are any.

    Returns:
        What it returned.

    Raises:
        SimError: if the backend or the patience is none.
    """
    name, options = virtual_backend(backend, patience=patience)
    return anyio.run(async_fn, *args, backend=name, backend_options=options)


def virtual_backend(
    backend: Backend = "asyncio", *, patience: float = PATIENCE
) -> tuple[str, dict[str, Any]]:
    """Virtual time in the form in which anyio takes a backend: what an ``anyio_backend`` returns.

    Each is for one run, which begins at 0 s.

    Args:
        backend: The event loop.
        patience: As for `run`.

    Returns:
        The backend's name and its options.

    Raises:
        SimError: if the backend or the patience is none.
    """
    if not patience >= 0:
        raise SimError(f"patience is 0 or more seconds, not {patience}")
    if backend == "asyncio":
        return backend, {"loop_factory": partial(VirtualEventLoop, patience)}
    if backend == "trio":
        from trio.testing import MockClock

        clock = MockClock(autojump_threshold=0)
        return backend, {"clock": clock, "instruments": [_Hold(clock, patience)]}
    raise SimError(f"virtual time runs on asyncio and on trio, not on {backend!r}")


# asyncio


class VirtualEventLoop(WatchedEventLoop):
    """asyncio's own event loop, whose selector leaps where it would wait.

    Attributes:
        is_virtual: What `turtleact.clock` knows it by.
    """

    is_virtual = True

    def __init__(self, patience: float) -> None:
        self._now = 0.0
        self._jobs = 0
        self._limiter: anyio.CapacityLimiter | None = None
        self._children: list[asyncio.SubprocessTransport] = []
        super().__init__(_Selector(self, patience))

    def time(self) -> float:
        """Virtual seconds since the loop was made."""
        return self._now

    def leap(self, seconds: float) -> None:
        """Let time go on."""
        self._now += seconds

    @property
    def has_jobs(self) -> bool:
        """Whether a thread works for the loop."""
        return self._jobs > 0 or (self._limiter is not None and self._limiter.borrowed_tokens > 0)

    @property
    def has_peers(self) -> bool:
        """Whether somebody outside may have something to say: a socket, a pipe, a child process."""
        self._children = [child for child in self._children if child.get_returncode() is None]
        own = 1  # the pipe that wakes the loop
        return bool(self._children) or len(self.idle_selector.get_map()) > own

    def run_forever(self) -> None:
        """Run until it is stopped."""
        if self._limiter is None:
            learning = self.create_task(self._learn())
            learning.add_done_callback(asyncio.Future.result)
        super().run_forever()

    async def _learn(self) -> None:
        """Find the limiter of anyio's threads: from within a task is the only way."""
        self._limiter = anyio.to_thread.current_default_thread_limiter()

    def run_in_executor(
        self, executor: Executor | None, func: Callable[..., T], *args: object
    ) -> asyncio.Future[T]:
        """Let a thread do it; time stands still until it has."""
        job = super().run_in_executor(executor, func, *args)
        self._jobs += 1
        job.add_done_callback(self._end_job)
        return job

    def _end_job(self, _: asyncio.Future[Any]) -> None:
        self._jobs -= 1

    async def shutdown_default_executor(self, *timeout: float | None) -> None:
        """Wait for the threads; time stands still meanwhile."""
        self._jobs += 1
        try:
            await super().shutdown_default_executor(*timeout)
        finally:
            self._jobs -= 1

    async def subprocess_exec(self, *args: Any, **options: Any) -> Any:  # noqa: ANN401  # as there
        """Start a child process, and remember it."""
        return self._remember(await super().subprocess_exec(*args, **options))

    async def subprocess_shell(self, *args: Any, **options: Any) -> Any:  # noqa: ANN401  # as there
        """Start a child process, and remember it."""
        return self._remember(await super().subprocess_shell(*args, **options))

    def _remember(self, started: tuple[asyncio.SubprocessTransport, T]) -> object:
        self._children.append(started[0])
        return started


class _Selector(IdleSelector):
    """Waits for real events only while there may be some; else it lets time go on instead."""

    def __init__(self, loop: VirtualEventLoop, patience: float) -> None:
        super().__init__()
        self._loop = loop
        self._patience = patience

    def wait_for_events(self, timeout: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        """Leap to the next timer, unless something real is under way."""
        if timeout is None or self._loop.has_jobs:  # no timer to leap to, or a thread to wait for
            return super().wait_for_events(None)
        if self._patience and self._loop.has_peers:
            patience = None if self._patience == math.inf else self._patience
            events = super().wait_for_events(patience)
            if events:
                return events
        self._loop.leap(timeout)
        return []


# trio


class _Hold:
    """Keeps trio's clock from leaping while something real is under way.

    An instrument: after each step of a task it sets how long all must have waited, in real time,
    before the clock leaps.
    """

    def __init__(self, clock: trio.testing.MockClock, patience: float) -> None:
        import trio

        self._trio = trio
        self._clock = clock
        self._patience = patience

    def after_task_step(self, task: trio.lowlevel.Task) -> None:  # noqa: ARG002  # trio passes it
        """Look what is under way."""
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
