"""The ticks of a world: their schedule, and pauses in it."""

from __future__ import annotations

import itertools
from contextlib import aclosing, asynccontextmanager

import anyio
import pytest

from turtleact.errors import SimError
from turtleact.sim.world_services import Ticking
from turtleact.tasks import Background, wait_until_idle
from turtleact.tasks.clock import VirtualClock, make_clock
from turtleact.testing import virtual_backend

from ..lab import running

TICK = 0.016

LEAPING = pytest.mark.parametrize(
    "anyio_backend",
    [
        pytest.param(virtual_backend("asyncio"), id="asyncio"),
        pytest.param(virtual_backend("trio"), id="trio"),
    ],
)
"""The wall's own time leaps, so that clocks which follow it need not be waited for."""

SPEEDS = pytest.mark.parametrize("speed", [1.0, 0.5, 20.0, "max"])


class Ticks:
    """Ticks under way, and when they were made."""

    def __init__(self, clock, *, is_paused=False):
        self.clock = clock
        self.log = []
        self.ticking = Ticking(clock, self._tick, is_paused=is_paused)

    def _tick(self):
        self.log.append(self.clock.time())

    async def pass_ticks(self, ticks):
        await self.clock.sleep(ticks * TICK)


@asynccontextmanager
async def ticks(clock=None, *, is_paused=False):
    clock = VirtualClock() if clock is None else clock
    async with aclosing(Background(clock.run(), "the clock")):
        made = Ticks(clock, is_paused=is_paused)
        async with aclosing(made.ticking):
            yield made


@LEAPING
@SPEEDS
async def test_pauses_change_nothing_of_the_schedule(speed):
    async with ticks(make_clock(speed)) as here:
        for _ in range(4):
            await here.pass_ticks(2.3)
            here.ticking.pause()
            await anyio.sleep(1000.0)
            here.ticking.resume()
        await here.pass_ticks(1.0)
    assert here.log == pytest.approx([TICK * n for n in range(1, 11)], abs=1e-6)


@LEAPING
@SPEEDS
async def test_the_ticks_of_steps_are_as_far_apart_as_any(speed):
    async with ticks(make_clock(speed), is_paused=True) as here:
        for number in (1, 3, 2):
            await here.ticking.step(number)
            await anyio.sleep(1000.0)
        here.ticking.resume()
        await here.pass_ticks(2.5)
    assert here.log == pytest.approx([TICK * n for n in range(1, 9)], abs=1e-6)


async def test_whoever_sleeps_goes_on_between_the_ticks_of_a_step():
    async with (
        ticks(is_paused=True) as here,
        running(lambda: here.clock.sleep(2.5 * TICK)) as sleeper,
    ):
        await here.ticking.step(2)
        assert not sleeper.done.is_set()
        await here.ticking.step()
        assert sleeper.done.is_set()


async def test_there_are_no_steps_below_none():
    async with ticks(is_paused=True) as here:
        await here.ticking.step(0)
        with pytest.raises(SimError, match="-1 steps: give 0 or more"):
            await here.ticking.step(-1)
        assert here.log == []


async def test_steps_are_made_for_one_who_asks_at_a_time():
    async with ticks(is_paused=True) as here:
        async with running(lambda: here.ticking.step(1000)) as first:
            assert here.ticking.is_stepping
            with pytest.raises(SimError, match="wait for the last step, or pause to end it"):
                await here.ticking.step()
            await first.done.wait()
        assert (len(here.log), here.ticking.is_stepping) == (1000, False)


def after(ticks, number, call):
    """What is to be called after each tick of a step, to call something after one of them."""
    count = itertools.count(1)
    return lambda: call() if next(count) == number else None


async def test_a_pause_ends_a_step():
    async with ticks(is_paused=True) as here:
        with pytest.raises(SimError, match="the world was paused after 3 of 10 steps: pause it,"):
            await here.ticking.step(10, after(here, 3, here.ticking.pause))
        await wait_until_idle()
        assert (len(here.log), here.ticking.is_paused) == (3, True)


async def test_going_on_ends_a_step_and_goes_on():
    async with ticks(is_paused=True) as here:
        with pytest.raises(SimError, match="the world was resumed after 3 of 10 steps"):
            await here.ticking.step(10, after(here, 3, here.ticking.resume))
        await here.clock.sleep_until(100.5 * TICK)
        assert (len(here.log), here.ticking.is_paused) == (100, False)
