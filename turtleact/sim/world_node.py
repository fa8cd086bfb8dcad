"""Opens a world: transport, clock, turtles and built-in actions in one context manager.

Only this module imports both the simulator and the actions.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, aclosing, asynccontextmanager
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from turtleact.actions import serve_built_ins
from turtleact.goals.records import GoalJournal, OnRestart
from turtleact.node import Node, Transition, close_withdrawn, open_node
from turtleact.sim.kinematics import SIDE
from turtleact.sim.pictures import Snapshot
from turtleact.sim.turtlesim import Turtlesim
from turtleact.sim.world import World
from turtleact.tasks import Background, opening
from turtleact.tasks.clock import Clock, make_clock
from turtleact.transports import MemoryTransport, Transport

if TYPE_CHECKING:
    from turtleact.goals.service_server import Introspection

__all__ = ["OpenGraph", "WorldNode", "open_world"]

N = TypeVar("N", bound=Node)

OpenGraph: TypeAlias = Callable[[Clock], AbstractAsyncContextManager[Transport]]
"""A function that takes a clock and opens a graph. The nodes on the graph share that clock."""


class WorldNode(Node):
    """A node in the same process as a world. The node can also pause and step that world.

    `open_world` opens a world and yields its node.

    Attributes:
        sim: The simulator of the world.
    """

    def __init__(
        self, name: str, transport: Transport, sim: Turtlesim, built_ins: Node | None = None
    ) -> None:
        super().__init__(name, "/", transport)
        self.sim = sim
        self._built_ins = built_ins

    async def aclose(self) -> None:
        """Close the node as `Node.aclose` does. `open_world` then closes the world.

        If this node has replaced a built-in action, closing the node does not bring the built-in
        action back. Otherwise, the built-in action would be served again for a moment, and the log
        would report its return.
        """
        if self._built_ins is not None:
            await close_withdrawn(self._built_ins)
        await super().aclose()

    @property
    def is_paused(self) -> bool:
        """Whether the world is paused. A paused world runs only the ticks of `step`."""
        return self.sim.ticking.is_paused

    def pause(self) -> None:
        """Stop the time of the world, for everything that waits on `clock`."""
        self.sim.ticking.pause()

    def resume(self) -> None:
        """Let the time of the world continue from where it stopped."""
        self.sim.ticking.resume()

    def snapshot(self) -> Snapshot:
        """Return a picture of the world, for `to_png` and `to_svg` of `turtleact.sim.pictures`."""
        return self.sim.snapshot()

    async def step(self, ticks: int = 1) -> None:
        """Run ``ticks`` ticks of 16 ms while the world is paused, and wait until they are done.

        Cancelling: stops after the current tick.

        Raises:
            SimError: if the world is not paused, if another call is stepping it, if ``ticks`` is
                negative, or if somebody pauses or resumes the world before the last tick.
        """
        await self.sim.ticking.step(ticks)


@opening
async def open_world(
    *,
    speed: float | str = 1.0,
    seed: int = 0,
    turtles: int = 1,
    placing: str = "random",
    collide: bool = False,
    paused: bool = False,
    turtlesim_only: bool = False,
    graph: OpenGraph | None = None,
    on_transition: Transition | None = None,
    on_start: Callable[[Turtlesim], object] | None = None,
    journal: GoalJournal | None = None,
    on_restart: OnRestart = "abort",
    introspection: Introspection = "off",
    on_node: Callable[[Node], object] | None = None,
) -> AsyncIterator[WorldNode]:
    """Open a world of turtles with the built-in actions, and yield a node in the same process.

    Args:
        speed: Simulated seconds per wall-clock second, above 0 and at most 100, or ``"max"`` for
            virtual time, which runs as fast as the computer can and gives the same run every time.
            If the computer cannot keep up, time passes more slowly.
        seed: The seed of the random starting poses of all turtles except the first.
        turtles: How many turtles there are: ``turtle1``, ``turtle2``, …
        placing: Where the turtles start: ``"random"``, ``"grid"`` or ``"ring"``.
        collide: Whether turtles block each other.
        paused: Whether the world starts paused.
        turtlesim_only: Whether the world is limited to what the real turtlesim offers, on the node
            ``/turtlesim``. If False, the node ``/turtle_actions`` also serves the built-in actions
            (``/patrol``, ``/go_to``, ``/command_turtle``, ``/fibonacci``). If False, another node,
            ``/world``, also has services for time and pictures, and a topic with all poses in one
            message.
        graph: A function that opens the graph for the world; None for a graph within this process.
        on_transition: Called with each state change of the goals that the world serves; see
            `Node.on_transition`.
        on_start: Called with the simulator before anybody can send commands to the turtles.
        journal: The journal in which the goals of the built-in actions are kept; see
            `turtleact.open_journal`. The journal does not keep the turtles: after a restart, they
            begin at their starting poses.
        on_restart: The option ``on_restart`` of `Node.action_server`, for the built-in actions.
        introspection: The introspection of all nodes of the world; see `Node`.
        on_node: Called with each node of the world as soon as the node is open.

    Raises:
        SimError: if the speed or the number of turtles is out of range, or the placing is unknown.
    """
    world = World(turtles, seed, placing=placing, collide=collide)
    clock = make_clock(speed)
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(aclosing(Background(clock.run(), "the clock")))
        opened = _within_process(clock) if graph is None else graph(clock)
        transport = await stack.enter_async_context(opened)

        async def enter(opening: AbstractAsyncContextManager[N]) -> N:
            node = await stack.enter_async_context(opening)
            node.introspection = introspection
            if on_node is not None:
                on_node(node)
            return node

        home = await enter(open_node("turtlesim", transport=transport))
        beside = None
        if not turtlesim_only:
            beside = await enter(open_node("world", transport=transport))
        sim = Turtlesim(home, world, beside=beside, is_paused=paused)
        await stack.enter_async_context(aclosing(sim))
        if on_start is not None:
            on_start(sim)
        if on_transition is not None:
            home.on_transition(on_transition)
        actions = None
        if not turtlesim_only:
            actions = await enter(open_node("turtle_actions", transport=transport))
            if on_transition is not None:
                actions.on_transition(on_transition)
            serve_built_ins(actions, side=SIDE, journal=journal, on_restart=on_restart)
        name = "_turtleact" if turtlesim_only else "turtleact"  # turtlesim shows one node
        yield await enter(aclosing(WorldNode(name, transport, sim, actions)))


@asynccontextmanager
async def _within_process(clock: Clock) -> AsyncIterator[Transport]:
    yield MemoryTransport(clock)
