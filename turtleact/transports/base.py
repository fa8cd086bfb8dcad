"""The interface of transports, which carry messages between the nodes of one graph.

A transport knows nothing about goals or message classes. It carries messages between `Endpoint`
objects of the same name and type. If messages travel as bytes, the `Format` of an endpoint converts
them. A transport guarantees:

- Each subscription gets the messages of one publisher in the order in which they were published.
- The ``deliver`` function of a subscription is called in the subscription's event loop. With
  ``in_any_thread``, ``deliver`` is called in the thread that publishes or receives the message. An
  exception that ``deliver`` raises is logged and never reaches the publisher.
- A topic is *latched* if its endpoints are transient-local. A new subscription of a latched topic
  first gets the publishers' last messages, even those published before the subscription was opened.
- A closed endpoint neither sends nor receives. The latched messages of a closed publisher are gone.
- Two endpoints of the same name and type communicate even if their QoS policies differ.
- Every call ends, either with a reply or with an error that says why there is none.

An action client in the same process as a server gets the server itself from `Transport.local` and
`ServiceHandler.direct`, so no request passes through the transport. All other clients call a
service through the `Caller` that `Transport.join` returns.

Source: ROS 2 ``rmw``; the QoS policies of the ROS 2 documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias, TypeVar

import msgspec

from turtleact.errors import InvalidMessage

if TYPE_CHECKING:
    from turtleact.tasks import LoopGuard
    from turtleact.tasks.clock import Clock

__all__ = [
    "EVERY_SERVER",
    "STATUS_QOS",
    "AsyncCloseable",
    "CallObserver",
    "Caller",
    "Closeable",
    "Closing",
    "Deliver",
    "Endpoint",
    "EndpointKind",
    "Format",
    "MakeEndpoint",
    "Owner",
    "Publication",
    "QoS",
    "RawFormat",
    "Reply",
    "ServerKind",
    "ServiceHandler",
    "Serving",
    "Source",
    "Target",
    "TimePolicies",
    "Transport",
    "find_server",
    "wait_until_served",
    "why_not_served",
]

EndpointKind = Literal["publisher", "subscription", "service", "client"]

ServerKind = Literal["action server", "service server"]

T = TypeVar("T")

Deliver: TypeAlias = Callable[[object], None]
"""A function that takes each message of a topic."""


class QoS(msgspec.Struct, frozen=True, kw_only=True):
    """Quality of service of a topic.

    Attributes:
        depth: How many of the newest messages are kept for a slow reader, at least 1.
        durability: With ``"transient_local"``, the last messages are also kept for later readers.
        reliability: With ``"best_effort"``, the transport may lose messages.

    Raises:
        InvalidMessage: if the value of an attribute is not allowed.
    """

    depth: int = 10
    durability: Literal["volatile", "transient_local"] = "volatile"
    reliability: Literal["reliable", "best_effort"] = "reliable"

    def __post_init__(self) -> None:
        if not isinstance(self.depth, int) or self.depth < 1:
            raise InvalidMessage("qos.depth", f"expected a whole number from 1, not {self.depth!r}")
        for field, words in _POLICIES.items():
            if (word := getattr(self, field)) not in words:
                raise InvalidMessage(f"qos.{field}", f"expected {' or '.join(words)}, not {word!r}")


_POLICIES = {
    "durability": ("volatile", "transient_local"),
    "reliability": ("reliable", "best_effort"),
}


class TimePolicies(msgspec.Struct, frozen=True, gc=False):
    """The QoS policies of a ROS 2 endpoint that are measured in time.

    turtleact shows these policies of ROS 2 endpoints, but does not enforce them. turtleact's own
    endpoints do not set these policies.

    Attributes:
        deadline: The longest time between two messages (ns); None if there is no limit.
        lifespan: How long a message is valid (ns); None if it is always valid.
        liveliness: How a publisher shows that it is alive, such as ``"automatic"``.
        lease: How long a publisher counts as alive after its last sign of life (ns); None for no
            limit.
    """

    deadline: int | None = None
    lifespan: int | None = None
    liveliness: str = "automatic"
    lease: int | None = None


STATUS_QOS = QoS(depth=1, durability="transient_local")
"""The quality of service of an action's status topic."""


