"""The objects that exist once in a process: the event loop, the joined graphs, and the contexts.

A graph is joined when the first node needs it, and left when the last context that uses it is shut
down. The event loop keeps running for the next ``init``.
"""

from __future__ import annotations

import atexit
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, suppress
from functools import partial
from weakref import WeakSet

import anyio

from turtleact.errors import TurtleactError
from turtleact.rclpy.face import SETTINGS, JoinOptions
from turtleact.rclpy.impl.connection import Connection, EventLoop, OpenTransport
from turtleact.rclpy.impl.entity import BusyThreads
from turtleact.rclpy.impl.typing import Anything
from turtleact.tasks.clock import Clock
from turtleact.transports import MemoryTransport, Transport, open_zenoh

__all__ = ["PROCESS", "Process", "open_chosen"]

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
async def _open(
    place: JoinOptions, domain: int, clock: Clock | None = None
) -> AsyncIterator[Transport]:
    if place.is_alone:
        yield MemoryTransport(clock)
        return
    peer = partial(open_zenoh, domain=domain, config=place.config, clock=clock)
    async with AsyncExitStack() as stack:
        if place.connect:
            yield await stack.enter_async_context(peer(place.connect))
        else:
            yield await _join_or_lead(stack, peer)


async def _join_or_lead(
    stack: AsyncExitStack, peer: Callable[..., AbstractAsyncContextManager[Transport]]
) -> Transport:
    """Connect to the router of this machine, or become the router if there is none."""
    router = partial(peer, mode="router", listen=LISTEN)
    for _ in range(ATTEMPTS - 1):
        for opening in (peer, router):
            with suppress(TurtleactError):
                return await stack.enter_async_context(opening())
        await anyio.sleep(PAUSE)
    return await stack.enter_async_context(router())


PATIENCE = 2.5
"""How long to delay the end of the process while other threads shut contexts down (s)."""


class Process:
    """Holds the event loop, the joined graphs and the contexts of this process.

    Attributes:
        loop: The event loop.
        contexts: All contexts that are initialised and not shut down.
        open_transport: A function that opens the graph of a ROS domain.
        ending: The threads that shut contexts down.
    """

    def __init__(self) -> None:
        self.loop = EventLoop()
        self.contexts: WeakSet[Anything] = WeakSet()
        self.open_transport: OpenTransport = open_chosen
        self.ending = BusyThreads()
        self._lock = threading.Lock()
        self._is_registered = False
        self._connections: dict[int, tuple[Connection, set[int]]] = {}

    def join(self, domain: int, user: object) -> Connection:
        """Return the connection to the graph of a domain; open the connection on the first call.

        Raises:
            TurtleactError: if the graph cannot be opened.
        """
        with self._lock:
            if not self._is_registered:
                # Most programs end without a call of `shutdown`.
                self._is_registered = True
                atexit.register(self.shut_down)
            if domain not in self._connections:
                connection = Connection(self.loop, self.open_transport, domain)
                self._connections[domain] = connection, set()
            connection, users = self._connections[domain]
            users.add(id(user))
            return connection

    def shut_down(self) -> None:
        """Shut all contexts down, and wait for those that other threads are shutting down.

        After a signal, a thread shuts the contexts down while the main thread ends the program. If
        the interpreter ended before the process left the graph, a thread of Zenoh could call
        into the interpreter, and the C library would abort the process.
        """
        for context in list(self.contexts):
            context.try_shutdown()
        self.ending.wait_for_others(PATIENCE)

    def leave(self, user: object) -> None:
        """Leave each graph that ``user`` has joined, unless the graph has other users."""
        closing: list[Connection] = []
        with self._lock:
            for domain, (connection, users) in list(self._connections.items()):
                users.discard(id(user))
                if not users:
                    del self._connections[domain]
                    closing.append(connection)
        for connection in closing:
            connection.close()


#: The only one. It is global because rclpy's API is: ``rclpy.init()`` names no process.
PROCESS = Process()
