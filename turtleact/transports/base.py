"""The interface of transports, which carry messages between the nodes of one graph.

A transport knows no goal and no message class. It carries messages between `Endpoint` objects of
the same name and type. If messages travel as bytes, the `Format` of an endpoint converts them. A
transport guarantees:

- Each subscription gets the messages of one publisher in the order in which they were published.
- `Transport.subscribe` calls ``deliver`` in the event loop of the subscriber, or, if the subscriber
  asks for it, in the thread that brings the message. An exception that ``deliver`` raises is logged
  and never reaches the publisher.
- A subscription gets the last messages of a transient-local publisher first, even if it was opened
  after they were published.
- A closed endpoint neither sends nor receives. When a publisher closes, its latched messages are
  gone, too.
- A mismatch of quality of service never keeps two endpoints apart.
- A call ends, with a reply or with the reason why there is none.

`Transport.serve` offers any object as a service. In the same process, `Transport.local` hands that
object to a client, which uses it directly; no request passes through the transport. If the object
is an `AsyncHandler`, clients in other processes call it with the `Caller` that `Transport.join`
returns.

Source: ROS 2 ``rmw``; the QoS policies of the ROS 2 documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias, TypeVar, runtime_checkable

import msgspec

from turtleact.errors import InvalidMessage, TurtleactError

if TYPE_CHECKING:
    from turtleact.clock import Clock
    from turtleact.tasks import Home

__all__ = [
    "EVERY_SERVER",
    "STATUS_QOS",
    "AsyncCloseable",
    "AsyncHandler",
    "CallObserver",
    "Caller",
    "CallerAware",
    "Closeable",
    "Deliver",
    "Endpoint",
    "EndpointKind",
    "Format",
    "Lazy",
    "LossAware",
    "MakeEndpoint",
    "Owner",
    "PendingCall",
    "Publication",
    "QoS",
    "RawFormat",
    "Reply",
    "Respond",
    "ServerKind",
    "Serving",
    "Source",
    "SyncHandler",
    "Target",
    "ThreadedHandler",
    "TimePolicies",
    "Transport",
    "find_server",
    "observer_of",
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
        depth: How many messages are kept for a reader that lags (keep last), at least 1.
        durability: ``"transient_local"`` also keeps messages for readers that come later.
        reliability: ``"best_effort"`` allows the transport to lose messages.

    Raises:
        InvalidMessage: if an attribute has another value.
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

    turtleact shows these policies of its peers. Its own endpoints have none, and turtleact enforces
    none.

    Attributes:
        deadline: The longest time between two messages (ns); None if there is no limit.
        lifespan: How long a message is valid (ns); None for ever.
        liveliness: How a publisher shows that it is alive, such as ``"automatic"``.
        lease: How long a publisher counts as alive without showing it (ns); None for ever.
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
        kind: The role of the endpoint.
        name: The fully qualified name of the topic or service.
        type_name: The name of its interface, ``pkg/kind/Name``.
        node: The fully qualified name of its node.
        qos: Quality of service, for topics.
        times: The QoS policies that are measured in time, as a ROS 2 peer declares them.
        type_hash: The hash of its type, if known.
        gid: The 16 bytes that identify the endpoint to other processes, if any.
        on_demand: Whether the endpoint stays hidden from other processes until one of them has an
            endpoint with the same name. This saves work if few of thousands of endpoints are ever
            used.
        is_unlisted: Whether lists of all endpoints leave the endpoint out, even in its own process.
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

    The server of a service reads requests and writes responses. Its client does the opposite.
    """

    @property
    def type_hash(self) -> str:
        """The hash of the message or service, ``RIHS01_…``."""

    def encode(self, message: object) -> bytes:
        """Encode a message. Raises `InvalidMessage` if the message does not fit its type."""

    def decode(self, data: bytes) -> object:
        """Decode a message. Raises `InvalidMessage` if the bytes are not such a message."""


class RawFormat:
    """A format that leaves bytes as they are.

    A subscription with this format gets bytes where a publisher has them, and otherwise objects.

    Args:
        type_hash: The hash of the type.
        encode: Encodes messages that are objects.
    """

    def __init__(self, type_hash: str, encode: Callable[[object], bytes] | None = None) -> None:
        self.type_hash = type_hash
        self._encode = encode

    def encode(self, message: object) -> bytes:
        """Return the bytes of a message."""
        if isinstance(message, bytes) or self._encode is None:
            return message  # type: ignore[return-value]  # without a class, only bytes come
        return self._encode(message)

    def decode(self, data: bytes) -> object:
        """Return the bytes."""
        return data


