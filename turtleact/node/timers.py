"""Timers: ticks at a fixed rate, by the clock of the graph.

Source: rcl ``timer.c``: after a delay of several periods, a timer ticks once and then keeps its old
schedule.
"""

from __future__ import annotations

import math
from numbers import Real
from typing import NamedTuple, Self, cast

from turtleact.errors import InvalidOption, TurtleactError
from turtleact.node.resources import Resources
from turtleact.tasks.clock import Clock

__all__ = ["Tick", "Timer"]


class Tick(NamedTuple):
    """One tick of a timer.

    Attributes:
        number: How many periods have passed since the timer was made: 1 for the first tick. This
            number includes skipped ticks.
        elapsed: The time from the timer's creation to the scheduled time of this tick (s, by the
            graph's clock). This time is ``number`` times the period.
        missed: How many ticks were skipped just before this one.
    """

    number: int
    elapsed: float
    missed: int


class Timer:
    """Ticks at a fixed rate. `turtleact.Node.every` makes one.

    ``async for tick in timer`` waits for each `Tick`. The first tick comes one period after the
    timer was made. The schedule is absolute, so delays do not add up. If your loop takes longer
    than a period, the newest missed tick comes at once and the timer skips the older ones. The next
    tick comes at its scheduled time. In virtual time, ticks come without real waiting. While a
    simulated world has paused the graph's clock, no ticks come. The ``async for`` loop ends when
    the node closes.

    Only one task at a time can wait for ticks of a timer. Cancelling the wait is safe: no tick is
    lost.

    Attributes:
        period: The time between two ticks (s, by the graph's clock).
    """

    def __init__(self, period: float, clock: Clock, resources: Resources) -> None:
        self.period = _checked(period)
        self._clock = clock
        self._resources = resources
        self._start = clock.time()
        self._number = 0
        self._is_awaited = False
        self._home = resources.home.of("the timer")

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Tick:
        self._home.check()
        if self._is_awaited:
            raise TurtleactError("another task waits for this timer: give each its own")
        # The tick that is due now, however late, or else the next one. The division may be off by a
        # rounding error: `max` then keeps it from repeating a tick, and `sleep_until` waits for the
        # rest.
        passed = math.floor((self._clock.time() - self._start) / self.period)
        number = max(self._number + 1, passed)
        await self._wait_until(self._start + number * self.period)
        missed = number - self._number - 1
        # Only now, so that a cancelled wait loses no tick.
        self._number = number
        return Tick(number, number * self.period, missed)

    async def _wait_until(self, moment: float) -> None:
        self._is_awaited = True
        try:
            if self._resources.is_open:
                with self._resources.waiting():
                    await self._clock.sleep_until(moment)
        finally:
            self._is_awaited = False
        if not self._resources.is_open:
            raise StopAsyncIteration


def _checked(period: object) -> float:
    is_number = isinstance(period, Real) and not isinstance(period, bool)
    if not (is_number and 0 < cast("float", period) < math.inf):
        raise InvalidOption("seconds", f"expected a number of seconds above zero, not {period!r}")
    return float(cast("float", period))
