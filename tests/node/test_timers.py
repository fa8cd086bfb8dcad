"""Timers: their schedule, what is skipped, and how they end."""

from __future__ import annotations

import math
from contextlib import aclosing, asynccontextmanager

import anyio
import pytest

from turtleact import Tick, open_node, open_world
from turtleact.errors import InvalidOption, TurtleactError
from turtleact.tasks import Background, wait_until_idle
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport

# uvloop cannot tell when it is idle, so a leap of virtual time takes long on it.
pytestmark = pytest.mark.loops("asyncio", "trio")


@asynccontextmanager
async def lab():
    clock = VirtualClock()
    async with (
        aclosing(Background(clock.run(), "the clock")),
        open_node("lab", transport=MemoryTransport(clock)) as node,
    ):
        yield node


async def times(node, timer, waits):
    """When a loop gets its ticks, if it then waits so long; and the ticks."""
    found = []
    for wait in waits:
        tick = await anext(timer)
        found.append((round(node.clock.time(), 9), tick.number, tick.missed))
        await node.clock.sleep(wait)
    return found


async def test_the_first_tick_comes_after_one_period():
    async with lab() as node:
        await node.clock.sleep(0.3)
        assert await anext(node.every(0.5)) == Tick(1, 0.5, 0)
        assert node.clock.time() == 0.8


async def test_delays_do_not_add_up():
    async with lab() as node:
        timer = node.every(0.1)
        assert await times(node, timer, [0.03, 0.09, 0.0]) == [
            (0.1, 1, 0),
            (0.2, 2, 0),
            (0.3, 3, 0),
        ]
        async for tick in timer:
            if tick.number == 1000:
                break
        assert node.clock.time() == pytest.approx(100.0, abs=1e-9)


@pytest.mark.parametrize(
    ("wait", "then"),
    [
        (0.9, [(2.0, 2, 0), (3.0, 3, 0)]),
        (1.0, [(2.0, 2, 0), (3.0, 3, 0)]),
        (1.5, [(2.5, 2, 0), (3.0, 3, 0)]),
        (2.5, [(3.5, 3, 1), (4.0, 4, 0)]),
        (9.5, [(10.5, 10, 8), (11.0, 11, 0)]),
    ],
)
async def test_a_late_loop_gets_one_tick_at_once_and_then_the_schedule(wait, then):
    async with lab() as node:
        assert (await times(node, node.every(1.0), [wait, 0.0, 0.0]))[1:] == then


async def test_a_pause_of_the_world_holds_a_timer():
    async with open_world(speed="max", paused=True) as node:
        timer = node.every(0.032)
        with anyio.move_on_after(0) as scope:
            await anext(timer)
        assert scope.cancelled_caught
        await node.step(2)
        assert (await anext(timer)).number == 1


async def test_a_cancelled_wait_loses_no_tick():
    async with lab() as node:
        timer = node.every(1.0)
        with anyio.move_on_after(0):
            await anext(timer)
        assert await times(node, timer, [0.0]) == [(1.0, 1, 0)]


@pytest.mark.loops("asyncio", "uvloop", "trio")
async def test_a_loop_ends_when_its_node_closes():
    ended = []

    async def follow(timer):
        async for _ in timer:
            pytest.fail("time stands still")
        ended.append("loop")

    async with anyio.create_task_group() as loops:
        async with open_node("lab", transport=MemoryTransport(VirtualClock())) as node:
            loops.start_soon(follow, node.every(1.0))
            loops.start_soon(follow, node.every(2.0))
            await wait_until_idle()
        await wait_until_idle()
        assert ended == ["loop", "loop"]


async def test_a_closed_node_makes_no_timer_and_lets_none_tick():
    async with lab() as node:
        timer = node.every(1.0)
    with pytest.raises(TurtleactError, match="node '/lab' is closed: open another"):
        node.every(1.0)
    with pytest.raises(StopAsyncIteration):
        await anext(timer)


@pytest.mark.parametrize("seconds", [0, -1.0, math.inf, math.nan, True, None, "1"])
async def test_what_is_no_period_is_refused(seconds):
    async with open_node("lab") as node:
        with pytest.raises(InvalidOption, match=r"^option 'seconds': expected a number of seconds"):
            node.every(seconds)
