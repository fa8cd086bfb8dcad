"""What does a running world cost, and does it keep time?

Everything runs in one process and one event loop. In the order of the table: how late ticks come
and whether they drift; a fleet in which each turtle is driven by its own goal, which somebody
follows; patrols in virtual time; and the cost of a turtle in fleets of different sizes. The minimum
of a tick is a loop that only sleeps.

The only option is how many seconds to watch the ticks, 60 by default.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import resource
import statistics
import time

import numpy as np

from benchmarks.bench_sim import machine, versions
from turtleact import open_world
from turtleact.actions.go_to import GoTo
from turtleact.actions.patrol import Patrol
from turtleact.interfaces.standard import Point
from turtleact.sim.drawing import Pens
from turtleact.sim.kinematics import DT
from turtleact.sim.world import World
from turtleact.sim.world_services import Poses

FLEETS = (10, 1_000, 10_000)
WORLDS = (10, 1_000, 100_000)
TARGETS = [Point(x=9.0, y=7.0), Point(x=5.0, y=1.0), Point(x=1.0, y=7.0), Point(x=2.0, y=9.0)]
DRIVEN = 1_000
DRIVING = 5.0
PATROLS = 20


def quantiles(values: list[float]) -> str:
    ordered = sorted(values)
    p50, p99 = (ordered[int(len(ordered) * share)] for share in (0.5, 0.99))
    return f"p50 {p50 * 1e3:.2f}, p99 {p99 * 1e3:.2f}, most {ordered[-1] * 1e3:.2f} ms"


async def watch_ticks(seconds: float) -> None:
    async with open_world() as node:
        start, came = node.clock.time(), []
        poses = node.subscription(Poses, "/world/poses")
        async for _ in poses:
            came.append(node.clock.time())
            if came[-1] - start > seconds:
                break
    numbers = np.round((np.array(came) - came[0]) / DT)
    late = np.array(came) - came[0] - numbers * DT
    print(f"ticks late, over {seconds:g} s: {quantiles((late - late.min()).tolist())}")
    sixth = max(1, len(came) // 6)
    drift = statistics.median(late[-sixth:]) - statistics.median(late[:sixth])
    lost = int(numbers[-1]) + 1 - len(came)
    print(f"ticks drift, first to last sixth: {drift * 1e3:+.3f} ms; {lost} were lost")


async def sleep_alone(seconds: float) -> None:
    start, late = time.perf_counter(), []
    for number in range(1, int(seconds / DT)):
        await asyncio.sleep(start + number * DT - time.perf_counter())
        late.append(time.perf_counter() - start - number * DT)
    print(f"a loop that only sleeps: {quantiles(late)}")


async def drive_a_fleet() -> None:
    async with open_world(turtles=DRIVEN, placing="grid") as node:
        client, followed = node.action_client(GoTo, "go_to"), [0] * DRIVEN

        async def drive(index: int) -> None:
            side = 1.5 + 8.0 * ((index * 7919) % DRIVEN) / DRIVEN
            while True:
                for x, y in ((side, 1.5), (side, 9.5)):
                    goal = GoTo.Goal(x=x, y=y, turtle=f"turtle{index + 1}")
                    async with client.send_goal(goal) as handle:
                        async for _ in handle:
                            followed[index] += 1

        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(drive(index)) for index in range(DRIVEN)]
            await asyncio.sleep(1.0)
            ticks = node.subscription(Poses, "/world/poses")
            wall, cpu, made = time.perf_counter(), time.process_time(), 0
            async for _ in ticks:
                made += 1
                if time.perf_counter() - wall > DRIVING:
                    break
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            for task in tasks:
                task.cancel()
    share = made * DT / wall
    print(
        f"{DRIVEN:,} turtles, a goal and a follower each: {share:.2f}x real time,"
        f" {cpu / wall:.0%} of a core, {sum(followed):,} feedback messages"
    )


async def patrol() -> None:
    begun = time.perf_counter()
    for _ in range(PATROLS):
        async with open_world(speed="max") as node:
            await node.action_client(Patrol, "patrol").send_goal(Patrol.Goal(targets=TARGETS))
            simulated = node.clock.time()
    wall = (time.perf_counter() - begun) / PATROLS
    print(f"patrols in virtual time: {1 / wall:.1f} a second, {simulated / wall:.0f}x real time")


async def open_fleet(count: int) -> str:
    before, begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    async with open_world(speed="max", turtles=count, paused=True) as node:
        opened = time.perf_counter() - begun
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        begun = time.perf_counter()
        await node.step(50)
        at_rest = (time.perf_counter() - begun) / 50
        poses = node.subscription(Poses, "/world/poses")
        begun = time.perf_counter()
        await node.step(50)
        watched = (time.perf_counter() - begun) / 50
        assert poses.latest is not None
        assert len(poses.latest.names) == count
    return (
        f"{count:>9,} {opened / count * 1e6:>12.0f} {memory / count:>9.0f}"
        f" {at_rest * 1e3:>9.2f} {watched * 1e3:>9.2f}"
    )


def move(count: int, turn: float) -> float:
    """The microseconds per turtle and tick, drawing included."""
    world = World(count)
    pens = Pens(world)
    ticks = max(12, min(2_000, 200_000 // count))
    begun = time.perf_counter()
    for tick in range(ticks):
        if not tick % 60:
            world.set_velocities(0.3, 0.0, turn)
        world.step()
        pens.follow()
    return (time.perf_counter() - begun) / ticks / count * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    seconds = parser.parse_args().seconds
    print(machine())
    print(versions())
    print()
    asyncio.run(watch_ticks(seconds))
    asyncio.run(sleep_alone(min(seconds, 10.0)))
    asyncio.run(drive_a_fleet())
    asyncio.run(patrol())
    print(f"\n{'turtles':>9} {'open us each':>12} {'KB each':>9} {'rest ms':>9} {'told ms':>9}")
    for count in FLEETS:
        print(asyncio.run(open_fleet(count)), flush=True)
    print(f"\n{'turtles':>9} {'straight us':>12} {'curves us':>10}   (a turtle and tick, drawn)")
    for count in WORLDS:
        print(f"{count:>9,} {move(count, 0.0):>12.3f} {move(count, 1.0):>10.3f}", flush=True)
    print(f"\nload at the end: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
