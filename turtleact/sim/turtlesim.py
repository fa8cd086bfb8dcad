"""Runs a world of turtles on a node, with the topics, services and parameters of turtlesim.

`Turtlesim` opens the services ``spawn``, ``kill``, ``clear`` and ``reset``, and declares the
parameters ``background_r``, ``background_g``, ``background_b`` and ``holonomic``. The module
`turtle` opens the topics and services of each turtle. The module `world_services` opens the
services for time and pictures, and defines a message with all poses. The other modules of
`turtleact.sim` do not use ROS or a clock.

The real turtlesim exits if a new turtle has an invalid name, and lets a turtle turn forever if a
number is not finite. In both cases, this node logs a message and continues.

Source: turtlesim 1.8.2, ``turtle_frame.cpp``.
"""

from __future__ import annotations

import logging
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Final

import anyio

from turtleact.errors import InvalidName, SimError
from turtleact.interfaces import stamp_of
from turtleact.interfaces.standard import Empty, Kill, Spawn, TurtlePose
from turtleact.names import resolve_name
from turtleact.node.topics import publish_unchecked
from turtleact.sim.drawing import Pens
from turtleact.sim.pictures import BACKGROUND, Colour, Figure, Snapshot, thumbnail
from turtleact.sim.turtle import TOPIC_QOS, Habitat, Turtle
from turtleact.sim.world_services import Pictures, Poses, Simulation, Ticking, poses_of
from turtleact.tasks import current_tasks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from turtleact.node import Node
    from turtleact.node.parameters import Parameter
    from turtleact.node.topics import Publisher
    from turtleact.sim.world import Pose, World

__all__ = ["Turtlesim"]

logger = logging.getLogger("turtleact.turtlesim")

MOST_SHOWN: Final = 100
"""This many turtles are always visible to other processes. Others become visible on demand.

The limit applies to the turtles that exist at the start. A second limit of the same size applies to
spawned turtles.
"""


