"""A world of turtles as a node, in virtual time, and somebody who uses it."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import aclosing, asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

from turtleact.interfaces.standard import (
    Color,
    Empty,
    Kill,
    RotateAbsolute,
    SetPen,
    Spawn,
    TeleportAbsolute,
    TeleportRelative,
    TurtlePose,
    Twist,
    Vector3,
)
from turtleact.node import Node, open_node
from turtleact.sim.turtlesim import Turtlesim
from turtleact.sim.world import World
from turtleact.tasks import Background
from turtleact.tasks.clock import Clock, VirtualClock
from turtleact.transports import MemoryTransport, QoS

GOLDEN = Path(__file__).parent / "golden"
POSES = json.loads((GOLDEN / "poses.json").read_text())
TICK = 0.016
ALL = QoS(depth=10_000)


class Stage(NamedTuple):
    """What a test works with."""

    node: Node
    world: World
    sim: Turtlesim
    home: Node

    def command(self, *, turtle="turtle1", x=0.0, y=0.0, turn=0.0):
        twists = self.node.publisher(Twist, f"{turtle}/cmd_vel")
        twists.publish(Twist(Vector3(x, y), Vector3(z=turn)))

    def poses(self, turtle="turtle1"):
        return self.node.subscription(TurtlePose, f"{turtle}/pose", ALL)

    def colours(self, turtle="turtle1"):
        return self.node.subscription(Color, f"{turtle}/color_sensor", ALL)

    def rotations(self, turtle="turtle1"):
        return self.node.action_client(RotateAbsolute, f"{turtle}/rotate_absolute")

    async def call(self, service: Any, at: str, /, *arguments: object, **options: object) -> Any:
        """Call a service with a request of these arguments."""
        client = self.node.service_client(service, at)
        try:
            return await client.call(service.Request(*arguments, **options))
        finally:
            await client.aclose()

    async def spawn(self, *arguments, **options):
        return (await self.call(Spawn, "spawn", *arguments, **options)).name

    async def kill(self, name):
        await self.call(Kill, "kill", name)

    async def clear(self):
        await self.call(Empty, "clear")

    async def reset(self):
        await self.call(Empty, "reset")

    async def set_pen(self, *arguments, turtle="turtle1", **options):
        await self.call(SetPen, f"{turtle}/set_pen", *arguments, **options)

    async def teleport(self, *arguments, turtle="turtle1"):
        await self.call(TeleportAbsolute, f"{turtle}/teleport_absolute", *arguments)

    async def teleport_relative(self, *arguments, turtle="turtle1"):
        await self.call(TeleportRelative, f"{turtle}/teleport_relative", *arguments)

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
        open_node("world", transport=transport) as beside,
        aclosing(Turtlesim(node, world, beside=beside)) as sim,
        open_node("test", transport=transport) as other,
    ):
        yield Stage(other, world, sim, node)
