"""Provides clocks for wall time, scaled wall time and virtual time.

A `Clock` tells the time and lets tasks wait. Virtual time stands still while any task can run. It
jumps to the next deadline as soon as every task waits. A simulated minute therefore passes in
milliseconds, and two runs of the same program see the same times. Every clock can be stopped and
started again.

To measure durations, use `Clock.time`. This time counts seconds from an arbitrary start, and never
goes backwards. To stamp messages, use `Clock.now`: the ROS time, in nanoseconds since the epoch.

How a virtual clock detects that every task waits depends on the event loop:

- asyncio keeps the callbacks that are ready in a private queue, which this module reads.
- On asyncio loops that do not show their queue of callbacks (uvloop), this module calls
  `anyio.wait_all_tasks_blocked`, which polls every 0.1 s. Because that is slow, a warning is logged
  once per run.
- On trio, this module calls trio's own function ``wait_all_tasks_blocked``.

Under `turtleact.testing` the event loop's own time is virtual. A `WallClock` or `ScaledClock` that
is made in such a loop uses the loop's time instead of wall time. Every clock then agrees with
`anyio.sleep`.

Source: asyncio ``BaseEventLoop._run_once``; trio ``wait_all_tasks_blocked``.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import math
import sys
import time
from bisect import bisect_left, insort
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sized
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import partial
from numbers import Real
from typing import Protocol, TypeVar, cast

import anyio
import anyio.to_thread
from anyio.lowlevel import RunVar

from turtleact.errors import InvalidOption, SimError
from turtleact.tasks.background import Background
from turtleact.tasks.event_loops import Signal, Tasks, current_tasks

__all__ = [
    "EPOCH",
    "FASTEST",
    "Clock",
    "ScaledClock",
    "ThreadWork",
    "VirtualClock",
    "WallClock",
    "check_timeout",
    "make_clock",
    "thread_work",
    "wait_until_idle",
    "within",
]

logger = logging.getLogger("turtleact")

T = TypeVar("T", bound="tuple[float, int, *tuple[object, ...]]")

EPOCH = 1_700_000_000_000_000_000
"""ROS time at the start of virtual time (ns), the same in every run."""

FASTEST = 100.0
"""The highest speed, as a multiple of wall time. For higher speeds, use virtual time."""

LEEWAY = 0.05
"""How far a scaled clock may run past the deadline of a task that wakes late (s)."""

CALLBACK_TURNS = 3
"""How many turns of the loop to wait for pending callbacks if the loop's queue cannot be read.

A finished task wakes its parent with a callback that belongs to no task. Until this callback runs,
the loop looks idle although the parent is about to run."""

_LAST = sys.float_info.max


class Clock(Protocol):
    """Tells the time, and lets tasks wait."""

    def time(self) -> float:
        """Return the seconds since an arbitrary moment. This time never goes backwards."""

    def now(self) -> int:
        """Return the ROS time: nanoseconds since 1970-01-01 00:00 UTC."""

    async def sleep(self, seconds: float) -> None:
        """Wait for ``seconds`` of this clock's time. With 0 or less, only let other tasks run."""

    async def sleep_until(self, deadline: float) -> None:
        """Wait until `time` has reached ``deadline``."""

    def stop_at(self, moment: float) -> None:
        """Stop the clock when `time` reaches ``moment``, or now if ``moment`` has passed.

        If ``moment`` is `math.inf`, start the clock again. The clock continues from the time at
        which it stopped, and each sleeping task waits for the rest of its time.
        """

    async def run(self) -> None:
        """Let the clock's time pass, until this call is cancelled."""


