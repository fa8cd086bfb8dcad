"""The connection of the process to a ROS graph, for the threads of the program.

Everything that travels is bytes: a publisher encodes in the thread that publishes, and a
subscription decodes in the thread that runs its callback. Endpoints are opened and closed in the
event loop; messages bypass it, except those of latched topics.

A background task asks what exists on the graph, because the answer takes a tenth of a second, and
most nodes do not need it. Functions that need the answer wait for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import wait
from contextlib import AbstractAsyncContextManager
from functools import partial
from typing import Protocol, TypeAlias, cast

import msgspec

from turtleact.errors import TurtleactError
from turtleact.rclpy.impl.event_loop import EventLoop
from turtleact.transports import Transport, ZenohTransport
from turtleact.transports.base import (
    EVERY_SERVER,
    Caller,
    CallObserver,
    Closeable,
    Endpoint,
    Publication,
    Reply,
    Source,
    Target,
)

__all__ = ["CallEvents", "Connection", "OpenTransport", "RequestHandler", "Sender"]

OpenTransport: TypeAlias = Callable[[int], AbstractAsyncContextManager[Transport]]
"""A function that opens the graph of a ROS domain."""

Respond: TypeAlias = Callable[[bytes | TurtleactError, str], object]
"""A function that answers a request with a response, or with an error, and a note.

Any thread may call it.
"""

CLOSING = 2.0
"""How long to wait for a graph to close (s)."""

ENDING = 0.02
"""How long to wait for a closed endpoint's last messages before the graph is closed (s)."""


class Encoded(msgspec.Struct, frozen=True):
    """The format of an endpoint with messages that are bytes already.

    Attributes:
        type_hash: The hash of the interface.
    """

    type_hash: str

    def encode(self, message: object) -> bytes:
        """Return the bytes."""
        return cast("bytes", message)

    def decode(self, data: bytes) -> object:
        """Return the bytes."""
        return data


class Sender:
    """The sending end of a topic, for any thread.

    Args:
        connection: The graph.
        publication: The transport's end of the topic.
        is_latched: Whether late subscriptions get the last messages.
    """

    def __init__(
        self, connection: Connection, publication: Publication, *, is_latched: bool
    ) -> None:
        self._connection = connection
        self._publication = publication
        self._is_latched = is_latched
        self._lock = threading.Lock()

    def publish(self, data: bytes) -> None:
        """Send an encoded message to every subscription, in the order of the calls.

        The messages of a latched topic pass through the event loop, where subscriptions are opened.
        A new subscription therefore gets each message once.
        """
        if self._is_latched:
            self._connection.loop.post(partial(self._publication.publish, data))
            return
        with self._lock:
            self._publication.publish(data)

    @property
    def has_readers(self) -> bool:
        """Whether somebody reads the topic."""
        return self._publication.has_readers

    def expect_readers(self) -> None:
        """Send from now on, because a reader exists, even if it has not been discovered yet."""
        self._connection.loop.call(self._publication.expect_readers)

    def refresh_soon(self, delay: float, begin: Callable[[], object]) -> None:
        """Publish the state of the topic's source after some seconds.

        Args:
            delay: How many seconds to wait.
            begin: Called right before the state is published.
        """

        def refresh() -> None:
            begin()
            self._publication.refresh()

        self._connection.loop.post_later(delay, refresh)

    def close(self) -> None:
        """Leave the topic after all published messages are sent."""
        self._connection.loop.post(self._publication.close)


class CallEvents(CallObserver, Protocol):
    """Watches the calls of a service while `is_on`. Requests and responses are bytes."""

    @property
    def is_on(self) -> bool:
        """Whether the observer wants to hear of calls."""