class Turtlesim:
    """Runs a world on a node. The world ticks until this object is closed.

    The ticks are 16 ms apart on the node's clock. They follow a fixed schedule, so small delays do
    not add up. While the world is paused, the node's clock stands still, and code that waits on the
    clock keeps waiting.

    Args:
        node: The node that opens the topics and services. The world follows the clock of this node.
        world: The world to run.
        beside: The node for features that the real turtlesim lacks: control of time, all poses in
            one message, and pictures. If left out, these features are not served.
        is_paused: Whether to pause the world after its first tick.

    Attributes:
        ticking: Makes the ticks; it can pause them, and make single ones.
    """

    def __init__(
        self, node: Node, world: World, *, beside: Node | None = None, is_paused: bool = False
    ) -> None:
        logger.info("Starting turtlesim with node name %s", node.fully_qualified_name)
        self._node = node
        self._world = world
        self._pens = Pens(world)
        self._habitat = Habitat(node, world, self._pens, self._call_on, self._note_readers)
        self._roster = anyio.Lock()  # turtlesim, too, handles one request at a time
        self._background = [_declare_colour(node, *each) for each in BACKGROUND._asdict().items()]
        node.parameter(
            "holonomic", world.holonomic, description="If true, then turtles will be holonomic"
        ).on_change(self._holonomic_changed)
        self._turtles: dict[str, Turtle] = {}
        self._spawned: set[str] = set()  # and are not on demand
        self._busy: dict[Turtle, None] = {}  # that have something to take up
        self._told: list[tuple[int, Publisher[TurtlePose]]] = []  # by index; somebody reads them
        self._sensed: set[str] = set()
        self._have_readers_changed = True
        self._poses = None
        if beside is not None:
            ask = partial(current_tasks().call_soon, self._tell_paused)
            self._poses = beside.publisher(Poses, "~/poses", TOPIC_QOS, on_matched=ask)
        self._welcome_all()
        node.service(Spawn, "spawn", self._spawn)
        node.service(Kill, "kill", self._kill)
        node.service(Empty, "clear", self._clear)
        node.service(Empty, "reset", self._reset)
        self.tick()  # tick now, so that the world is a tick old before anybody can send a goal
        self.ticking = Ticking(node.clock, self.tick, is_paused=is_paused)
        if beside is not None:
            Simulation(beside, self.ticking, self._restart)
            Pictures(beside, self.snapshot)

    def snapshot(self) -> Snapshot:
        """Return how the world looks now, as input for `turtleact.sim.pictures`."""
        drawing, world = self._pens.drawing, self._world
        colour = (channel.value for channel in self._background)
        places = world.places().tolist()
        figures = [
            Figure(place, world.heading(index), name)
            for index, (place, name) in enumerate(zip(places, world.names, strict=True))
        ]
        return Snapshot(
            Colour(*colour), drawing.pixels(), drawing.base(), drawing.polylines(), figures
        )

    def turtles(self, most: int) -> Iterator[tuple[str, Pose, Colour]]:
        """Yield the name, pose and pen colour of the first ``most`` turtles."""
        for name in islice(self._turtles, most):
            yield name, self._world.pose(name), self._pens.colour(name)

    def thumbnail(self, width: int, height: int) -> list[list[Colour | None]]:
        """Return the drawing, scaled to ``width`` by ``height`` pixels.

        See `turtleact.sim.pictures.thumbnail`.
        """
        return thumbnail(self._pens.drawing.pixels(), width, height)

    async def aclose(self) -> None:
        """Stop making ticks."""
        await self.ticking.aclose()

    def tick(self) -> None:
        """Make one tick now. The schedule calls this every 16 ms of the clock."""
        world = self._world
        busy = list(self._busy)
        self._busy.clear()
        # The order is turtlesim's: commands and teleports first, then goals, then the step. A
        # command that arrives during the tick is therefore taken up by the next one.
        for turtle in busy:
            for twist in turtle.commands.drain():
                turtle.take_up(twist)
        world.take_up()
        for turtle in busy:
            if turtle.turn is not None:
                turtle.rotate(turtle.turn)
            if turtle.turn is not None:
                self._busy[turtle] = None
        hits = world.step()
        for hit in hits:
            logger.warning("Oh no! I hit the wall! (Clamping from [x=%f, y=%f])", hit.x, hit.depth)
        if self._have_readers_changed:
            self._look_around()
        self._tell_poses()
        self._tell_fleet()
        for name, colour in self._pens.follow(self._sensed).items():
            self._turtles[name].tell_colour(colour)

    def _look_around(self) -> None:
        """Update the lists of turtles whose pose or colour topic has readers."""
        self._have_readers_changed = False
        there = sorted((self._world.index(name), turtle) for name, turtle in self._turtles.items())
        self._told = [(at, turtle.poses) for at, turtle in there if turtle.poses.has_subscriptions]
        self._sensed = {turtle.name for _, turtle in there if turtle.colours.has_subscriptions}

    def _tell_poses(self) -> None:
        """After a tick, publish the poses of the turtles whose pose topic has readers."""
        if not self._told:
            return
        # Column by column: a list for each turtle would call the garbage collector.
        x, y, theta, linear, angular = self._world.poses().T.tolist()
        for i, publisher in self._told:
            pose = TurtlePose(x[i], y[i], theta[i], linear[i], angular[i])
            publish_unchecked(publisher, pose)

    def _tell_fleet(self) -> None:
        """Publish all poses in one message, if somebody reads that."""
        if self._poses is not None and self._poses.has_subscriptions:
            self._poses.publish(poses_of(self._world, stamp_of(self._node.clock.now())))

    def _tell_paused(self) -> None:
        """Tell a new reader where all turtles are while the world is paused and makes no ticks."""
        if self.ticking.is_paused:
            self._tell_fleet()

    # turtles that come and go

    def _welcome_all(self) -> None:
        for name in self._world.names:
            x, y, theta, *_ = self._world.pose(name)
            is_shown = int(name.removeprefix("turtle")) <= MOST_SHOWN
            self._welcome(name, x, y, theta, is_shown=is_shown)

    def _welcome(self, name: str, x: float, y: float, theta: float, *, is_shown: bool) -> None:
        self._turtles[name] = Turtle(name, self._habitat, on_demand=not is_shown)
        self._have_readers_changed = True
        logger.info("Spawning turtle [%s] at x=[%f], y=[%f], theta=[%f]", *(name, x, y, theta))

    def _call_on(self, turtle: Turtle) -> None:
        self._busy[turtle] = None

    def _note_readers(self) -> None:
        self._have_readers_changed = True

    async def _spawn(self, request: Spawn.Request) -> Spawn.Response:
        async with self._roster:
            # Names are checked before the world is changed: a turtle whose topics cannot be named
            # would be in the world and unreachable.
            try:
                resolve_name(f"{request.name or 'turtle'}/pose", self._node.namespace)
                name = self._world.spawn(request.x, request.y, request.theta, request.name)
            except InvalidName as error:
                logger.error("A turtle cannot be named [%s]: %s", request.name, error.problem)
                return Spawn.Response()
            except SimError as error:
                if request.name in self._turtles:
                    logger.error("A turtle named [%s] already exists", request.name)
                else:
                    logger.error("A turtle was not spawned: %s", error)
                return Spawn.Response()
            self._pens.hand_out(name)
            is_shown = len(self._spawned) < MOST_SHOWN
            if is_shown:
                self._spawned.add(name)
            self._welcome(name, request.x, request.y, request.theta, is_shown=is_shown)
        return Spawn.Response(name)

    async def _kill(self, request: Kill.Request) -> Kill.Response:
        async with self._roster:
            turtle = self._turtles.pop(request.name, None)
            if turtle is None:
                logger.error("Tried to kill turtle [%s], which does not exist", request.name)
                return Kill.Response()
            self._spawned.discard(turtle.name)
            self._world.kill(turtle.name)
            self._pens.take_back(turtle.name)
            await self._part_with([turtle])
        return Kill.Response()

    async def _clear(self, _request: Empty.Request) -> Empty.Response:
        logger.info("Clearing turtlesim.")
        self._pens.drawing.clear()
        return Empty.Response()

    async def _reset(self, _request: Empty.Request) -> Empty.Response:
        await self._begin_anew(self._world.reset)
        return Empty.Response()

    async def _restart(self) -> None:
        await self._begin_anew(self._world.restart)

    async def _begin_anew(self, begin: Callable[[], None]) -> None:
        """Remove all turtles, put new ones into the world with ``begin``, and open their topics."""
        async with self._roster:
            logger.info("Resetting turtlesim.")
            # The order matters: the old turtles must not be known any more when they are closed, as
            # closing waits for their goals, and ticks pass meanwhile.
            before = list(self._turtles.values())
            self._turtles.clear()
            self._spawned.clear()
            begin()
            self._pens.forget_all()
            await self._part_with(before)
            self._welcome_all()

    async def _part_with(self, turtles: list[Turtle]) -> None:
        """Close turtles at the same time, because each may wait for the clean-up of a goal."""
        self._have_readers_changed = True
        for turtle in turtles:
            self._busy.pop(turtle, None)
            turtle.leave(f"turtle '{turtle.name}' was killed")
        # Shielded: a turtle that is gone from the world must not keep its topics because whoever
        # killed it went away.
        with anyio.CancelScope(shield=True):
            async with anyio.create_task_group() as closing:
                for turtle in turtles:
                    closing.start_soon(turtle.aclose)

    def _holonomic_changed(self, holonomic: bool) -> None:
        self._world.holonomic = holonomic


def _declare_colour(node: Node, colour: str, value: int) -> Parameter[int]:
    description = f"{colour.capitalize()} channel of the background color"
    name = f"background_{colour[0]}"
    return node.parameter(name, value, description=description, range=(0, 255, 1))
