"""Connects the threads of a program to a ROS graph, which an event loop in its own thread serves.

The threads of the program never run the loop, and the loop never runs the program's callbacks. Only
encoded messages pass through a connection: they are encoded in the thread that publishes, and
decoded in the thread that runs the callback. Endpoints are opened and closed in the event loop.
Messages do not pass through the event loop, except those of latched topics.

A background task asks which nodes and endpoints exist on the graph. The task runs in the background
because the answer takes a tenth of a second, and most nodes do not need it. Functions that need the
answer wait for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, wait
from contextlib import AbstractAsyncContextManager
from functools import partial
from typing import TypeAlias, TypeVar, cast

from turtleact.errors import TurtleactError
from turtleact.goals.service_server import Introspection, ServiceEvents
from turtleact.interfaces import get_interface
from turtleact.rclpy.messages import hash_of
from turtleact.rclpy.qos import QoSProfile
from turtleact.transports import Transport, ZenohTransport
from turtleact.transports.base import (
    EVERY_SERVER,
    Caller,
    CallObserver,
    Closeable,
    Endpoint,
    EndpointKind,
    Publication,
    QoS,
    RawFormat,
    Reply,
    ServiceHandler,
    Source,
    Target,
)

__all__ = [
    "CallEnd",
    "Close",
    "Connection",
    "EventLoop",
    "OpenTransport",
    "Respond",
    "Sender",
    "ServiceEnd",
    "SwitchableEvents",
]

T = TypeVar("T")
BeginCoroutine: TypeAlias = "Callable[[], Coroutine[object, object, T]]"

OpenTransport: TypeAlias = Callable[[int], AbstractAsyncContextManager[Transport]]
"""A function that opens the graph of a ROS domain."""

Close: TypeAlias = Callable[[], object]
"""A function that closes an endpoint. Any thread may call the function."""

Respond: TypeAlias = Callable[[Reply | TurtleactError], object]
"""A function that answers a request. Any thread may call it. The reply's message is encoded."""

CLOSING = 2.0
"""How long to wait for a graph to close (s)."""


class EventLoop:
    """An event loop in a daemon thread. The loop starts when it is first used, and never ends."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    @property
    def is_here(self) -> bool:
        """Whether the calling thread is the thread that runs the loop."""
        return threading.current_thread() is self._thread

    def call(self, function: Callable[[], T]) -> T:
        """Call a function in the loop, and wait. Return its result, or raise its exception."""
        if self.is_here:
            return function()
        called: Future[T] = Future()

        def call() -> None:
            try:
                called.set_result(function())
            except BaseException as error:
                called.set_exception(error)

        self.post(call)
        return called.result()

    def post(self, function: Callable[[], object]) -> None:
        """Call a function in the loop, after all functions posted earlier. Return at once."""
        self._running().call_soon_threadsafe(function)

    def post_later(self, delay: float, function: Callable[[], object]) -> None:
        """Call a function in the loop after ``delay`` seconds. Return at once."""
        loop = self._running()
        loop.call_soon_threadsafe(loop.call_later, delay, function)

    def run(self, begin: BeginCoroutine[T], timeout: float | None = None) -> T:
        """Run the coroutine of ``begin()`` in the loop, wait for its end, and return its result.

        Raises:
            TimeoutError: if the coroutine has not ended in time. The coroutine is then cancelled.
        """
        running = self.start(begin)
        try:
            return running.result(timeout)
        except BaseException:
            running.cancel()
            raise

    def start(self, begin: BeginCoroutine[T]) -> Future[T]:
        """Run the coroutine of ``begin()`` in the loop. Return a future of its result at once."""
        loop = self._running()  # first: a KeyboardInterrupt in it would leave a coroutine unused
        return asyncio.run_coroutine_threadsafe(begin(), loop)

    def _running(self) -> asyncio.AbstractEventLoop:
        with self._lock:
            if self._loop is None:
                self._loop = asyncio.new_event_loop()
                self._thread = threading.Thread(
                    target=self._loop.run_forever, name="turtleact-loop", daemon=True
                )
                self._thread.start()
            return self._loop


class Sender:
    """Publishes encoded messages on a topic, from any thread.

    Args:
        connection: The connection to the graph.
        publication: The transport's publisher of the topic.
        is_latched: Whether subscriptions that are opened later get the last messages.
    """

    def __init__(
        self, connection: Connection, publication: Publication, *, is_latched: bool
    ) -> None:
        self._connection = connection
        self._publication = publication
        self._is_latched = is_latched
        self._lock = threading.Lock()

    def publish(self, data: bytes) -> None:
        """Send an encoded message to every subscription. Messages arrive in the order of the calls.

        Messages of a latched topic are sent from the event loop, where subscriptions are also
        opened. A new subscription therefore gets each message exactly once.
        """
        if self._is_latched:
            self._connection.loop.post(partial(self._publication.publish, data))
            return
        with self._lock:
            self._publication.publish(data)

    @property
    def has_readers(self) -> bool:
        """Whether a message published now would reach a subscription."""
        return self._publication.has_readers

    def expect_readers(self) -> None:
        """Send all later messages, even if no subscription has been discovered yet."""
        self._connection.loop.call(self._publication.expect_readers)

    def refresh(self) -> None:
        """Publish the current state of the topic's `Source`. Call this in the event loop."""
        self._publication.refresh()

    def close(self) -> None:
        """Leave the topic after all published messages are sent."""
        self._connection.loop.post(self._publication.close)