class ScaledClock:
    """A clock that runs ``factor`` times as fast as wall time, or slower if tasks cannot keep up.

    If a sleeping task wakes late, the clock waits for the task: the clock stops `LEEWAY` after the
    task's deadline, until the task runs. On a machine that is too slow, the clock therefore runs
    more slowly, and no timeout expires early.

    Args:
        factor: Clock seconds per wall-clock second, above zero and at most `FASTEST`.

    Raises:
        SimError: if the factor is out of range.
    """

    def __init__(self, factor: float = 1.0) -> None:
        if not (math.isfinite(factor) and factor > 0):
            raise SimError(f"a clock's speed must be a number above zero, not {factor}")
        if factor > FASTEST:
            raise SimError(
                f"a clock's speed is {FASTEST:g} at most, not {factor:g}; 'max' has no limit"
            )
        self.factor = factor
        leaping = _leaping_time()
        self._wall = leaping or time.monotonic
        self._wall_start = self._wall()
        self._ros_start = EPOCH + round(self._wall_start * 1e9) if leaping else time.time_ns()
        self._order = itertools.count()
        self._sleepers: list[tuple[float, int]] = []  # sorted
        self._end = math.inf
        self._stands = False
        self._freed: Signal | None = None

    def time(self) -> float:
        """Return how many seconds this clock has counted since it was made.

        The clock does not advance while it is stopped or waits for a late task.
        """
        if self._stands:
            return self._end
        seconds = (self._wall() - self._wall_start) * self.factor
        if self._sleepers and seconds > (latest := self._sleepers[0][0] + LEEWAY):
            self._wall_start += (seconds - latest) / self.factor
            seconds = latest
        if seconds >= self._end:
            self._stands = True
            return self._end
        return seconds

    def now(self) -> int:
        """Return the ROS time. A new clock starts at the system time.

        If the event loop's own time is virtual, a new clock starts at `EPOCH` plus that time.
        """
        return self._ros_start + round(self.time() * 1e9)

    async def sleep(self, seconds: float) -> None:
        """Wait for ``seconds`` of this clock's time. With 0 or less, only let other tasks run."""
        left = max(seconds, 0.0)
        await self._sleep(self.time() + left, left)

    async def sleep_until(self, deadline: float) -> None:
        """Wait until `time` has reached ``deadline``."""
        now = self.time()
        # A past deadline counts as it is, so a task that catches up, such as the ticks of a world,
        # holds the clock up until it has caught up. It does not count as older than `LEEWAY`,
        # because time would go backwards.
        await self._sleep(max(deadline, now - LEEWAY), max(deadline - now, 0.0))

    def stop_at(self, moment: float) -> None:
        """Stop the clock when `time` reaches ``moment``, or now if ``moment`` has passed.

        If ``moment`` is `math.inf`, start the clock again.
        """
        now = self.time()
        if self._stands:
            self._wall_start = self._wall() - now / self.factor
            self._stands = False
        self._end = max(moment, now)
        if self._freed is not None:
            self._freed.fire()

    async def _sleep(self, deadline: float, left: float) -> None:
        sleeper = (deadline, next(self._order))
        insort(self._sleepers, sleeper)
        try:
            await self._wait(deadline, left)
        except BaseException:
            _discard(self._sleepers, sleeper)
            raise
        # The sleeper is removed one step later, not now. What the task does before it sleeps again
        # takes wall time too, and until then the clock must not run ahead of it.
        current_tasks().call_soon(partial(_discard, self._sleepers, sleeper))

    async def _wait(self, deadline: float, left: float) -> None:
        # Two things make the remaining time wrong while a task sleeps. `stop_at` may stop the
        # clock: then wait to be freed and compute it again. A late sleeper may hold the clock up,
        # which moves `_wall_start`: then sleep again. If neither happened, `anyio.sleep` has waited
        # long enough, and a rounding error of `left` must not cost another round.
        while True:
            while deadline > self._end:
                if self._freed is None:
                    self._freed = current_tasks().signal()
                await self._freed.wait()
                left = deadline - self.time()
            start = self._wall_start
            await anyio.sleep(left / self.factor)
            left = deadline - self.time()
            if left <= 0 or (self._wall_start == start and not self._stands):
                return

    async def run(self) -> None:
        """Sleep until cancelled. Nothing else is needed, because wall time advances by itself."""
        await anyio.sleep_forever()


class WallClock(ScaledClock):
    """A clock that follows wall time. This clock does not wait for tasks that wake late."""

    def __init__(self) -> None:
        super().__init__()
        if self._wall is time.monotonic:
            self.now = time.time_ns  # type: ignore[method-assign]  # follows the system time

    def stop_at(self, moment: float) -> None:
        """Stop the clock when `time` reaches ``moment``, or now if ``moment`` has passed.

        If ``moment`` is `math.inf`, start the clock again.
        """
        super().stop_at(moment)
        if self._wall is time.monotonic:
            self.now = super().now  # type: ignore[method-assign]  # behind from now on

    async def _sleep(self, deadline: float, left: float) -> None:
        await self._wait(deadline, left)


