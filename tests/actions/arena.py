"""An arena: a world of turtles in virtual time, the built-in actions, and somebody who watches."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, aclosing, asynccontextmanager
from typing import NamedTuple

import anyio

from turtleact.actions import serve_built_ins
from turtleact.interfaces.standard import Twist
from turtleact.node import Node, open_node
from turtleact.node.topics import Subscription
from turtleact.sim.kinematics import SIDE
from turtleact.sim.turtlesim import Turtlesim
from turtleact.sim.world import World
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport, QoS

from ..lab import other_tasks

STYLES = ["natural", "rotate_then_drive"]
MARK = 9.0
"""The ``linear.y`` of a command that is not of an action; a turtle ignores it."""


class Arena(NamedTuple):
    """What a test works with.

    Attributes:
        node: The test's own.
        actions: The one that serves the built-in actions.
        world: The turtles.
        sim: The world as a node; a turtle of a closed one is heard of no more.
        twists: All that ``turtle1`` was told.
    """

    node: Node
    actions: Node
    world: World
    sim: Turtlesim
    twists: Subscription[Twist]

    def commands(self):
        """Linear and angular speed of each new command that is not marked."""
        told = self.twists.drain()
        assert self.twists.missed == 0
        return [(each.linear.x, each.angular.z) for each in told if each.linear.y != MARK]

    @property
    def place(self):
        return tuple(self.world.pose("turtle1"))[:3]

    async def stands_still(self):
        """Whether ``turtle1`` stands still, and was told so last, if it was told anything."""
        told = self.commands()
        await self.node.clock.sleep(0.02)
        pose = self.world.pose("turtle1")
        was_told = told[-1:] in ([], [(0.0, 0.0)])
        return was_told and pose.linear_velocity == pose.angular_velocity == 0.0


@asynccontextmanager
async def arena(turtles: int = 1) -> AsyncIterator[Arena]:
    clock, world = VirtualClock(), World(turtles)
    transport = MemoryTransport(clock)
    async with AsyncExitStack() as stack:
        open_up = stack.enter_async_context
        await open_up(aclosing(Background(clock.run(), "the clock")))
        sim_node = await open_up(open_node("sim", transport=transport))
        sim = await open_up(aclosing(Turtlesim(sim_node, world)))
        node = await open_up(open_node("test", transport=transport))
        twists = node.subscription(Twist, "turtle1/cmd_vel", QoS(depth=100_000))
        actions = await open_up(open_node("actions", transport=transport))
        serve_built_ins(actions, side=SIDE)
        yield Arena(node, actions, world, sim, twists)


def tasks_alive() -> int:
    """How many tasks there are on this loop."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return len(other_tasks())
    import trio

    return trio.lowlevel.current_statistics().tasks_living
