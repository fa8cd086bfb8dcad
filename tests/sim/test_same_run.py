"""The same seed and the same commands give the same run, to the last bit."""

from __future__ import annotations

import asyncio
import hashlib
import random
import subprocess
import sys

import anyio
import pytest

from turtleact import open_world
from turtleact.actions.go_to import GoTo
from turtleact.interfaces.standard import TeleportAbsolute, Twist, Vector3
from turtleact.sim.world_services import Poses
from turtleact.transports import QoS

RUN = """
import sys
sys.path.insert(0, {root!r})
import asyncio
from tests.sim.test_same_run import run
print(asyncio.run(run({turtles}, {seed})))
"""


async def run(turtles: int, seed: int) -> str:
    """A hash of all poses of all turtles, and of the drawing, over two seconds full of things."""
    chance, digest = random.Random(seed), hashlib.sha256()
    async with open_world(speed="max", turtles=turtles, seed=seed, paused=True) as node:
        poses = node.subscription(Poses, "/world/poses", QoS(depth=1000))
        names = [f"turtle{number}" for number in range(1, turtles + 1)]
        twists = [node.publisher(Twist, f"{name}/cmd_vel") for name in names[1:]]
        teleport = node.service_client(TeleportAbsolute, f"{names[-1]}/teleport_absolute")
        goal = GoTo.Goal(x=chance.uniform(1.0, 10.0), y=2.0)
        async with node.action_client(GoTo, "go_to").send_goal(goal):
            for _ in range(12):
                for each in twists:
                    speeds = chance.uniform(-3.0, 3.0), chance.uniform(-3.0, 3.0)
                    each.publish(Twist(Vector3(x=speeds[0]), Vector3(z=speeds[1])))
                await teleport.call(TeleportAbsolute.Request(chance.uniform(0.0, 11.0), 3.0, 1.0))
                await node.step(10)
                for told in poses.drain():
                    digest.update(repr(told).encode())
        digest.update(node.snapshot().pixels)
    return digest.hexdigest()


async def test_another_seed_is_another_run():
    assert await run(3, 7) != await run(3, 8)


@pytest.mark.parametrize("turtles", [3, 40])
def test_a_run_is_the_same_in_another_process_and_on_another_loop(turtles, pytestconfig):
    program = RUN.format(root=str(pytestconfig.rootpath), turtles=turtles, seed=7)
    other = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    here = asyncio.run(run(turtles, 7))
    assert other.returncode == 0, other.stderr
    assert other.stdout.strip() == here == anyio.run(run, turtles, 7, backend="trio")
