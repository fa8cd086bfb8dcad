"""Ticks: 16 ms apart on an absolute schedule, which can be paused, stepped and gone on with.

While there are no ticks the clock stands, so nobody who waits by it misses one, and behind the
pause the schedule goes on as if there had been none. Knows a clock and what each tick does, no
turtle.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import anyio

from turtleact.errors import SimError
from turtleact.sim.kinematics import DT
from turtleact.tasks import Background, current_tasks

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.clock import Clock

__all__ = ["MOST_BEHIND", "Ticking"]

MOST_BEHIND: Final = 1.0
"""Ticks that are further behind their clock than this (s) are not made up for."""


class Ticking:
    """Ticks from the moment it is made until it is closed; the first one has been made.

    Args:
        clock: Whose time is kept; it stands while there are no ticks.
        tick: What happens in each.
        is_paused: Whether there are none at first.

    Attributes:
        is_paused: Whether there are none, but for those of `step`.
    """

    def __init__(self, clock: Clock, tick: Callable[[], None], *, is_paused: bool = False) -> None:
        self.is_paused = is_paused
        self._clock = clock
        self._tick = tick
        self._start = clock.time()
        self._count = 1
        self._step: _Step | None = None
        self._changed = current_tasks().signal()
        if is_paused:
            clock.stop_at(self._start)
        self._running = Background(self._run(), "turtlesim")

    @property
    def is_stepping(self) -> bool:
        """Whether a `step` is under way."""
        return self._step is not None

    def pause(self) -> None:
        """Make no tick until `resume`, and let the clock stand; a step under way ends here."""
        now = self._clock.time()
        self._clock.stop_at(now)
        self._start = max(self._start, now - self._count * DT)  # what is late stays late no longer
        self._end_step("paused")
        self.is_paused = True

    def resume(self) -> None:
        """Go on, the clock too; a step under way ends here."""
        self._end_step("resumed")
        self.is_paused = False
        self._clock.stop_at(math.inf)
        self._changed.fire()

    async def step(self, ticks: int = 1, on_tick: Callable[[], None] | None = None) -> None:
        """Let some ticks pass in a pause, at the pace of the clock, and wait for the last.

        Cancelling: no tick is made any more.

        Args:
            ticks: How many, 0 or more.
            on_tick: Called after each.

        Raises:
            SimError: if there is no pause, or a step is under way already, or ``ticks`` is
                negative; if somebody pauses or resumes before the last.
        """
        if ticks < 0:
            raise SimError(f"{ticks} steps: give 0 or more")
        if not self.is_paused:
            raise SimError("the world is not paused: pause it first")
        if self._step is not None:
            raise SimError(
                "steps are being made already: wait until they are, or pause to end them"
            )
        if not ticks:
            return
        step = self._step = _Step(ticks, on_tick)
        self._clock.stop_at(self._due(ticks - 1))
        self._changed.fire()
        try:
            await step.ended.wait()
        except BaseException:
            if self._step is step:
                self.pause()
            raise
        if step.left:
            made = f"{ticks - step.left} of {ticks} steps"
            raise SimError(f"the world was {step.how} after {made}: pause it, and step on")

    async def aclose(self) -> None:
        """Make no tick any more; the clock goes on."""
        await self._running.aclose()
        self._end_step("closed")
        self._clock.stop_at(math.inf)

    def _due(self, later: int = 0) -> float:
        """When the next tick is due, or one so many later."""
        return self._start + (self._count + later) * DT

    async def _run(self) -> None:
        clock = self._clock
        while True:
            if clock.time() - self._due() > MOST_BEHIND:
                self._start = clock.time() - self._count * DT
                if self._step is not None:
                    clock.stop_at(self._due(self._step.left - 1))
            await clock.sleep_until(self._due())
            if self.is_paused and self._step is None:  # it was late, and is due as the clock stands
                await self._changed.wait()
                continue
            self._count += 1
            self._tick()
            step = self._step
            if step is not None:
                step.note()
                if not step.left:
                    self._end_step("stepped")

    def _end_step(self, how: str) -> None:
        if self._step is not None:
            self._step.how = how
            self._step.ended.set()
            self._step = None


class _Step:
    """Ticks that were asked for.

    Attributes:
        left: How many are still to be made.
        how: Why there are no more.
        ended: Set then.
    """

    def __init__(self, ticks: int, on_tick: Callable[[], None] | None) -> None:
        self.left = ticks
        self.how = ""
        self.ended = anyio.Event()
        self._on_tick = on_tick

    def note(self) -> None:
        """Note that one was made."""
        self.left -= 1
        if self._on_tick is not None:
            self._on_tick()
