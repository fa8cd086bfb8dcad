"""Time: wall time, a factor of it, or virtual time.

Every wait of turtleact goes through a `Clock`. Virtual time stands still while anything can run,
and leaps to the next deadline once every task waits; so a minute passes in milliseconds, and two
runs of the same program pass through the same moments.

`Clock.time` is for measuring (seconds, from an arbitrary start, never backwards); `Clock.now` is
ROS time (nanoseconds since the epoch) and stamps what others see.

Where the event loop's own time is virtual (`turtleact.testing`), it is wall time to the clocks made
there: all of them, and `anyio.sleep`, then tell one time.
"""

from __future__ import annotations

import asyncio
import gc
import heapq
import itertools
import math
import sys
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Sized
from contextlib import asynccontextmanager
from functools import partial
from numbers import Real
from typing import Protocol, TypeVar, cast

import anyio
from anyio.lowlevel import RunVar

from turtleact.errors import InvalidOption, SimError
from turtleact.tasks import Background, Signal, Tasks, current_tasks

__all__ = [
    "EPOCH",
    "FASTEST",
    "Clock",
    "ScaledClock",
    "VirtualClock",
    "WallClock",
    "check_timeout",
    "make_clock",
    "wait_until_idle",
    "within",
]

T = TypeVar("T", bound="tuple[object, ...]")

EPOCH = 1_700_000_000_000_000_000
"""ROS time at the start of virtual time (ns): every run sees the same stamps."""

FASTEST = 100.0
"""Highest factor of wall time: what is faster leaps better, in virtual time."""

LEEWAY = 0.05
"""How far a scaled clock runs ahead of a sleeper that is late (s)."""


class Clock(Protocol):
    """A source of time, and the only way to wait for it."""

    def time(self) -> float:
        """Seconds since an arbitrary moment; never goes backwards."""

    def now(self) -> int:
        """ROS time: nanoseconds since 1970-01-01 00:00 UTC."""

    async def sleep(self, seconds: float) -> None:
        """Wait for some seconds of this clock; 0 or less is a checkpoint."""

    async def sleep_until(self, deadline: float) -> None:
        """Wait until `time` has reached ``deadline``."""

    async def run(self) -> None:
        """Drive the clock for as long as it is needed; never returns by itself."""


class ScaledClock:
    """Wall time, ``factor`` times as fast, or as fast as its sleepers can follow.

    A sleeper that is late holds the clock up: until it goes on, time comes no further than `LEEWAY`
    behind its deadline. So a machine that cannot keep up makes time slower, and nobody's time runs
    out the sooner for it.

    Args:
        factor: Seconds of this clock a second of wall time, above zero, `FASTEST` at most.

    Raises:
        SimError: if the factor is out of range.
    """

    def __init__(self, factor: float = 1.0) -> None:
        if not (math.isfinite(factor) and factor > 0):
            raise SimError(f"a clock's speed must be a number above zero, not {factor}")
        if factor > FASTEST:
            raise SimError(
                f"a clock's speed is {FASTEST:g} at most, not {factor:g}; "
                "'max' is as fast as it computes"
            )
        self.factor = factor
        leaping = _leaping_time()
        self._wall = leaping or time.monotonic
        self._wall_start = self._wall()
        self._ros_start = EPOCH + round(self._wall_start * 1e9) if leaping else time.time_ns()
        self._order = itertools.count()
        self._sleepers: list[tuple[float, int]] = []  # a heap

    def time(self) -> float:
        """Seconds since this clock was made, without those for which it was held up."""
        seconds = (self._wall() - self._wall_start) * self.factor
        if self._sleepers and seconds > (latest := self._sleepers[0][0] + LEEWAY):
            self._wall_start += (seconds - latest) / self.factor
            return latest
        return seconds

    def now(self) -> int:
        """ROS time; it begins at the wall's time when this clock was made."""
        return self._ros_start + round(self.time() * 1e9)

    async def sleep(self, seconds: float) -> None:
        """Wait for some seconds of this clock; 0 or less is a checkpoint."""
        left = max(seconds, 0.0)
        sleeper = (self.time() + left, next(self._order))
        heapq.heappush(self._sleepers, sleeper)
        try:
            while True:
                start = self._wall_start
                await anyio.sleep(left / self.factor)
                left = sleeper[0] - self.time()
                if left <= 0 or self._wall_start == start:  # nothing has held the clock up
                    break
        except BaseException:
            _remove(self._sleepers, sleeper)
            raise
        # It holds the clock up until it waits again: what it does now takes wall time too.
        current_tasks().soon(partial(_remove, self._sleepers, sleeper))

    async def sleep_until(self, deadline: float) -> None:
        """Wait until `time` has reached ``deadline``."""
        await self.sleep(deadline - self.time())

    async def run(self) -> None:
        """Nothing drives wall time."""
        await anyio.sleep_forever()


