"""Time: wall time, a factor of it, or virtual time.

Every wait of turtleact goes through a `Clock`. Virtual time stands still while anything can run,
and leaps to the next deadline once every task waits; so a minute passes in milliseconds, and two
runs of the same program pass through the same moments. Any of them can be made to stand still.

`Clock.time` is for measuring (seconds, from an arbitrary start, never backwards); `Clock.now` is
ROS time (nanoseconds since the epoch) and stamps what others see.

Where the event loop's own time is virtual (`turtleact.testing`), it is wall time to the clocks made
there: all of them, and `anyio.sleep`, then tell one time.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import math
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from numbers import Real
from typing import Generic, Protocol, TypeVar, cast

import anyio

from turtleact.errors import InvalidOption, SimError
from turtleact.tasks import Background, Signal, Tasks, current_tasks, idleness

__all__ = [
    "EPOCH",
    "FASTEST",
    "Clock",
    "ScaledClock",
    "VirtualClock",
    "WallClock",
    "check_timeout",
    "make_clock",
    "within",
]

T = TypeVar("T", bound="tuple[object, ...]")

EPOCH = 1_700_000_000_000_000_000
"""ROS time at the start of virtual time (ns): every run sees the same stamps."""

FASTEST = 100.0
"""Highest factor of wall time: what is faster leaps better, in virtual time."""

LEEWAY = 0.05
"""How far a scaled clock runs ahead of a sleeper that is late (s)."""


_LAST = sys.float_info.max
_SPARE = 16  # So many items of a heap may have been removed, however few there are.


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

    def stop_at(self, moment: float) -> None:
        """Let `time` come no further than ``moment``, or than it is; `math.inf` lets it go on.

        It goes on from where it stood: nobody has slept the time between.
        """

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
        self._sleepers: Heap[tuple[float, int]] = Heap()
        self._end = math.inf
        self._stands = False
        self._freed: Signal | None = None

    def time(self) -> float:
        """Seconds since this clock was made, without those for which it was held up or stood."""
        if self._stands:
            return self._end
        seconds = (self._wall() - self._wall_start) * self.factor
        first = self._sleepers.first
        if first is not None and seconds > (latest := first[0] + LEEWAY):
            self._wall_start += (seconds - latest) / self.factor
            seconds = latest
        if seconds >= self._end:
            self._stands = True
            return self._end
        return seconds

    def now(self) -> int:
        """ROS time; it begins at the wall's time when this clock was made."""
        return self._ros_start + round(self.time() * 1e9)

    async def sleep(self, seconds: float) -> None:
        """Wait for some seconds of this clock; 0 or less is a checkpoint."""
        left = max(seconds, 0.0)
        await self._sleep(self.time() + left, left)

    async def sleep_until(self, deadline: float) -> None:
        """Wait until `time` has reached ``deadline``."""
        now = self.time()
        await self._sleep(max(deadline, now), max(deadline - now, 0.0))

    def stop_at(self, moment: float) -> None:
        """Let `time` come no further than ``moment``, or than it is; `math.inf` lets it go on."""
        now = self.time()
        if self._stands:
            self._wall_start = self._wall() - now / self.factor
            self._stands = False
        self._end = max(moment, now)
        if self._freed is not None:
            self._freed.fire()

    async def _sleep(self, deadline: float, left: float) -> None:
        sleeper = (deadline, next(self._order))
        self._sleepers.push(sleeper)
        try:
            await self._wait(deadline, left)
        except BaseException:
            self._sleepers.remove(sleeper)
            raise
        # It holds the clock up until it waits again: what it does now takes wall time too.
        current_tasks().call_soon(partial(self._sleepers.remove, sleeper))

    async def _wait(self, deadline: float, left: float) -> None:
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
                return  # else something has held the clock up

    async def run(self) -> None:
        """Nothing drives wall time."""
        await anyio.sleep_forever()