class Endpoint(msgspec.Struct, frozen=True, gc=False):
    """One end of a topic or service.

    Attributes:
        kind: Whether this is a publisher, a subscription, a client or a server (``"service"``).
        name: The fully qualified name of the topic or service.
        type_name: The type name of the topic or service, ``pkg/kind/Name``.
        node: The fully qualified name of the endpoint's node.
        qos: The quality of service, if the endpoint belongs to a topic.
        times: The QoS policies with durations, such as the deadline. turtleact sets none.
        type_hash: The hash of the type; empty if it is not known.
        gid: The 16 bytes that identify the endpoint to other processes; empty if it has none.
        on_demand: Whether the endpoint stays hidden from other processes until one of them has an
            endpoint with the same name. This saves work if a process opens thousands of endpoints
            and uses only a few.
        is_unlisted: Whether `Transport.endpoints` and `Transport.local_endpoints` return the
            endpoint in its own process only if you pass its name.
    """

    kind: EndpointKind
    name: str
    type_name: str
    node: str
    qos: QoS = QoS()
    type_hash: str = ""
    gid: bytes = b""
    on_demand: bool = False
    is_unlisted: bool = False
    times: TimePolicies = TimePolicies()


class Format(Protocol):
    """Converts an endpoint's messages to bytes and back.

    The format of a server decodes requests and encodes responses. The format of a client encodes
    requests and decodes responses.
    """

    @property
    def type_hash(self) -> str:
        """The type hash of the topic or service, ``RIHS01_…``."""

    def encode(self, message: object) -> bytes:
        """Encode a message. Raises `InvalidMessage` if the message does not fit its type."""

    def decode(self, data: bytes) -> object:
        """Decode a message. Raises `InvalidMessage` if the bytes are not a message of the type."""


class RawFormat:
    """A format for messages that stay encoded.

    A subscription with this format gets a message as bytes if the message comes from another
    process or was sent with `Publication.send`. Otherwise, the subscription gets the message
    object.

    Args:
        type_hash: The hash of the type.
        encode: Encodes message objects. None if every message to send is already encoded.
    """

    def __init__(self, type_hash: str, encode: Callable[[object], bytes] | None = None) -> None:
        self.type_hash = type_hash
        self._encode = encode

    def encode(self, message: object) -> bytes:
        """Return a message as bytes. A message that is already encoded is returned unchanged."""
        if isinstance(message, bytes) or self._encode is None:
            return message  # type: ignore[return-value]  # without a class, only bytes come
        return self._encode(message)

    def decode(self, data: bytes) -> object:
        """Return ``data`` unchanged."""
        return data


class MakeEndpoint(Protocol):
    """A function of a node that makes `Endpoint` objects for the node."""

    def __call__(
        self, kind: EndpointKind, name: str, type_name: str, qos: QoS | None = None
    ) -> Endpoint:
        """Return an `Endpoint` of the node."""


class Closeable(Protocol):
    """An open object of a transport, such as a subscription."""

    def close(self) -> None:
        """Close this object. Closing it again does nothing."""


class Closing:
    """A `Closeable` that calls a function.

    Args:
        close: The function. Calling it again must do nothing.
    """

    def __init__(self, close: Callable[[], object]) -> None:
        self._close = close

    def close(self) -> None:
        """Call the function."""
        self._close()


class AsyncCloseable(Protocol):
    """An object whose ``aclose`` must be awaited, because closing may take a while."""

    async def aclose(self) -> None:
        """Close this object. Closing it again does nothing."""


class Serving(AsyncCloseable, Protocol):
    """An action server or a service server."""

    @property
    def is_idle(self) -> bool:
        """Whether the server can be closed without waiting."""