class MakeEndpoint(Protocol):
    """A function that describes an endpoint of its node."""

    def __call__(
        self, kind: EndpointKind, name: str, type_name: str, qos: QoS | None = None
    ) -> Endpoint:
        """Return the description of an endpoint."""


class Closeable(Protocol):
    """Something opened on a transport."""

    def close(self) -> None:
        """Close this object. A second call does nothing."""


class AsyncCloseable(Protocol):
    """Something open that may take a while to close."""

    async def aclose(self) -> None:
        """Close this object. A second call does nothing."""


class Serving(AsyncCloseable, Protocol):
    """A server."""

    @property
    def is_idle(self) -> bool:
        """Whether closing the server would take no time."""


class Owner(Protocol):
    """Owns everything that is opened on it, as a node does. Closing the owner closes everything.

    Attributes:
        home: The event loop for the owner and for everything that is opened on it.
    """

    home: Home

    def add(self, thing: AsyncCloseable, opened: Closeable) -> Closeable:
        """Track an object until the user or the owner closes it.

        Args:
            thing: The user's object.
            opened: The transport's object, closed together with it.

        Returns:
            An object that closes both. When the user closes ``thing``, ``thing`` must close this
            object.
        """

    def add_server(
        self, kind: ServerKind, server: Serving, close: Callable[[], object]
    ) -> Closeable:
        """Track a server, as `add` does. ``close`` removes the server from the graph."""


class Publication(Closeable, Protocol):
    """The sending end of a topic."""

    @property
    def has_readers(self) -> bool:
        """Whether a message published now has a reader.

        On a latched topic, it may get one later.
        """

    @property
    def has_near_readers(self) -> bool:
        """Whether a subscription in this process would get a message."""

    @property
    def has_object_readers(self) -> bool:
        """Whether a subscription in this process needs objects, not bytes; see `RawFormat`."""

    @property
    def is_congested(self) -> bool:
        """Whether messages are published faster than they are read; see `drained`."""

    @property
    def dropped(self) -> int:
        """How many messages were dropped before they were sent, because too many waited."""

    def publish(self, message: object) -> None:
        """Send a message to every subscription. Do not change the message afterwards."""

    def send(self, data: bytes) -> None:
        """Send an encoded message to subscriptions in other processes, or with a `RawFormat`."""

    def expect_readers(self) -> None:
        """Send from now on. A reader exists, even if it has not been discovered yet."""

    def refresh(self) -> None:
        """Publish the source's current state.

        Other processes get one message for many calls in a row.
        """

    async def drained(self) -> None:
        """Wait until the publication is no longer congested. Cancelling: safe."""


class Source(Protocol):
    """Makes the messages of a topic from the current state, while somebody reads the topic.

    A subclass without a state only implements `readers_changed`.
    """

    def current(self) -> Sequence[object]:
        """The messages that a new reader of a transient-local topic gets first."""
        return ()

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:  # noqa: ARG002
        """Return the messages of `current` as bytes, for readers in other processes."""
        return ()

    def readers_changed(self, *, has_readers: bool) -> None:
        """Called when the first reader has come, and when the last one has left.

        If a reader exists before the publisher, this is called while the publisher is opened.
        """


@runtime_checkable
class LossAware(Protocol):
    """A source that is told when its topic loses messages."""

    def message_lost(self) -> None:
        """Called when a message was dropped because messages are sent too slowly."""


class Reply(msgspec.Struct, frozen=True):
    """A server's reply.

    Attributes:
        message: The response.
        note: A short text sent with the response. Only turtleact reads it.
    """

    message: object
    note: str = ""


REQUEST_NOTE: ContextVar[str] = ContextVar("REQUEST_NOTE", default="")
"""The note that came with the request that is being handled. Only turtleact sends notes."""


class Target(msgspec.Struct, frozen=True, gc=False):
    """Selects servers for a client's requests if several processes serve the same service.

    Attributes:
        servers: ``"all"``, as in ROS 2, or ``"one"``, the nearest server. With ``"all"``, the first
            reply wins.
        counts: Decides by the bytes of a reply whether the reply may win. A reply that may not win
            is used only if no other server sends a better one. This function may be called in any
            thread.
    """

    servers: Literal["one", "all"] = "all"
    counts: Callable[[bytes], bool] | None = None


EVERY_SERVER = Target()
"""The target of ROS 2's clients."""


