"""The world as a node: it ticks, listens to each turtle's cmd_vel and publishes its pose.

The only part of the simulator that knows ROS and time. For each turtle there are

- ``<turtle>/cmd_vel`` (geometry_msgs/msg/Twist), taken up at the next tick;
- ``<turtle>/pose`` (turtlesim/msg/Pose), published after each tick.

Source: turtlesim 1.8.2, ``turtle_frame.cpp`` and ``turtle.cpp``.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final

from turtleact.errors import SimError
from turtleact.interfaces.standard import TurtlePose, Twist
from turtleact.tasks import Background

if TYPE_CHECKING:
    from turtleact.node import Node
    from turtleact.sim.kinematics import Hits
    from turtleact.sim.world import World
    from turtleact.topics import Publisher, Subscription

__all__ = ["Turtlesim"]

logger = logging.getLogger("turtleact.turtlesim")

MOST_BEHIND: Final = 1.0
"""A world that is further behind its clock than this (s) does not try to catch up."""


class Turtlesim:
    """A world that lives on a node; it ticks from the moment it is made until it is closed.

    The ticks follow an absolute schedule of the node's clock, 16 ms apart, so they do not drift.

    Args:
        node: Where its topics are opened, and whose clock it follows.
        world: The turtles.
    """

    def __init__(self, node: Node, world: World) -> None:
        self._node = node
        self._world = world
        self._turtles = [_Turtle(node, world, name) for name in world.names]
        self._tick()  # here, so that the world is a tick old before anybody can send a goal
        self._ticking = Background(self._run(node.clock.time()), "turtlesim")

    async def aclose(self) -> None:
        """Stop ticking."""
        await self._ticking.aclose()

    async def _run(self, start: float) -> None:
        clock, world = self._node.clock, self._world
        while True:
            due = start + world.time
            if clock.time() - due > MOST_BEHIND:
                start = clock.time() - world.time
            await clock.sleep_until(due)
            self._tick()

    def _tick(self) -> None:
        for turtle in self._turtles:
            turtle.listen()
        self._warn(self._world.step())
        for turtle in self._turtles:
            turtle.tell()

    def _warn(self, hits: Hits) -> None:
        for hit in hits:
            logger.warning("Oh no! I hit the wall! (Clamping from [x=%f, y=%f])", hit.x, hit.depth)


class _Turtle:
    """One turtle's topics."""

    def __init__(self, node: Node, world: World, name: str) -> None:
        self._name = name
        self._world = world
        self._commands: Subscription[Twist] = node.subscription(Twist, f"{name}/cmd_vel")
        self._poses: Publisher[TurtlePose] = node.publisher(TurtlePose, f"{name}/pose")

    def listen(self) -> None:
        for twist in self._commands.drain():
            try:
                self._world.set_velocity(
                    self._name, twist.linear.x, twist.linear.y, twist.angular.z
                )
            except SimError as error:
                logger.warning("a command was ignored: %s", error)

    def tell(self) -> None:
        if self._poses.has_subscriptions:
            self._poses.publish(TurtlePose(*self._world.pose(self._name)))