class Owner(Protocol):
    """Owns other objects, as a node does. When the owner is closed, it closes these objects.

    Attributes:
        home: The event loop of the owner and of everything that is opened on the owner.
    """

    home: LoopGuard

    def add(
        self, thing: AsyncCloseable, close: Callable[[], object], kind: ServerKind | None = None
    ) -> Closeable:
        """Track an open object, so that the owner can close it when the owner is closed.

        Args:
            thing: The object that the user has opened, such as a subscription.
            close: Removes ``thing`` from the transport.
            kind: The kind of a server, which is a `Serving`; None for anything else.

        Returns:
            A `Closeable` that ``thing`` must close when ``thing`` is closed. Closing the
            `Closeable` calls ``close``, and the owner stops tracking ``thing``.
        """


class Publication(Closeable, Protocol):
    """The sending end of a topic."""

    @property
    def has_readers(self) -> bool:
        """Whether a message published now has a reader, or may get one later (latched topics)."""

    @property
    def has_object_readers(self) -> bool:
        """Whether a subscription in this process needs, or may later need, message objects."""

    @property
    def is_congested(self) -> bool:
        """Whether you should await `drained`, because too many bytes are waiting to be sent."""

    def publish(self, message: object) -> None:
        """Send a message to every subscription. Do not change the message afterwards."""

    def send(self, data: bytes) -> None:
        """Send an encoded message to other processes, and to subscriptions with a `RawFormat`."""

    def expect_readers(self) -> None:
        """From now on, send messages to other processes even before a reader is known."""

    def refresh(self) -> None:
        """Publish the source's state. The transport may skip a state that is soon replaced."""

    async def drained(self) -> None:
        """Wait until the publication is no longer congested. Cancelling: safe."""


class Source:
    """Makes the messages of a topic from the current state of an object.

    Unless the topic is latched, messages are made only while somebody reads the topic. A subclass
    that makes no messages needs to implement only `readers_changed`.
    """

    def current(self) -> Sequence[object]:
        """Return the messages that a new reader of a latched topic gets first."""
        return ()

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:  # noqa: ARG002
        """Return the messages of `current` as bytes, for readers in other processes."""
        return ()

    def readers_changed(self, *, has_readers: bool) -> None:
        """Called when the topic gets its first reader or loses its last one.

        If the topic already has a reader, this is called while the publisher is being opened.
        """

    def message_lost(self) -> None:
        """Called when a message was dropped because too many messages were waiting to be sent."""


class Reply(msgspec.Struct, frozen=True):
    """A server's reply.

    Attributes:
        message: The response.
        note: A short text sent with the response. Only turtleact reads it.
        stamp: When the response was sent, by its sender's clock (ns since the epoch); 0 if the
            server is in this process.
    """

    message: object
    note: str = ""
    stamp: int = 0


REQUEST_NOTE: ContextVar[str] = ContextVar("REQUEST_NOTE", default="")
"""The text sent with the request that is being handled. Only turtleact sends such texts."""


class Target(msgspec.Struct, frozen=True, gc=False):
    """Selects servers for a client's requests if several processes serve the same service.

    Attributes:
        servers: Which servers get each request: ``"all"``, as in ROS 2, or ``"one"``, the nearest
            server. With ``"all"``, the client uses the first reply.
        counts: A function that is called with the bytes of each reply, in any thread. The client
            uses the first reply for which the function returns True. If the function returns False
            for every reply, the client uses the last reply.
    """

    servers: Literal["one", "all"] = "all"
    counts: Callable[[bytes], bool] | None = None


EVERY_SERVER = Target()
"""Sends each request to every server of the service, as ROS 2's clients do."""


class CallObserver(Protocol):
    """Watches the calls of one service, either at a client or at the server.

    A call is identified by the gid of its client and by its sequence number. The methods must not
    raise. The observer gets a request or response as bytes if it travels between processes, and
    otherwise as an object. To observe a server, set the attribute ``observer`` of its
    `ServiceHandler`.
    """

    def requested(self, request: object, gid: bytes, sequence: int) -> None:
        """Called when a request has been sent or received."""

    def responded(self, response: object, gid: bytes, sequence: int) -> None:
        """Called when a response has been sent or received. Errors do not count as responses."""

    def close(self) -> None:
        """Called when the client or server has been closed."""