class PendingCall(Protocol):
    """A request that is under way. In the end, call `take`, `reply` or `drop`."""

    @property
    def is_over(self) -> bool:
        """Whether a reply has arrived or will never arrive."""

    @property
    def stamp(self) -> int | None:
        """When the reply was sent, by the clock of its sender (ns since the epoch), if known."""

    def tell(self, told: Callable[[], object]) -> None:
        """Call ``told`` in the event loop, at least once, when the call is over."""

    def take(self) -> Reply:
        """Return the reply of a call that is over, or raise the error of `Caller.call`."""

    async def reply(self) -> Reply:
        """Wait for the reply, and return it or raise its error like `take`."""

    def drop(self) -> None:
        """Give up the reply. After the reply was taken, this does nothing."""


class CallObserver(Protocol):
    """Watches the calls of one service, at its client or at its server.

    A call is identified by the gid of its client and by its sequence number. The methods must not
    raise. They are called where the call is handled: in the event loop, unless the client or the
    server works in other threads. A handler has its observer in the attribute ``observer``, which
    must be set before the handler is offered. A request or response that travels between processes
    is given as its bytes.
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
        observer: Watches the calls; None, the default, for no observer.
    """

    observer: CallObserver | None

    @property
    def is_served(self) -> bool:
        """Whether a call would reach a server now. This changes only when the graph changes."""

    async def wait_for_route(self) -> None:
        """Wait at most a few seconds until a server that is on the graph can be reached.

        A client that was opened a moment ago sees a server before it can reach that server. If no
        server is on the graph, this returns at once. Cancelling: safe.
        """

    async def call(self, request: object, note: str = "") -> Reply:
        """Send a request and wait for the reply.

        Cancelling: safe. A server in the same process is told of the cancellation.

        Args:
            request: The request.
            note: A short text to send with it, for `REQUEST_NOTE` of a server in another process.

        Raises:
            InvalidMessage: if the request does not fit its type. Nothing was sent.
            ServerUnavailable: if nobody serves the service, if it has another type, or if the
                server went away.
            ServiceError: if the handler failed. If the handler raised a `TurtleactError`, that
                error is raised here instead.
            TurtleactError: if the caller is closed.
        """

    def ask(
        self,
        request: object,
        on_end: Callable[[PendingCall], object] | None = None,
        note: str = "",
    ) -> PendingCall | None:
        """Send a request to another process now. Return None if `call` would have to wait first.

        Args:
            request: The request.
            note: As for `call`.
            on_end: Called once, with the call, when the call is over, either in the thread that
                brings the reply or in the event loop. If you pass it, you may call `ask` in any
                thread, but not in two at the same time.

        Raises:
            InvalidMessage: if the request does not fit its type. Nothing was sent.
        """

    def why_not_served(self, suffix: str = "") -> str:
        """Explain why a call would reach no server. ``suffix`` is cut from the type names shown."""