class VirtualClock:
    """A clock that jumps to the next deadline as soon as every task waits.

    The clock jumps only while `run` is running. Tasks that sleep until the same deadline wake one
    at a time, in the order in which they went to sleep. Each of them wakes only when all other
    tasks wait again. A task that waits for the network, a thread or wall time does not stop virtual
    time. But virtual time stands still while a thread writes a journal, or reads or writes a bag.
    """

    def __init__(self) -> None:
        self._time = 0.0
        self._order = itertools.count()
        self._sleepers: list[tuple[float, int, Signal]] = []  # sorted
        self._end = _LAST
        self._wanted: Signal | None = None
        self._tasks: Tasks | None = None

    def time(self) -> float:
        """Return the virtual seconds since this clock was made."""
        return self._time

    def now(self) -> int:
        """Return the ROS time.

        It starts at `EPOCH`, so that every run of a program has the same stamps.
        """
        return EPOCH + round(self._time * 1e9)

    async def sleep(self, seconds: float) -> None:
        """Wait for ``seconds`` of virtual time. With 0 or less, only let other tasks run."""
        await self.sleep_until(self._time + seconds)

    async def sleep_until(self, deadline: float) -> None:
        """Wait until `time` has reached ``deadline``."""
        tasks = self._tasks
        if tasks is None:
            tasks = self._tasks = current_tasks()
        if deadline <= self._time:
            await tasks.checkpoint()
            return
        signal = tasks.signal()
        sleeper = (deadline, next(self._order), signal)
        insort(self._sleepers, sleeper)
        if self._wanted is not None:
            self._wanted.fire()
        try:
            await signal.wait()
        except tasks.cancelled:
            _discard(self._sleepers, sleeper)
            raise

    def stop_at(self, moment: float) -> None:
        """Never jump to a deadline after ``moment``. With `math.inf`, there is no limit."""
        self._end = min(moment, _LAST)
        if self._wanted is not None:
            self._wanted.fire()

    async def run(self) -> None:
        """Until cancelled, jump to the next deadline whenever every other task waits."""
        wanted = self._wanted = current_tasks().signal()
        idle, sleepers, work = _idleness(), self._sleepers, thread_work()
        # One sleeper is woken per round, so whatever it does happens before the next one wakes. If
        # there is nothing to jump to, `wanted` fires for a new sleeper or a new limit.
        while True:
            await idle()
            if work.is_under_way:
                await work.wait_for_end()
                continue
            if not sleepers or sleepers[0][0] > self._end:
                await wanted.wait()
                continue
            deadline, _, signal = sleepers.pop(0)
            self._time = max(self._time, deadline)
            signal.fire()


def make_clock(speed: float | str) -> ScaledClock | VirtualClock:
    """Make the clock for a speed: a multiple of wall time, or ``"max"`` for virtual time.

    If the event loop's own time is virtual, a clock of any speed runs as fast as possible, and
    ``"max"`` means the same as 1.

    Raises:
        SimError: if ``speed`` is neither a number nor ``"max"``, or the factor is out of range.
    """
    if speed == "max":
        return VirtualClock() if _leaping_time() is None else WallClock()
    try:
        factor = float(speed)
    except (TypeError, ValueError, OverflowError):
        raise SimError(f"a speed is a number above zero or 'max', not '{speed}'") from None
    return WallClock() if factor == 1.0 else ScaledClock(factor)


def _discard(sleepers: list[T], sleeper: T) -> None:
    """Remove an item from a sorted list, if it is there."""
    at = bisect_left(sleepers, sleeper)
    if at < len(sleepers) and sleepers[at] is sleeper:
        del sleepers[at]


def _leaping_time() -> Callable[[], float] | None:
    """Return the function that reads the event loop's virtual time; None if there is none."""
    if "trio" in sys.modules:
        import trio

        if trio.lowlevel.in_trio_run():
            clock = trio.lowlevel.current_clock()
            return clock.current_time if hasattr(clock, "autojump_threshold") else None
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:  # a clock may be made before the loop runs
        return None
    return loop.time if getattr(loop, "is_virtual", False) else None


# idleness


async def wait_until_idle() -> None:
    """Wait until all other tasks of the event loop are waiting.

    Tasks that wait for the network, for a thread or for wall time also count as waiting. Several
    tasks may call this function at the same time; all of them continue together. Cancelling: safe.
    """
    await _idleness()()


def _idleness() -> Callable[[], Awaitable[None]]:
    """Return a function that waits like `wait_until_idle`, for callers that wait often."""
    if anyio.get_cancelled_exc_class() is not asyncio.CancelledError:
        return anyio.wait_all_tasks_blocked  # trio's own
    turns = _turns.get(None)
    if turns is None:
        turns = _Turns(asyncio.get_running_loop())
        _turns.set(turns)
    return turns.wait_until_idle