class Caller(Closeable, Protocol):
    """The client end of a service.

    Attributes:
        observer: Watches the calls; None (the default) if nobody watches them.
    """

    observer: CallObserver | None

    @property
    def is_served(self) -> bool:
        """Whether a call would reach a server now. This changes only if the graph changes."""

    async def wait_for_route(self) -> None:
        """Wait, at most a few seconds, until a server that is on the graph can be reached.

        A client that was opened a moment ago sees a server before it can reach that server. This
        method returns at once if no server is on the graph. Cancelling: safe.
        """

    async def call(self, request: object, note: str = "") -> Reply:
        """Send a request and wait for the reply.

        Cancelling: safe. A server in the same process learns that the call was cancelled.

        Args:
            request: The request.
            note: A short text for a server in another process; see `REQUEST_NOTE`.

        Raises:
            InvalidMessage: if the request does not fit its type. Nothing was sent.
            ServerUnavailable: if no server of the client's service type exists, or if the server
                goes away during the call.
            ServiceError: if the handler failed. But if a handler in the same process raises a
                `TurtleactError`, the call raises that error. If a handler in another process raises
                `InvalidMessage` or `ServerUnavailable`, the call also raises that error.
            TurtleactError: if this client is closed.
        """

    def why_not_served(self, suffix: str = "") -> str:
        """Explain, with type names cut before ``suffix``, why a call would reach no server."""


