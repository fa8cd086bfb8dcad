"""The world as a node: its topics, its ticks, and its warnings."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import AsyncIterator
from contextlib import aclosing, asynccontextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from turtleact.clock import Clock, VirtualClock
from turtleact.interfaces.standard import TurtlePose, Twist, Vector3
from turtleact.node import Node, open_node
from turtleact.sim.turtlesim import Turtlesim
from turtleact.sim.world import World
from turtleact.tasks import Background
from turtleact.transports import MemoryTransport, QoS

POSES = json.loads((Path(__file__).parent / "golden" / "poses.json").read_text())
TICK = 0.016


class Stage(NamedTuple):
    """What a test works with."""

    node: Node
    world: World
    sim: Turtlesim

    def command(self, *, turtle="turtle1", x=0.0, y=0.0, turn=0.0):
        twists = self.node.publisher(Twist, f"{turtle}/cmd_vel")
        twists.publish(Twist(Vector3(x, y), Vector3(z=turn)))

    def poses(self, turtle="turtle1"):
        return self.node.subscription(TurtlePose, f"{turtle}/pose", QoS(depth=10_000))

    async def pass_ticks(self, ticks):
        """Wait until just after so many ticks."""
        await self.node.clock.sleep((ticks + 0.5) * TICK)


@asynccontextmanager
async def stage(
    turtles: int = 1, clock: Clock | None = None, *, holonomic: bool = False
) -> AsyncIterator[Stage]:
    world = World(turtles, holonomic=holonomic)
    transport = MemoryTransport(VirtualClock() if clock is None else clock)
    async with (
        aclosing(Background(transport.clock.run(), "the clock")),
        open_node("turtlesim", transport=transport) as node,
        aclosing(Turtlesim(node, world)) as sim,
        open_node("test", transport=transport) as other,
    ):
        yield Stage(other, world, sim)


class Jumping:
    """Virtual time that a test can put forward, past those who sleep."""

    def __init__(self) -> None:
        self.ahead = 0.0
        self._inner = VirtualClock()

    def time(self) -> float:
        return self._inner.time() + self.ahead

    def now(self) -> int:
        return self._inner.now() + int(self.ahead * 1e9)

    async def sleep(self, seconds: float) -> None:
        await self._inner.sleep(seconds)

    async def sleep_until(self, deadline: float) -> None:
        await self._inner.sleep_until(deadline - self.ahead)

    async def run(self) -> None:
        await self._inner.run()


# Topics


async def test_each_turtle_has_a_pose_and_takes_commands():
    async with stage(turtles=2) as here:
        assert here.node.graph().topics == {
            "/turtle1/cmd_vel": ("geometry_msgs/msg/Twist",),
            "/turtle1/pose": ("turtlesim/msg/Pose",),
            "/turtle2/cmd_vel": ("geometry_msgs/msg/Twist",),
            "/turtle2/pose": ("turtlesim/msg/Pose",),
        }


async def test_a_pose_is_published_after_each_tick():
    async with stage() as here:
        poses = here.poses()
        here.command(x=2.0)
        await here.pass_ticks(3)
        first = POSES["start"][0]
        assert [pose.x for pose in poses.drain()] == pytest.approx(
            [first + 0.032, first + 0.064, first + 0.096], abs=1e-6
        )


async def test_one_command_ends_at_the_pose_of_the_real_one():
    async with stage() as here:
        poses = here.poses()
        here.command(x=2.0, turn=1.8)
        await here.pass_ticks(100)
        end = poses.drain()[-1]
    ended = (end.x, end.y, end.theta, end.linear_velocity, end.angular_velocity)
    assert ended == tuple(POSES["cmd_vel_end"])


async def test_one_command_moves_its_turtle_for_63_ticks():
    async with stage() as here:
        poses = here.poses()
        here.command(x=2.0)
        await here.pass_ticks(100)
        moving = [pose.linear_velocity for pose in poses.drain()]
    assert moving == [2.0] * 63 + [0.0] * 37


async def test_of_several_commands_between_two_ticks_the_newest_counts():
    async with stage() as here:
        poses = here.poses()
        for speed in (1.0, 3.0, 2.0):
            here.command(x=speed)
        await here.pass_ticks(1)
        assert poses.drain()[-1].linear_velocity == 2.0


async def test_a_sideways_speed_is_ignored():
    async with stage() as here:
        here.command(y=1.0)
        await here.pass_ticks(10)
        assert here.world.pose("turtle1")[:3] == tuple(POSES["start"][:3])


async def test_a_holonomic_turtle_moves_sideways():
    async with stage(holonomic=True) as here:
        here.command(y=1.0)
        await here.pass_ticks(10)
        assert here.world.pose("turtle1").y == pytest.approx(POSES["start"][1] + 0.16, abs=1e-6)


async def test_each_turtle_takes_its_own_commands():
    async with stage(turtles=3) as here:
        here.command(turtle="turtle2", x=1.0)
        await here.pass_ticks(1)
        speeds = [here.world.pose(name).linear_velocity for name in here.world.names]
    assert speeds == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("value", [math.nan, math.inf])
async def test_a_command_that_is_not_finite_is_ignored_with_a_warning(value, caplog):
    async with stage() as here:
        here.command(x=1.0)
        await here.pass_ticks(1)
        here.command(turn=value)
        await here.pass_ticks(10)
        assert here.world.pose("turtle1").linear_velocity == 1.0
    (record,) = caplog.records
    assert (record.name, record.levelno) == ("turtleact.turtlesim", logging.WARNING)
    assert record.getMessage() == (
        f"a command was ignored: turtle1: omega is {value}: give a finite number"
    )


async def test_at_the_wall_it_warns_in_the_words_of_the_real_one(caplog):
    async with stage() as here:
        here.world.teleport_absolute("turtle1", 10.0, 5.0, 0.0)
        await here.pass_ticks(1)
        here.command(x=2.0)
        await here.pass_ticks(40)
    texts = [record.getMessage() for record in caplog.records]
    assert len(texts) == 40 - 34
    assert texts[1] == "Oh no! I hit the wall! (Clamping from [x=11.120889, y=6.088889])"
    assert {record.levelno for record in caplog.records} == {logging.WARNING}


async def test_a_pose_that_nobody_reads_is_not_made(monkeypatch):
    asked: list[str] = []
    async with stage() as here:
        monkeypatch.setattr(here.world, "pose", asked.append)
        await here.pass_ticks(10)
    assert asked == []


# Ticks


async def test_the_world_is_a_tick_old_from_the_start():
    async with stage() as here:
        assert here.world.tick == 1


async def test_the_ticks_do_not_drift():
    async with stage() as here:
        await here.node.clock.sleep(160.0 - TICK / 2)
        assert here.world.tick == 10_000


async def test_a_world_that_is_a_little_behind_its_clock_catches_up():
    clock = Jumping()
    async with stage(clock=clock) as here:
        await here.pass_ticks(10)
        clock.ahead = 0.9
        await clock.sleep(TICK)
        assert here.world.tick == math.ceil(clock.time() / TICK)


async def test_a_world_that_is_far_behind_its_clock_goes_on_from_there():
    clock = Jumping()
    async with stage(clock=clock) as here:
        await here.pass_ticks(10)
        before, clock.ahead = here.world.tick, 100.0
        await here.pass_ticks(10)
        assert here.world.tick - before in (10, 11, 12)


async def test_a_closed_one_ticks_no_more():
    async with stage() as here:
        await here.pass_ticks(5)
        await here.sim.aclose()
        before = here.world.tick
        await here.pass_ticks(100)
        assert here.world.tick == before