class WallClock(ScaledClock):
    """Wall time, whoever is late."""

    def __init__(self) -> None:
        super().__init__()
        if self._wall is time.monotonic:
            self.now = time.time_ns  # type: ignore[method-assign]  # it follows a clock that is set

    async def sleep(self, seconds: float) -> None:
        """Wait for some seconds; 0 or less is a checkpoint."""
        await anyio.sleep(max(seconds, 0.0))


class VirtualClock:
    """Time that leaps: it moves on only when every task waits, straight to the next deadline.

    Somebody must `run` it. Sleepers of one deadline go on in the order in which they began to
    sleep, each once all that the one before it brought about has been done. What waits for the
    network, a thread or wall time does not hold virtual time up.
    """

    def __init__(self) -> None:
        self._time = 0.0
        self._order = itertools.count()
        self._sleepers: list[tuple[float, int, Signal]] = []
        self._wanted: Signal | None = None
        self._tasks: Tasks | None = None

    def time(self) -> float:
        """Virtual seconds since this clock was made."""
        return self._time

    def now(self) -> int:
        """ROS time; it begins at a fixed moment, so that every run sees the same stamps."""
        return EPOCH + round(self._time * 1e9)

    async def sleep(self, seconds: float) -> None:
        """Wait for some virtual seconds; 0 or less is a checkpoint."""
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
        heapq.heappush(self._sleepers, sleeper)
        if self._wanted is not None:
            self._wanted.fire()
        try:
            await signal.wait()
        except tasks.cancelled:
            _remove(self._sleepers, sleeper)
            raise

    async def run(self) -> None:
        """Leap to the next deadline whenever every other task waits; never returns by itself."""
        wanted = self._wanted = current_tasks().signal()
        while True:
            await wait_until_idle()
            if not self._sleepers or self._sleepers[0][0] == math.inf:
                await wanted.wait()
                continue
            self._time = max(self._time, self._sleepers[0][0])
            heapq.heappop(self._sleepers)[2].fire()


def make_clock(speed: float | str) -> ScaledClock | VirtualClock:
    """The clock of a speed: a factor of wall time, or ``"max"`` for virtual time.

    Where wall time itself is virtual, that is as fast as can be, and ``"max"`` the same as 1.

    Raises:
        SimError: if it is neither, or the factor is above `FASTEST`.
    """
    if speed == "max":
        return VirtualClock() if _leaping_time() is None else WallClock()
    try:
        factor = float(speed)
    except (TypeError, ValueError, OverflowError):
        raise SimError(f"a speed is a number above zero or 'max', not '{speed}'") from None
    return WallClock() if factor == 1.0 else ScaledClock(factor)


def _remove(heap: list[T], item: T) -> None:
    """Take an item out of a heap, if it is there still."""
    if heap and heap[0] is item:
        heapq.heappop(heap)
    elif item in heap:
        heap.remove(item)
        heapq.heapify(heap)


def _leaping_time() -> Callable[[], float] | None:
    """The time of the event loop that runs now, if it is virtual."""
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


# being idle


async def wait_until_idle() -> None:
    """Wait until every other task waits for something that none of them brings about.

    Several may wait so; all go on then. What waits for the network, a thread or wall time counts as
    idle. Cancelling: safe, nothing is lost.
    """
    if anyio.get_cancelled_exc_class() is not asyncio.CancelledError:
        await anyio.wait_all_tasks_blocked()  # trio's own
        return
    turns = _turns.get(None)
    if turns is None:
        turns = _Turns(asyncio.get_running_loop())
        _turns.set(turns)
    await turns.wait_until_idle()


class _Turns:
    """How often an asyncio loop has been idle, and who watches it.

    A watcher takes turn after turn of the loop, so each has one call in the loop's queue; the loop
    is idle when a watcher, in its own turn, finds nothing there but those of the others.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._ready = _queue(loop)
        self._watchers = 0
        self._idle = 0

    async def wait_until_idle(self) -> None:
        """Take turns until the loop is idle; whoever sees it first has seen it for all."""
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


def _queue(loop: asyncio.AbstractEventLoop) -> Sized:
    """The calls that a loop will make in this or its next turn.

    Raises:
        SimError: if the loop does not show them.
    """
    ready = getattr(loop, "_ready", None)  # asyncio's own loops
    if ready is None:  # uvloop hides it from Python, but not from the garbage collector
        held = [each for each in gc.get_referents(loop) if isinstance(each, deque)]
        if len(held) != 1:
            raise SimError(f"virtual time does not work on the event loop {loop!r}")
        ready = held[0]
    return cast("Sized", ready)


# timeouts


def check_timeout(seconds: object) -> None:
    """Raise what a user is to be told of a timeout that is none.

    Raises:
        InvalidOption: if it is neither a number nor None.
    """
    is_number = isinstance(seconds, Real) and not isinstance(seconds, bool)
    if seconds is not None and not (is_number and cast("float", seconds) == seconds):  # not nan
        raise InvalidOption("timeout", f"expected a number of seconds or None, not {seconds!r}")


@asynccontextmanager
async def within(seconds: float | None, clock: Clock) -> AsyncIterator[None]:
    """Cancel the block after some seconds of a clock and go on behind it; never, if None."""
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