class ServiceHandler:
    """Answers the requests of a service, from clients in any process. Subclass it for each service.

    Attributes:
        observer: Watches the calls; None (the default) if nobody watches them. Set it before you
            pass the handler to `Transport.serve`.
        direct: What clients in the same process use instead of sending requests; None (the default)
            if they must send requests.
    """

    observer: CallObserver | None = None
    direct: object | None = None

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a request. ``caller`` is the gid of the client."""
        raise NotImplementedError

    def caller_lost(self, caller: bytes) -> None:
        """Called when the client with this gid was closed or has died."""


class Transport(Protocol):
    """The graph of nodes and endpoints, as seen from one process.

    Attributes:
        clock: The clock of all nodes that use this transport.
        round_trip: How long other processes took to say which nodes and endpoints they have (s); 0
            if they were not asked.
        discovery_ends: The moment until which the transport may not know all existing servers yet
            (event loop time, as in `anyio.current_time`); -inf if it always knows all servers.
    """

    clock: Clock
    round_trip: float
    discovery_ends: float

    def advertise(
        self, endpoint: Endpoint, format: Format, source: Source | None = None
    ) -> Publication:
        """Open the sending end of a topic.

        If you pass a ``source``, a new reader of a latched topic gets the messages that ``source``
        returns. The reader does not get earlier messages passed to `Publication.publish`.
        """

    def subscribe(
        self,
        endpoint: Endpoint,
        format: Format,
        deliver: Callable[[object], None],
        *,
        in_any_thread: bool = False,
        on_gap: Callable[[int], None] | None = None,
    ) -> Closeable:
        """Open the receiving end of a topic. ``deliver`` is called with each message.

        ``on_gap`` is called with the number of messages that a publisher in another process has
        counted and that did not arrive.

        With ``in_any_thread``, the thread that publishes or receives a message calls ``deliver``
        itself, instead of passing the message to the event loop. ``deliver`` must then be quick and
        thread-safe. If all subscriptions of a topic in this process use ``in_any_thread``, you may
        publish to the topic in any thread, but not in two threads at the same time.
        """

    def serve(self, endpoint: Endpoint, format: Format, handler: ServiceHandler) -> Closeable:
        """Offer ``handler`` as the server of a service, and show the server on the graph.

        Each request from another process is handled in its own task. Closing the service lets
        these tasks finish. Closing the transport cancels the tasks of all requests.

        If a node offers several handlers of a service, other processes see only one server, so that
        no client gets two replies. The oldest handler answers. `local` returns every handler.
        """

    def join(self, endpoint: Endpoint, format: Format, target: Target = EVERY_SERVER) -> Caller:
        """Add a service client to the graph, and return the object that calls the service."""

    def local(self, name: str, type_name: str) -> tuple[ServiceHandler, ...]:
        """All handlers that serve a service in this process, in the order they were offered."""

    def enter(self, node: str) -> Closeable:
        """Add a node with this fully qualified name to the graph."""

    def call_when_sought(self, name: str, act: Callable[[], object]) -> Closeable:
        """Call ``act`` once, as soon as another process has an endpoint with this name.

        This costs less than an endpoint with ``on_demand``, because such an endpoint exists in this
        process from the start. A transport that reaches no other process never calls ``act``.

        Returns:
            A `Closeable` that prevents the call, if ``act`` has not been called yet.
        """

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints, this process's first. With a ``name``, only endpoints of that name."""

    def local_endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints opened in this process. With a ``name``, only endpoints of that name."""

    def nodes(self) -> tuple[str, ...]:
        """The names of all nodes, those of this process first. A name may occur twice."""

    @property
    def changes(self) -> int:
        """The number of graph changes. While this number stays the same, the graph is unchanged."""

    async def wait_for_change(self) -> None:
        """Wait until a node or endpoint appears or disappears. Cancelling: safe.

        This method notices only changes after the call. Therefore, look at the graph first, and
        then call this method with no other ``await`` in between. To limit the wait, use a cancel
        scope or `asyncio.timeout`. Do not use `asyncio.wait_for` of Python 3.11, because `wait_for`
        waits in another task and misses changes before that task runs.
        """


async def wait_until_served(
    transport: Transport, find: Callable[[], object | None], timeout: float | None
) -> bool:
    """Wait until ``find`` returns a server; return False after ``timeout``. Cancelling: safe.

    Args:
        transport: The transport on whose graph the server will appear.
        find: A function that returns the server, or None.
        timeout: How long to wait (s, by the graph's clock); None for no limit.

    Raises:
        InvalidOption: if ``timeout`` is not a number.
    """
    from turtleact.tasks.clock import check_timeout, within  # slow to import, and rarely needed

    check_timeout(timeout)
    async with within(timeout, transport.clock):
        while find() is None:
            await transport.wait_for_change()
    return find() is not None


async def find_server(transport: Transport, find: Callable[[], T | None]) -> T | None:
    """Return the server that ``find`` returns; None if there is none. Cancelling: safe.

    A transport that was opened a moment ago may not know all existing servers yet. Until
    `Transport.discovery_ends`, this function therefore waits for the server to appear.
    """
    import anyio  # slow to import, and command-line completion has no event loop

    found = find()
    if found is None and (rest := transport.discovery_ends - anyio.current_time()) > 0:
        with anyio.move_on_after(rest):
            await wait_until_served(transport, find, None)
        return find()
    return found


def why_not_served(servers: Sequence[Endpoint], wanted: Endpoint, suffix: str = "") -> str:
    """Explain why a client finds no server.

    Args:
        servers: All endpoints with the service's name, including clients.
        wanted: The client's endpoint. Its type hash, if known, is compared with each server's hash.
        suffix: A suffix of type names, such as ``_SendGoal``, that the explanation leaves out.
    """
    others = [each for each in servers if each.kind == "service" and each.name == wanted.name]
    hashes = {each.type_hash for each in others if each.type_name == wanted.type_name}
    ours = wanted.type_name.removesuffix(suffix)
    if wanted.type_hash and (differing := hashes - {wanted.type_hash}):
        return (
            f"the definitions of {ours} differ: its type hash is {', '.join(sorted(differing))} "
            f"at the server, {wanted.type_hash} here; both sides need the same one"
        )
    types = {each.type_name.removesuffix(suffix) for each in others} - {ours}
    if not types:
        return "no server answers"
    return f"it is served as {', '.join(sorted(types))}, not as {ours}"