class Connection:
    """The connection to a graph that this process has joined.

    The connection is closed when the last context that uses it is shut down.

    Args:
        loop: The event loop.
        open_transport: A function that opens the graph of a ROS domain.
        domain: The ROS domain.

    Attributes:
        loop: The event loop.
        served: The servers of services in this process, by name and type.
    """

    def __init__(self, loop: EventLoop, open_transport: OpenTransport, domain: int) -> None:
        self.loop = loop
        self.served: dict[tuple[str, str], ServiceEnd] = {}
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
        """Wait until all nodes and endpoints that existed when the graph was joined are known."""
        # The loop itself must not wait for its own task: it sees what is known so far.
        if not self._exploring.done() and not self.loop.is_here:
            wait([self._exploring])

    def once_explored(self, function: Callable[[], object]) -> None:
        """Call a function when the exploration of the graph has ended.

        If the exploration has ended already, this method itself calls the function at once.
        Otherwise, the event loop calls the function later.
        """
        self._exploring.add_done_callback(lambda _: function())

    async def _close(self) -> None:
        self._exploring.cancel()
        await self._opened.__aexit__(None, None, None)

    def close(self) -> None:
        """Leave the graph.

        Return after at most `CLOSING` seconds, even if some endpoints are not closed yet.
        """
        with contextlib.suppress(TimeoutError):
            self.loop.run(self._close, CLOSING)

    @property
    def changes(self) -> int:
        """How many times a node or endpoint has come or gone."""
        return self._transport.changes

    def watch(self, changed: Callable[[], object]) -> Close:
        """Call ``changed()`` in the event loop whenever a node or endpoint has come or gone.

        Call the returned function to stop this.
        """

        async def watch() -> None:
            while True:
                changed()
                await self._transport.wait_for_change()

        return self.loop.start(watch).cancel

    def open(self, function: Callable[[Transport], Closeable]) -> Close:
        """Call ``function(transport)`` in the event loop; return what closes the result."""
        opened = self.call(function)
        return partial(self.loop.post, opened.close)

    def call(self, function: Callable[[Transport], T]) -> T:
        """Call ``function(transport)`` in the event loop, and return its result."""
        return self.loop.call(partial(function, self._transport))

    def advertise(self, endpoint: Endpoint, source: Source | None = None) -> Sender:
        """Open a publisher of a topic.

        A subscription that this process has already discovered gets all messages, from the first.
        """

        def open_it(transport: Transport) -> Publication:
            publication = transport.advertise(endpoint, _format(endpoint), source)
            if any(each.kind == "subscription" for each in transport.endpoints(endpoint.name)):
                publication.expect_readers()
            return publication

        is_latched = endpoint.qos.durability == "transient_local"
        return Sender(self, self.call(open_it), is_latched=is_latched)

    def subscribe(self, endpoint: Endpoint, deliver: Callable[[bytes], None]) -> Close:
        """Open a subscription to a topic.

        Any thread may call ``deliver`` with an encoded message.
        """
        take = cast("Callable[[object], None]", deliver)
        format = _format(endpoint)
        return self.open(lambda each: each.subscribe(endpoint, format, take, in_any_thread=True))

    def serve(self, endpoint: Endpoint, handler: ServiceHandler) -> Close:
        """Open a server of a service."""
        return self.open(lambda transport: transport.serve(endpoint, _format(endpoint), handler))

    def join(self, endpoint: Endpoint, target: Target = EVERY_SERVER) -> Caller:
        """Open a client of a service.

        The client's methods must be called in the event loop, except those that allow any thread.
        """
        return self.call(lambda transport: transport.join(endpoint, _format(endpoint), target))

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """Return all endpoints on the graph, or only those of the topic or service ``name``."""
        self.wait_until_explored()
        return self.call(lambda transport: transport.endpoints(name))

    def nodes(self) -> tuple[str, ...]:
        """Return the full names of all nodes on the graph."""
        self.wait_until_explored()
        return self.call(lambda transport: transport.nodes())

    def count(self, name: str, kind: EndpointKind) -> int:
        """Count the endpoints of a kind that a topic or service has."""
        return sum(each.kind == kind for each in self.endpoints(name))


def _format(endpoint: Endpoint) -> RawFormat:
    """Return the format of an endpoint whose messages are encoded by the program's threads."""
    return RawFormat(hash_of(endpoint.type_name))