@runtime_checkable
class AsyncHandler(Protocol):
    """A handler that answers callers of any process, in a task."""

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a request. ``caller`` is the gid of its client."""


Respond: TypeAlias = Callable[[Reply | TurtleactError], object]
"""A function that takes the answer to a request."""


@runtime_checkable
class SyncHandler(Protocol):
    """An `AsyncHandler` that can answer some requests without a task."""

    def reply_nowait(self, request: object, caller: bytes, respond: Respond) -> bool:
        """Answer a request by calling ``respond`` once, now or later, with a reply or an error.

        Returns:
            Whether ``respond`` has been or will be called. If not, nothing has happened, and the
            request must be answered in a task.
        """


@runtime_checkable
class ThreadedHandler(Protocol):
    """A `SyncHandler` that takes other processes' requests in the thread that brings them.

    Its `SyncHandler.reply_nowait` always returns True, must be quick, and may call ``respond`` in
    any thread. That saves a detour through the event loop.

    Attributes:
        is_threaded: True.
    """

    is_threaded: bool


@runtime_checkable
class CallerAware(Protocol):
    """A handler that is told when a caller of its service has gone."""

    def caller_lost(self, caller: bytes) -> None:
        """Called when the client with this gid was closed or has died."""


@runtime_checkable
class Lazy(Protocol):
    """A transport that can open something only when another process looks for it."""

    def open_when_sought(self, name: str, open: Callable[[], Closeable]) -> Closeable:
        """Call ``open`` once another process has an endpoint with this name; at once if one has.

        This is cheaper than an endpoint with ``on_demand``, which is visible in its own process at
        once.

        Returns:
            An object that closes the opened thing, or stops waiting.
        """


class Transport(Protocol):
    """A graph of endpoints.

    Attributes:
        clock: The time of all nodes on the graph.
        round_trip: How long other processes took to answer which nodes and endpoints exist (s); 0
            if none was asked.
        discovery_ends: Before this moment, a server that already exists may not have been seen
            (event loop time, as `anyio.current_time`). It is -inf if all servers are seen at once.
    """

    clock: Clock
    round_trip: float
    discovery_ends: float

    def advertise(
        self, endpoint: Endpoint, format: Format, source: Source | None = None
    ) -> Publication:
        """Open the sending end of a topic.

        With a source, only the source's messages are latched.
        """

    def subscribe(
        self,
        endpoint: Endpoint,
        format: Format,
        deliver: Callable[[object], None],
        *,
        in_any_thread: bool = False,
    ) -> Closeable:
        """Open the receiving end of a topic. ``deliver`` gets each message.

        With ``in_any_thread``, ``deliver`` is called in the thread that brings the message, without
        a detour through the event loop. Such a ``deliver`` must be quick, and safe in any thread.
        If all subscriptions of a topic in this process are of this kind, any thread may publish to
        the topic, but not two at the same time.
        """

    def serve(self, endpoint: Endpoint, format: Format, handler: object) -> Closeable:
        """Offer ``handler`` as the server of a service, and show the service on the graph.

        Each request of another process runs in its own task. Closing the service lets these tasks
        finish; closing the transport cancels them.

        If a node serves the same name and type several times, other processes see one service, so
        that no client gets two replies. The oldest handler answers. If that handler has to answer
        for the others too, it finds them with `all_local`.
        """

    def join(self, endpoint: Endpoint, format: Format, target: Target = EVERY_SERVER) -> Caller:
        """Show a client of a service on the graph, and return the object to call it with."""

    def local(self, name: str, type_name: str) -> object | None:
        """The handler that serves a service in this process, if there is one."""

    def all_local(self, name: str, type_name: str) -> tuple[object, ...]:
        """All handlers that serve a service in this process, in the order they were offered."""

    def enter(self, node: str) -> Closeable:
        """Show a node with this fully qualified name on the graph."""

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints on the graph, or only those called ``name``, in the order of opening."""

    def local_endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints opened in this process, or only those called ``name``."""

    def nodes(self) -> tuple[str, ...]:
        """The names of all nodes, in the order they appeared. A name may occur twice."""

    @property
    def changes(self) -> int:
        """How often a node or endpoint has come or gone. If this is unchanged, so is the graph."""

    async def wait_for_change(self) -> None:
        """Wait until a node or endpoint comes or goes. Cancelling: safe.

        Earlier changes are not remembered, so look at the graph first, in the same task. To limit
        the wait, use a cancel scope or `asyncio.timeout`. `asyncio.wait_for` of Python 3.11 starts
        another task, and would miss a change that comes before that task runs.
        """


def observer_of(handler: object) -> CallObserver | None:
    """Return the observer of a handler's calls, if it has one."""
    observer: CallObserver | None = getattr(handler, "observer", None)
    return observer


async def wait_until_served(
    transport: Transport, find: Callable[[], object | None], timeout: float | None
) -> bool:
    """Wait until ``find`` finds a server. Cancelling: safe.

    Args:
        transport: The graph.
        find: A function that returns the server, or None.
        timeout: How long to wait (s, by the graph's clock); None for no limit.

    Raises:
        InvalidOption: if ``timeout`` is not a number.
    """
    from turtleact.clock import check_timeout, within  # slow to import, and rarely needed

    check_timeout(timeout)
    async with within(timeout, transport.clock):
        while find() is None:
            await transport.wait_for_change()
    return find() is not None


async def find_server(transport: Transport, find: Callable[[], T | None]) -> T | None:
    """Return the server that ``find`` finds. Wait for it while the graph is being discovered.

    A transport that was opened a moment ago may not have seen an older server yet. This function
    therefore waits for it, at most until `Transport.discovery_ends`.

    Cancelling: safe.
    """
    import anyio  # slow to import, and command-line completion has no event loop

    found = find()
    if found is None and (rest := transport.discovery_ends - anyio.current_time()) > 0:
        with anyio.move_on_after(rest):
            while (found := find()) is None:
                await transport.wait_for_change()
    return found


def why_not_served(servers: Sequence[Endpoint], wanted: Endpoint, suffix: str = "") -> str:
    """Explain why a client finds no server.

    Args:
        servers: All endpoints with the service's name, clients included.
        wanted: The client. The client's type hash is compared if it has one.
        suffix: The ending of the type names, which is not shown to users.
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