class ThreadWork:
    """Counts the pieces of work that threads are doing for the event loop.

    While there is any work, virtual time stands still. Each piece of work must therefore be sure to
    end soon.

    A `turtleact.tasks.clock.VirtualClock` asks this object whether work is under way. On the event
    loops of `turtleact.testing`, time stands still while a token of anyio's thread limiter is
    borrowed. This object therefore borrows one token while work is under way.
    """

    def __init__(self) -> None:
        self._count = 0
        self._limiter = anyio.to_thread.current_default_thread_limiter()
        self._done = anyio.Event()

    def begin(self) -> None:
        """Count one more piece of work that is under way."""
        self._count += 1
        if self._count == 1:
            self._done = anyio.Event()
            with suppress(anyio.WouldBlock):  # other threads have all of them
                self._limiter.acquire_on_behalf_of_nowait(self)

    def end(self, count: int = 1) -> None:
        """Count ``count`` pieces of work as ended."""
        self._count -= count
        if not self._count:
            with suppress(RuntimeError):  # it has not got a token
                self._limiter.release_on_behalf_of(self)
            self._done.set()

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count a ``with`` block as one piece of work.

        Virtual time stands still during the block, even while the block waits for a worker thread.
        """
        self.begin()
        try:
            yield
        finally:
            self.end()

    @property
    def is_under_way(self) -> bool:
        """Whether any work is under way."""
        return self._count > 0

    async def wait_for_end(self) -> None:
        """Wait until no work is under way. Cancelling: safe."""
        while self._count:
            await self._done.wait()


def thread_work() -> ThreadWork:
    """Return the running loop's `ThreadWork`."""
    work = _work.get(None)
    if work is None:
        work = ThreadWork()
        _work.set(work)
    return work


class _Turns:
    """Detects when an asyncio event loop is idle.

    Each call of `wait_until_idle` sleeps for one turn of the loop at a time, so each call always
    has one callback in the loop's queue. If a call finds only callbacks of other `wait_until_idle`
    calls in the queue, the loop is idle.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._ready = cast("Sized | None", getattr(loop, "_ready", None))
        self._watchers = 0
        self._idle = 0
        if self._ready is None:
            logger.warning(
                "virtual time is slow on %s: each jump takes 0.1 s; run the program on asyncio's"
                " own loop, or with turtleact.testing.run",
                type(loop).__name__,
            )

    async def wait_until_idle(self) -> None:
        """Wait until the loop is idle.

        The first call that finds the loop idle also ends the other calls.
        """
        if self._ready is None:
            await anyio.wait_all_tasks_blocked()
            for _ in range(CALLBACK_TURNS):
                await asyncio.sleep(0)
            await anyio.wait_all_tasks_blocked()
            return
        before = self._idle
        self._watchers += 1
        try:
            await asyncio.sleep(0)
            while self._idle == before and len(self._ready) >= self._watchers:
                await asyncio.sleep(0)
        finally:
            self._watchers -= 1
        if self._idle == before:
            self._idle += 1


_turns: RunVar[_Turns] = RunVar("turtleact_turns")
_work: RunVar[ThreadWork] = RunVar("turtleact_thread_work")


# timeouts


def check_timeout(seconds: object, option: str = "timeout", *, may_be_none: bool = True) -> None:
    """Check that a timeout is a number of seconds, or None if ``may_be_none``.

    Args:
        seconds: The timeout that the user gave.
        option: The option's name, for the error message.
        may_be_none: Whether None is allowed and means no limit.

    Raises:
        InvalidOption: if the timeout is not a number, or is None without ``may_be_none``.
    """
    if may_be_none and seconds is None:
        return
    is_number = isinstance(seconds, Real) and not isinstance(seconds, bool)
    if not (is_number and cast("float", seconds) == seconds):  # not nan
        expected = "a number of seconds or None" if may_be_none else "a number of seconds"
        raise InvalidOption(option, f"expected {expected}, not {seconds!r}")


@asynccontextmanager
async def within(seconds: float | None, clock: Clock) -> AsyncIterator[None]:
    """Cancel the block after ``seconds`` of the clock's time, and continue after the block.

    If ``seconds`` is None, the block is not cancelled.
    """
    if seconds is None:
        yield
        return
    with anyio.CancelScope() as scope:
        timer = Background(_cancel_after(seconds, clock, scope), "a timeout")
        try:
            yield
        finally:
            await timer.aclose()


async def _cancel_after(seconds: float, clock: Clock, scope: anyio.CancelScope) -> None:
    await clock.sleep(seconds)
    scope.cancel()