class SwitchableEvents(CallObserver):
    """Publishes the events of a client or server of a service, while `configure` has it do so.

    Args:
        connection: The connection to the graph.
        service: Describes the client or server on the graph.
    """

    def __init__(self, connection: Connection, service: Endpoint) -> None:
        self._connection = connection
        self._service = service
        self._events: ServiceEvents | None = None

    def configure(self, mode: Introspection, now: Callable[[], int], profile: QoSProfile) -> None:
        """Choose what to publish, the clock for the stamps, and the topic's quality of service."""
        self.close()
        if mode == "off":
            return
        service = self._service

        def describe(
            kind: EndpointKind,
            name: str,
            type_name: str,
            qos: QoS | None = None,  # noqa: ARG001  # the program has chosen another
        ) -> Endpoint:
            node, times = service.node, profile.times()
            return Endpoint(kind, name, type_name, node, profile.for_transport(), times=times)

        def open_it(transport: Transport) -> ServiceEvents:
            find_type = partial(get_interface, service.type_name)
            has_contents = mode == "contents"
            return ServiceEvents(
                transport, describe, service, find_type, now, has_contents=has_contents
            )

        self._connection.wait_until_explored()  # so that a reader gets the first event
        self._events = self._connection.call(open_it)
        self._events.expect_readers()

    def requested(self, request: object, gid: bytes, sequence: int) -> None:
        """Publish that a request was sent or received."""
        events = self._events  # another thread may close it meanwhile
        if events is not None:
            events.requested(request, gid, sequence)

    @property
    def are_on(self) -> bool:
        """Whether events are published."""
        return self._events is not None

    def responded(self, response: object, gid: bytes, sequence: int) -> None:
        """Publish that a response was sent or received."""
        events = self._events
        if events is not None:
            events.responded(response, gid, sequence)

    def close(self) -> None:
        """Publish no more events, and leave the topic."""
        before, self._events = self._events, None
        if before is not None:
            self._connection.loop.post(before.close)


class ServiceEnd(ServiceHandler):
    """Receives the requests for a service, for a function that may answer in any thread.

    Args:
        connection: The connection to the graph.
        endpoint: Describes the server on the graph.
        take: Called in any thread, with a request and the function that answers it.

    Attributes:
        take: The function that takes the requests.
        events: The publisher of the calls' introspection events.
    """

    def __init__(
        self,
        connection: Connection,
        endpoint: Endpoint,
        take: Callable[[bytes, Respond], None],
    ) -> None:
        self.take = take
        self.events = self.observer = SwitchableEvents(connection, endpoint)
        self._leave = connection.serve(endpoint, self)
        self._served, self._key = connection.served, (endpoint.name, endpoint.type_name)
        self._served.setdefault(self._key, self)

    async def reply(self, request: object, caller: bytes) -> Reply:  # noqa: ARG002
        """Pass a request to the function ``take``, and wait for the answer."""
        answered: Future[Reply | TurtleactError] = Future()
        answered.set_running_or_notify_cancel()  # the answer may come after the task was cancelled
        self.take(cast("bytes", request), answered.set_result)
        reply = await asyncio.wrap_future(answered)
        if isinstance(reply, TurtleactError):
            raise reply
        return reply

    def close(self) -> None:
        """Publish no more events, and take no more requests."""
        if self._served.get(self._key) is self:
            del self._served[self._key]
        self.events.close()
        self._leave()


class CallEnd:
    """Sends a client's requests to the servers of a service, and receives the responses.

    Args:
        connection: The connection to the graph.
        endpoint: Describes the client on the graph.
        target: Which servers get the requests.

    Attributes:
        endpoint: Describes the client on the graph.
        events: The publisher of the calls' introspection events.
    """

    def __init__(
        self, connection: Connection, endpoint: Endpoint, target: Target = EVERY_SERVER
    ) -> None:
        self._connection = connection
        self.endpoint = endpoint
        self.events = SwitchableEvents(connection, endpoint)
        self._caller: Caller = connection.join(endpoint, target)
        self._caller.observer = self.events

    @property
    def is_served(self) -> bool:
        """Whether a call would reach a server now."""
        return self._caller.is_served

    def send(self, request: bytes, respond: Respond) -> None:
        """Send a request.

        Args:
            request: The encoded request.
            respond: Called in any thread, with the reply, or with the reason why there is none.
        """
        # Two switches to the event loop's thread and back would more than double the time of a call
        # within the process. Only the transport reports calls to those who publish their events.
        server = self._connection.served.get((self.endpoint.name, self.endpoint.type_name))
        if server is not None and not (self.events.are_on or server.events.are_on):
            server.take(request, respond)
            return

        async def call() -> None:
            try:
                respond(await self._caller.call(request))
            except TurtleactError as error:
                respond(error)

        self._connection.loop.start(call)

    def close(self) -> None:
        """Publish no more events, and leave the graph when all pending calls have ended.

        In rcl, a client publishes a response event only when the client takes the response. A
        destroyed client takes no more responses, so no more response events are published.
        """
        self._connection.loop.post(self._caller.close)
        self.events.close()