class RequestHandler:
    """Passes the requests for a service to a function that may answer in any thread, at any time.

    Args:
        take: Called in any thread, with a request and the function that answers it.
        observer: Watches the calls.

    Attributes:
        take: The argument ``take``.
        observer: The argument ``observer``.
        has_far_callers: Whether another process has sent a request.
        is_threaded: Always True: transports may call the handler outside the event loop.
    """

    is_threaded = True

    def __init__(
        self, take: Callable[[bytes, Respond], None], observer: CallEvents | None = None
    ) -> None:
        self.take = take
        self.observer = observer
        self.has_far_callers = False

    def reply_nowait(
        self,
        request: object,
        caller: bytes,  # noqa: ARG002  # a request outlives its client
        respond: Callable[[Reply | TurtleactError], object],
    ) -> bool:
        """Take a request from another process."""
        self.has_far_callers = True

        def answer(response: bytes | TurtleactError, note: str) -> None:
            respond(Reply(response, note) if isinstance(response, bytes) else response)

        self.take(cast("bytes", request), answer)
        return True

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a request in the event loop. Transports prefer `reply_nowait`."""
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Reply | TurtleactError] = loop.create_future()

        def settle(reply: Reply | TurtleactError) -> None:
            if not answered.done():  # the caller's task may have been cancelled
                answered.set_result(reply)

        def respond(reply: Reply | TurtleactError) -> None:
            loop.call_soon_threadsafe(settle, reply)

        self.reply_nowait(request, caller, respond)
        reply = await answered
        if isinstance(reply, TurtleactError):
            raise reply
        return reply


class Connection:
    """A graph that this process has joined. It is closed when its last user has left.

    Args:
        loop: The event loop.
        open_transport: Opens the graph.
        domain: The ROS domain.

    Attributes:
        loop: The argument ``loop``.
        domain: The argument ``domain``.
    """

    def __init__(self, loop: EventLoop, open_transport: OpenTransport, domain: int) -> None:
        self.loop = loop
        self.domain = domain
        self._watchers: dict[Callable[[], object], None] = {}
        self._watching: asyncio.Task[None] | None = None
        self._opened = open_transport(domain)
        self._transport = loop.run(self._open)
        self._exploring = loop.start(self._explore)

    async def _open(self) -> Transport:
        return await self._opened.__aenter__()

    async def _explore(self) -> None:
        if isinstance(self._transport, ZenohTransport):
            with contextlib.suppress(TurtleactError):  # it was closed meanwhile
                await self._transport.explore()

    def wait_until_explored(self) -> None:
        """Wait until everything that existed when the graph was joined is known."""
        # The loop itself must not wait for its own task: it sees what is known so far.
        if not self._exploring.done() and not self.loop.is_here:
            wait([self._exploring])

    def once_explored(self, function: Callable[[], object]) -> None:
        """Call a function when `wait_until_explored` need not wait: now, or later in the loop."""
        self._exploring.add_done_callback(lambda _: function())

    async def _close(self) -> None:
        self._exploring.cancel()
        if self._watching is not None:
            self._watching.cancel()
        await self._opened.__aexit__(None, None, None)

    def close(self) -> None:
        """Leave the graph. Endpoints that do not close in time are left behind."""
        with contextlib.suppress(TimeoutError):
            self.loop.run(self._close, CLOSING)

    @property
    def changes(self) -> int:
        """How often a node or endpoint has come or gone."""
        return self._transport.changes

    def watch(self, changed: Callable[[], object]) -> None:
        """Call ``changed()`` in the event loop whenever a node or endpoint has come or gone."""
        self.loop.call(partial(self._start_watching, changed))

    def unwatch(self, changed: Callable[[], object]) -> None:
        """Undo `watch`."""
        self.loop.post(partial(self._watchers.pop, changed, None))

    def _start_watching(self, changed: Callable[[], object]) -> None:
        self._watchers[changed] = None
        if self._watching is None:
            self._watching = asyncio.get_running_loop().create_task(self._watch())

    async def _watch(self) -> None:
        while True:
            await self._transport.wait_for_change()
            for changed in tuple(self._watchers):
                changed()

    def enter(self, node: str) -> Closeable:
        """Show a node on the graph."""
        return self._posted(self.loop.call(partial(self._transport.enter, node)))

    def advertise(self, endpoint: Endpoint, type_hash: str, source: Source | None = None) -> Sender:
        """Open the sending end of a topic.

        If a subscription is known, even the first message is sent to it.
        """
        transport = self._transport

        def open_it() -> Publication:
            publication = transport.advertise(endpoint, Encoded(type_hash), source)
            if any(each.kind == "subscription" for each in transport.endpoints(endpoint.name)):
                publication.expect_readers()
            return publication

        is_latched = endpoint.qos.durability == "transient_local"
        return Sender(self, self.loop.call(open_it), is_latched=is_latched)

    def subscribe(
        self, endpoint: Endpoint, type_hash: str, deliver: Callable[[bytes], None]
    ) -> Closeable:
        """Open the receiving end of a topic. ``deliver`` may be called in any thread."""
        opening = partial(
            self._transport.subscribe,
            endpoint,
            Encoded(type_hash),
            cast("Callable[[object], None]", deliver),
            in_any_thread=True,
        )
        return self._posted(self.loop.call(opening))

    def serve(self, endpoint: Endpoint, type_hash: str, handler: RequestHandler) -> Closeable:
        """Offer a service."""
        opening = partial(self._transport.serve, endpoint, Encoded(type_hash), handler)
        return self._posted(self.loop.call(opening))

    def join(self, endpoint: Endpoint, type_hash: str, target: Target = EVERY_SERVER) -> Caller:
        """Open the client end of a service. The object belongs to the event loop."""
        return self.loop.call(partial(self._transport.join, endpoint, Encoded(type_hash), target))

    def local(self, name: str, type_name: str) -> RequestHandler | None:
        """The handler of a service in this process, if there is one."""
        found = self._transport.local(name, type_name)
        return found if isinstance(found, RequestHandler) else None

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints on the graph, or only those with this name."""
        self.wait_until_explored()
        return self.loop.call(partial(self._transport.endpoints, name))

    def count_servers(self, name: str) -> int:
        """Count the servers of a service.

        A node of this process that serves it twice counts twice, although it has one endpoint.
        """
        self.wait_until_explored()
        return self.loop.call(partial(self._count_servers, name))

    def _count_servers(self, name: str) -> int:
        ends = [each for each in self._transport.endpoints(name) if each.kind == "service"]
        near = [each for each in self._transport.local_endpoints(name) if each.kind == "service"]
        types = {each.type_name for each in near}
        here = sum(len(self._transport.all_local(name, type_name)) for type_name in types)
        return here + len(ends) - len(near)

    def nodes(self) -> tuple[str, ...]:
        """The names of all nodes."""
        self.wait_until_explored()
        return self.loop.call(self._transport.nodes)

    def _posted(self, opened: Closeable) -> Closeable:
        return _Posted(self.loop, opened)


class _Posted:
    """Wraps an object of the event loop, so that any thread may close the object."""

    def __init__(self, loop: EventLoop, opened: Closeable) -> None:
        self._loop = loop
        self._opened = opened

    def close(self) -> None:
        self._loop.post(self._opened.close)
