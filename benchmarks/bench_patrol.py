"""How close do patrols come to the shortest possible time, compared with a simple controller?

Every patrol has its own start, heading and four targets, drawn from its number. A goal to
``/patrol`` sends the turtle through them in virtual time, once in each style. Eight turtles patrol
side by side. A hit is a tick in which a wall stopped a turtle. The last columns are about the
patrol of the README, which no turtle with these speeds can drive in less than 9.93 s.

The peer is what a student would write: turn and drive in proportion to the error, with no limits
except the speeds.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import random
import statistics
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, aclosing
from pathlib import Path
from typing import NamedTuple

import anyio

from turtleact.actions import serve_built_ins
from turtleact.actions.patrol import Patrol
from turtleact.geometry import bearing, distance, shortest_turn
from turtleact.goals.client import ActionClient
from turtleact.interfaces.standard import Point
from turtleact.node import Node, open_node
from turtleact.sim.kinematics import DT, SIDE, Hit
from turtleact.sim.turtlesim import Turtlesim
from turtleact.sim.world import World
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport

STYLES = ("natural", "rotate_then_drive")
TURTLES = 8
BOUND = 9.93
"""The shortest possible time of the README's patrol (s)."""
README = [(9.0, 7.0), (5.0, 1.0), (1.0, 7.0), (2.0, 9.0)]

Client = ActionClient[Patrol.Goal, Patrol.Result, Patrol.Feedback]


class Course(NamedTuple):
    """The start of a patrol, and its targets."""

    start: tuple[float, float, float]
    targets: list[tuple[float, float]]


class Run(NamedTuple):
    """The outcome of a patrol."""

    seconds: float
    reached: int


class WatchedWorld(World):
    """A world that counts how often a wall stops a turtle."""

    hits = 0

    def step(self) -> list[Hit]:
        hits = super().step()
        self.hits += len(hits)
        return hits


def course(number: int) -> Course:
    uniform = random.Random(number).uniform
    start = (uniform(0.0, SIDE), uniform(0.0, SIDE), uniform(-math.pi, math.pi))
    return Course(start, [(uniform(0.0, SIDE), uniform(0.0, SIDE)) for _ in range(4)])


class Patrols:
    """The patrols of one style, each driven by a goal."""

    def __init__(self, style: str, courses: list[Course]) -> None:
        self.style = style
        self.runs: list[Run] = []
        self.world = WatchedWorld(min(TURTLES, len(courses)))
        self._left: Iterator[Course] = iter(courses)

    async def run(self) -> None:
        clock = VirtualClock()
        transport = MemoryTransport(clock)
        async with AsyncExitStack() as stack:
            open_up = stack.enter_async_context
            await open_up(aclosing(Background(clock.run(), "the clock")))
            node = await open_up(open_node("sim", transport=transport))
            await open_up(aclosing(Turtlesim(node, self.world)))
            serve_built_ins(await open_up(open_node("actions", transport=transport)), side=SIDE)
            async with anyio.create_task_group() as group:
                for turtle in self.world.names:
                    group.start_soon(self._patrol, node, turtle)

    async def _patrol(self, node: Node, turtle: str) -> None:
        client = node.action_client(Patrol, "/patrol")
        for course in self._left:
            self.world.teleport_absolute(turtle, *course.start)
            await node.clock.sleep(2 * DT)
            self.runs.append(await self._send(client, turtle, course))

    async def _send(self, client: Client, turtle: str, course: Course) -> Run:
        targets = [Point(x=x, y=y) for x, y in course.targets]
        goal = Patrol.Goal(targets=targets, turtle=turtle, style=self.style)
        result = await client.send_goal(goal)
        return Run(result.duration, result.reached)


def proportional(courses: list[Course]) -> tuple[list[Run], int]:
    """Run the peer directly in the world, without a goal."""
    world, runs = WatchedWorld(), []
    for course in courses:
        world.teleport_absolute("turtle1", *course.start)
        world.step()
        begun = world.time
        reached = sum(pursue(world, target) for target in course.targets)
        runs.append(Run(world.time - begun, reached))
    return runs, world.hits


def pursue(world: World, target: tuple[float, float]) -> bool:
    deadline = world.time + 60.0
    while world.time < deadline:
        x, y, theta, *_ = world.pose("turtle1")
        away = distance(x, y, *target)
        if away <= 0.1:
            return True
        turn = shortest_turn(theta, bearing(x, y, *target))
        world.set_velocity("turtle1", min(2.0, away), 0.0, max(-2.0, min(2.0, 4.0 * turn)))
        world.step()
    return False


def row(name: str, runs: list[Run], hits: int, readme: Run, wall: float) -> str:
    seconds = sorted(run.seconds for run in runs)
    reached = sum(run.reached for run in runs) / (4 * len(runs))
    total = sum(seconds)
    spots = total / len(runs), statistics.median(seconds), seconds[-1]
    cells = " ".join(f"{spot:>7.2f}" for spot in spots)
    return (
        f"{name:>18} {reached:>8.2%} {hits:>5} {cells} {readme.seconds:>7.2f}"
        f" {readme.seconds / BOUND:>7.3f} {total / wall:>7.0f}x"
    )


def machine() -> str:
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor() or platform.machine()
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return f"{os.cpu_count()} cores, {model}, load {load}, Python {platform.python_version()}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--patrols", type=int, default=200, help="how many in each style")
    count = parser.parse_args().patrols
    courses = [course(number) for number in range(count)]
    readme = [Course((SIDE / 2, SIDE / 2, 0.0), README)]
    print(machine())
    print(f"{count} patrols of 4 targets, seconds each:")
    print(
        f"{'':>18} {'reached':>8} {'hits':>5} {'mean':>7} {'median':>7} {'worst':>7}"
        f" {'README':>7} {'/ 9.93':>7} {'speed':>8}"
    )
    for style in STYLES:
        one, all_of_them = Patrols(style, readme), Patrols(style, courses)
        anyio.run(one.run)
        begun = time.perf_counter()
        anyio.run(all_of_them.run)
        wall = time.perf_counter() - begun
        print(row(style, all_of_them.runs, all_of_them.world.hits, one.runs[0], wall), flush=True)
    ((peer,), _), begun = proportional(readme), time.perf_counter()
    runs, hits = proportional(courses)
    print(row("in proportion", runs, hits, peer, time.perf_counter() - begun))


if __name__ == "__main__":
    main()
