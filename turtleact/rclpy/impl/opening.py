"""Opens the graph that a program joins: the existing graph, or a new one.

A program looks for a router, such as ``turtleact serve``, on its own machine. If there is no
router, the program becomes the router itself. Programs on one machine thus find each other,
whichever of them starts first.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from functools import partial

import anyio

from turtleact.errors import TurtleactError
from turtleact.rclpy.impl.settings import SETTINGS, Place
from turtleact.tasks.clock import Clock
from turtleact.transports import MemoryTransport, Transport, open_zenoh

__all__ = ["open_chosen"]

ATTEMPTS = 20
"""How many times to try to open the graph.

An attempt fails if another program becomes the router at the same time.
"""

PAUSE = 0.05
"""How long to wait between two attempts to open the graph (s)."""

LISTEN = ("tcp/127.0.0.1:7447",)
"""Where the nodes of a machine look for a router."""


@asynccontextmanager
async def open_chosen(domain: int) -> AsyncIterator[Transport]:
    """Open the graph that was chosen for this process.

    An embedded world opens its own connection to the graph, like ``turtleact serve``. Other
    programs and commands can therefore also see the world.

    Raises:
        TurtleactError: if the graph cannot be opened.
    """
    place = SETTINGS.place
    async with AsyncExitStack() as stack:
        if place.is_embedded:
            from turtleact.sim.world_node import open_world

            world = open_world(graph=partial(_open, place, domain))
            await stack.enter_async_context(world)
        yield await stack.enter_async_context(_open(place, domain))


@asynccontextmanager
async def _open(place: Place, domain: int, clock: Clock | None = None) -> AsyncIterator[Transport]:
    if place.is_alone:
        yield MemoryTransport(clock)
        return
    peer = partial(open_zenoh, domain=domain, config=place.config, clock=clock)
    async with AsyncExitStack() as stack:
        if place.connect:
            yield await stack.enter_async_context(peer(place.connect))
        else:
            router = partial(peer, mode="router", listen=LISTEN)
            yield await _first(stack, [peer, router])


async def _first(
    stack: AsyncExitStack,
    opening: Sequence[Callable[[], AbstractAsyncContextManager[Transport]]],
) -> Transport:
    """Try to open several graphs in order, and return the first one that opens.

    If none of them opens, try all of them again, up to `ATTEMPTS` times in total.
    """
    for attempt in range(ATTEMPTS):
        for open_it in opening:
            try:
                return await stack.enter_async_context(open_it())
            except TurtleactError:
                if attempt == ATTEMPTS - 1 and open_it is opening[-1]:
                    raise
        await anyio.sleep(PAUSE)
    raise AssertionError("the last attempt raises")
