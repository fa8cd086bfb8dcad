"""A yard: one robot that a test moves by hand, and somebody who drives it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import aclosing, asynccontextmanager
from typing import NamedTuple

from turtleact.actions.driving import Turtles
from turtleact.actions.steering import Area, Limits, Steering
from turtleact.interfaces.standard import Point, TurtlePose, Twist
from turtleact.node import Node, open_node
from turtleact.node.topics import Publisher, Subscription
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport

from ..lab import settle

AREA = Area(0.0, 0.0, 10.0, 8.0)
FAR = Point(x=10_000.0)


class Yard(NamedTuple):
    """A robot that the test moves by hand.

    Attributes:
        clock: Virtual time.
        node: Where its topics are opened by those who drive it.
        turtles: What is tested.
        poses: Says where the robot is.
        twists: What the robot was told.
        at: Where it is while it obeys: x, y, theta.
    """

    clock: VirtualClock
    node: Node
    turtles: Turtles
    poses: Publisher[TurtlePose]
    twists: Subscription[Twist]
    at: list[float]

    def told(self):
        """How fast the robot was last told to go."""
        twist = self.twists.latest
        return None if twist is None else twist.linear.x

    def drive(self, robot="robot", limits=Limits()):  # noqa: B008  # it is frozen
        return self.turtles.drive(robot, Steering(limits=limits))

    def endpoints(self, name=""):
        """The topics that are open on the driving node."""
        node = self.node.fully_qualified_name
        return [each.name for each in self.node.transport.endpoints() if each.node == node]

    async def drive_on(self, until=lambda: False):
        """Drive the robot far away."""
        async with self.drive() as drive:
            while True:
                await drive.towards(FAR)
                if until():
                    return

    @asynccontextmanager
    async def drive_beside(self):
        """Drive the robot far away, in a task of its own."""
        async with aclosing(Background(self.drive_on(), "the driver")):
            await settle()
            yield

    async def tell_every(self, seconds, times):
        """Let the robot say where it is, now and then: from ``x=5`` on."""
        for count in range(5, times + 5):
            self.poses.publish(TurtlePose(x=float(count)))
            await self.clock.sleep(seconds)

    async def keep_telling(self):
        await self.tell_every(0.016, 10_000)


@asynccontextmanager
async def yard(namespace: str = "/") -> AsyncIterator[Yard]:
    clock = VirtualClock()
    transport = MemoryTransport(clock)
    async with (
        aclosing(Background(clock.run(), "the clock")),
        open_node("robot", namespace=namespace, transport=transport) as robot,
        open_node("driver", namespace=namespace, transport=transport) as node,
    ):
        poses = robot.publisher(TurtlePose, "robot/pose")
        twists = robot.subscription(Twist, "robot/cmd_vel")
        yield Yard(clock, node, Turtles(node, AREA), poses, twists, [0.0, 0.0, 0.0])


@asynccontextmanager
async def telling(place):
    """The robot says where it is 62.5 times a second."""
    async with aclosing(Background(place.keep_telling(), "the robot")):
        yield