class WallClock(ScaledClock):
    """Wall time, whoever is late."""

    def __init__(self) -> None:
        super().__init__()
        self._made = self._wall_start
        if self._wall is time.monotonic:
            self.now = time.time_ns  # type: ignore[method-assign]  # it follows a clock that is set

    def stop_at(self, moment: float) -> None:
        """Let `time` come no further than ``moment``, or than it is; `math.inf` lets it go on."""
        super().stop_at(moment)
        if self._wall is time.monotonic:
            self.now = self._behind  # type: ignore[method-assign]  # as above

    def _behind(self) -> int:
        """The wall's time without that for which this clock stood."""
        stood = self._wall() - self._made - self.time()
        return time.time_ns() - round(stood * 1e9)

    async def _sleep(self, deadline: float, left: float) -> None:
        await self._wait(deadline, left)


class VirtualClock:
    """Time that leaps: it moves on only when every task waits, straight to the next deadline.

    Somebody must `run` it. Sleepers of one deadline go on in the order in which they began to
    sleep, each once all that the one before it brought about has been done. What waits for the
    network, a thread or wall time does not hold virtual time up.
    """

    def __init__(self) -> None:
        self._time = 0.0
        self._order = itertools.count()
        self._sleepers: Heap[tuple[float, int, Signal]] = Heap()
        self._end = _LAST
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
        self._sleepers.push(sleeper)
        if self._wanted is not None:
            self._wanted.fire()
        try:
            await signal.wait()
        except tasks.cancelled:
            self._sleepers.remove(sleeper)
            raise

    def stop_at(self, moment: float) -> None:
        """Leap to no deadline behind ``moment``; `math.inf` lets time go on."""
        self._end = min(moment, _LAST)
        if self._wanted is not None:
            self._wanted.fire()

    async def run(self) -> None:
        """Leap to the next deadline whenever every other task waits; never returns by itself."""
        wanted = self._wanted = current_tasks().signal()
        wait_until_idle, sleepers = idleness(), self._sleepers
        while True:
            await wait_until_idle()
            first = sleepers.first
            if first is None or first[0] > self._end:
                await wanted.wait()
                continue
            self._time = max(self._time, first[0])
            sleepers.remove(first)
            first[2].fire()


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


class Heap(Generic[T]):
    """Different items, the least of them first.

    One that is removed before its turn stays where it is until it is the first, or until there are
    more of its kind than others: to look for it takes long where a thousand sleep.

    Attributes:
        first: The least item; None if there is none.
    """

    def __init__(self) -> None:
        self.first: T | None = None
        self._items: list[T] = []
        self._there: set[T] = set()

    def __len__(self) -> int:
        return len(self._there)

    def push(self, item: T) -> None:
        """Put an item in."""
        heapq.heappush(self._items, item)
        self._there.add(item)
        self.first = self._items[0]

    def remove(self, item: T) -> None:
        """Take an item out, if it is there still."""
        self._there.discard(item)
        if len(self._items) > 2 * len(self._there) + _SPARE:
            self._items = sorted(self._there)
        while self._items and self._items[0] not in self._there:
            heapq.heappop(self._items)
        self.first = self._items[0] if self._items else None


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


# timeouts


def check_timeout(seconds: object, option: str = "timeout", *, may_be_none: bool = True) -> None:
    """Check a timeout that a user has given.

    Args:
        seconds: What was given.
        option: What the user calls it.
        may_be_none: Whether None is allowed, for no limit.

    Raises:
        InvalidOption: if it is not a number, and not an allowed None.
    """
    if may_be_none and seconds is None:
        return
    is_number = isinstance(seconds, Real) and not isinstance(seconds, bool)
    if not (is_number and cast("float", seconds) == seconds):  # not nan
        expected = "a number of seconds or None" if may_be_none else "a number of seconds"
        raise InvalidOption(option, f"expected {expected}, not {seconds!r}")


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
