"""Time: wall time, a factor of it, or virtual time.

Every wait of turtleact goes through a `Clock`. Virtual time stands still while anything can run,
and leaps to the next deadline once every task waits; so a minute passes in milliseconds, and two
runs of the same program pass through the same moments.

`Clock.time` is for measuring (seconds, from an arbitrary start, never backwards); `Clock.now` is
ROS time (nanoseconds since the epoch) and stamps what others see.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import math
import time
from typing import Protocol

import anyio

from turtleact.errors import SimError
from turtleact.tasks import Signal, Tasks, current_tasks

__all__ = ["Clock", "ScaledClock", "VirtualClock", "WallClock", "make_clock"]


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

    def wall_seconds(self, seconds: float) -> float:
        """How long some seconds of this clock last, at most, in wall time: for timeouts."""

    async def run(self) -> None:
        """Drive the clock for as long as it is needed; never returns by itself."""


class ScaledClock:
    """Wall time, ``factor`` times as fast.

    Args:
        factor: Seconds of this clock a second of wall time, above zero.

    Raises:
        SimError: if the factor is not a finite number above zero.
    """

    def __init__(self, factor: float = 1.0) -> None:
        if not (math.isfinite(factor) and factor > 0):
            raise SimError(f"a clock's speed must be a number above zero, not {factor}")
        self.factor = factor
        self._wall_start = time.monotonic()
        self._ros_start = time.time_ns()

    def time(self) -> float:
        """Seconds since this clock was made."""
        return (time.monotonic() - self._wall_start) * self.factor

    def now(self) -> int:
        """ROS time; it begins at the wall's time when this clock was made."""
        return self._ros_start + int(self.time() * 1e9)

    async def sleep(self, seconds: float) -> None:
        """Wait for some seconds of this clock; 0 or less is a checkpoint."""
        await anyio.sleep(max(seconds, 0.0) / self.factor)

    async def sleep_until(self, deadline: float) -> None:
        """Wait until `time` has reached ``deadline``."""
        await self.sleep(deadline - self.time())

    def wall_seconds(self, seconds: float) -> float:
        """How long some seconds of this clock last in wall time."""
        return seconds / self.factor

    async def run(self) -> None:
        """Nothing drives wall time."""
        await anyio.sleep_forever()


class WallClock(ScaledClock):
    """Wall time."""

    def __init__(self) -> None:
        super().__init__()

    now = staticmethod(time.time_ns)


class VirtualClock:
    """Time that leaps: it moves on only when every task waits, straight to the next deadline.

    Somebody must `run` it. Sleepers of one deadline go on in the order in which they began to
    sleep. What waits for the network, a thread or wall time does not hold virtual time up.
    """

    EPOCH = 1_700_000_000_000_000_000

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
        return self.EPOCH + round(self._time * 1e9)

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
            if sleeper in self._sleepers:
                self._sleepers.remove(sleeper)
                heapq.heapify(self._sleepers)
            raise

    def wall_seconds(self, seconds: float) -> float:
        """At most as long as they say: virtual time is never slower than the wall's."""
        return seconds

    async def run(self) -> None:
        """Leap to the next deadline whenever every other task waits; never returns by itself."""
        self._wanted = current_tasks().signal()
        while True:
            await _wait_until_idle()
            if not self._sleepers:
                await self._wanted.wait()
                continue
            self._time = self._sleepers[0][0]
            while self._sleepers and self._sleepers[0][0] <= self._time:
                heapq.heappop(self._sleepers)[2].fire()


def make_clock(speed: float | str) -> ScaledClock | VirtualClock:
    """The clock of a speed: a factor of wall time, or ``"max"`` for virtual time.

    Raises:
        SimError: if it is neither.
    """
    if speed == "max":
        return VirtualClock()
    try:
        factor = float(speed)
    except ValueError:
        raise SimError(f"a speed is a number above zero or 'max', not '{speed}'") from None
    return WallClock() if factor == 1.0 else ScaledClock(factor)


async def _wait_until_idle() -> None:
    """Return once every other task waits for something that none of them can bring about."""
    if anyio.get_cancelled_exc_class() is not asyncio.CancelledError:
        await anyio.wait_all_tasks_blocked()  # trio's own
        return
    ready = getattr(asyncio.get_running_loop(), "_ready", None)  # asyncio's own loops have it
    await asyncio.sleep(0)
    while ready if ready is not None else _any_task_runs():
        await asyncio.sleep(0)


def _any_task_runs() -> bool:
    """Whether another task can go on in this or the next turn of the loop (uvloop)."""
    me = asyncio.current_task()
    for task in asyncio.all_tasks():
        waits_for = getattr(task, "_fut_waiter", None)
        if task is not me and (waits_for is None or waits_for.done()):
            return True
    return False
