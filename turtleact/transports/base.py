"""How messages travel: publish and subscribe, serve and call, between the nodes of one graph.

A transport knows no goal and no message class. It carries what it is given between `Endpoint`
objects that agree in name and type; where bytes must travel, the `Format` that comes with each
endpoint makes them. Its guarantees:

- The messages of one publisher reach each subscription in the order in which they were published.
- `Transport.subscribe` calls ``deliver`` in the event loop of the subscriber; what ``deliver``
  raises is logged and reaches no publisher.
- A transient-local publisher's last messages reach a subscription that comes later, first of all.
- What is closed gets and gives nothing more: the latched messages of a publisher go with it.
- Quality of service never keeps two endpoints apart.
- A call ends: with a reply, or with the reason why there is none.

A service is an object that `Transport.serve` offers. Within its own process `Transport.local` hands
that very object to a client, which uses it as it likes; no request passes through the transport.
All others reach it by the `Caller` that `Transport.join` gives, if it is `AsyncHandler`.

Source: ROS 2 ``rmw``; the QoS policies of the ROS 2 documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias, TypeVar, runtime_checkable

import msgspec

from turtleact.errors import InvalidMessage

if TYPE_CHECKING:
    from turtleact.clock import Clock

__all__ = [
    "EVERY_SERVER",
    "STATUS_QOS",
    "Asked",
    "AsyncHandler",
    "Caller",
    "CallerAware",
    "Closeable",
    "Endpoint",
    "EndpointKind",
    "Format",
    "MakeEndpoint",
    "PendingCall",
    "Publication",
    "QoS",
    "Reply",
    "Source",
    "SyncHandler",
    "Target",
    "TimePolicies",
    "Transport",
    "find_server",
    "wait_until_served",
    "why_not_served",
]

EndpointKind = Literal["publisher", "subscription", "service", "client"]

T = TypeVar("T")


class QoS(msgspec.Struct, frozen=True, kw_only=True):
    """Quality of service of a topic.

    Attributes:
        depth: How many messages are kept for a reader that lags (keep last), at least 1.
        durability: ``"transient_local"`` keeps them for readers that come later too.
        reliability: ``"best_effort"`` allows the transport to lose messages.

    Raises:
        InvalidMessage: if one of them is something else.
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
    """The QoS policies of an endpoint of ROS 2 that count in time.

    turtleact shows those of its peers. It offers none itself and enforces none.

    Attributes:
        deadline: The longest time between two messages (ns); None if there is no limit.
        lifespan: How long a message is valid (ns); None for ever.
        liveliness: Who asserts that a publisher is alive, such as ``"automatic"``.
        lease: How long a publisher counts as alive without that (ns); None for ever.
    """

    deadline: int | None = None
    lifespan: int | None = None
    liveliness: str = "automatic"
    lease: int | None = None


STATUS_QOS = QoS(depth=1, durability="transient_local")
"""That of an action's status topic."""


class Endpoint(msgspec.Struct, frozen=True, gc=False):
    """One end of a topic or service.

    Attributes:
        kind: What it does there.
        name: The fully qualified name of the topic or service.
        type_name: The interface, ``pkg/kind/Name``.
        node: The fully qualified name of its node.
        qos: Quality of service, for topics.
        times: More of it, as a peer of ROS 2 declares it.
        type_hash: The hash of its type, where it is known from a wire.
        gid: The 16 bytes that name it on a wire, where it has such.
        on_demand: Whether other processes are told of it only once one of them has an endpoint of
            this name: for endpoints by the thousand, few of which are ever used.
    """

    kind: EndpointKind
    name: str
    type_name: str
    node: str
    qos: QoS = QoS()
    type_hash: str = ""
    gid: bytes = b""
    on_demand: bool = False
    times: TimePolicies = TimePolicies()


class Format(Protocol):
    """How an endpoint writes what it sends and reads what it receives.

    The server of a service reads requests and writes responses, its client the other way round.
    """

    @property
    def type_hash(self) -> str:
        """The hash of the message or service, ``RIHS01_…``."""

    def encode(self, message: object) -> bytes:
        """What is sent, as bytes; raises `InvalidMessage` for what does not fit."""

    def decode(self, data: bytes) -> object:
        """What was received; raises `InvalidMessage` for bytes that are no such message."""


class MakeEndpoint(Protocol):
    """Makes the description of an endpoint of some node."""

    def __call__(
        self, kind: EndpointKind, name: str, type_name: str, qos: QoS | None = None
    ) -> Endpoint:
        """The description."""


class Closeable(Protocol):
    """Something opened on a transport."""

    def close(self) -> None:
        """Close it; a second time does nothing."""


class Publication(Closeable, Protocol):
    """The sending end of a topic."""

    @property
    def has_readers(self) -> bool:
        """Whether anybody would get a message published now, or may later, as it is latched."""

    @property
    def has_near_readers(self) -> bool:
        """Whether somebody in this very process would get a message, as an object."""

    @property
    def is_congested(self) -> bool:
        """Whether more is on its way than the readers take; who loses nothing, waits then."""

    def publish(self, message: object) -> None:
        """Send a message to every subscription; it must not be changed afterwards."""

    def send(self, data: bytes) -> None:
        """Send a message that is written already, to the readers in other processes alone."""

    def expect_readers(self) -> None:
        """Send from now on, be a reader known here or not: one is there, and news may be late."""

    def refresh(self) -> None:
        """Publish what the source makes now; over a wire once for many calls in a row."""

    async def drained(self) -> None:
        """Wait until it is not congested. Cancelling: safe."""


class Source(Protocol):
    """What publishes only while somebody reads, and tells a late reader how things stand.

    A subclass that says nothing of that has nothing to tell.
    """

    def current(self) -> Sequence[object]:
        """What a late reader of a transient-local topic gets first, made when it comes."""
        return ()

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:  # noqa: ARG002
        """The same as bytes, for readers in other processes."""
        return ()

    def readers_changed(self, *, has_readers: bool) -> None:
        """Called when the first reader has come, and when the last one has gone.

        One may be there before the topic's sending end is, and is told of while that is opened.
        """


class Reply(msgspec.Struct, frozen=True):
    """What a server answers.

    Attributes:
        message: The response.
        note: A short text beside it, which peers of another kind do not see.
    """

    message: object
    note: str = ""


class Target(msgspec.Struct, frozen=True, gc=False):
    """Which servers get a client's requests, if several serve the same service elsewhere.

    Attributes:
        servers: ``"all"``, as in ROS 2, or ``"one"``: the nearest. Of all, the first reply is used.
        counts: Tells from the bytes of a reply whether it counts. One that does not is used only if
            no server sends one that does. May be called in any thread.
    """

    servers: Literal["one", "all"] = "all"
    counts: Callable[[bytes], bool] | None = None


EVERY_SERVER = Target()
"""What ROS 2's clients do."""


class PendingCall(Protocol):
    """A request that is under way: taken at last, or dropped, or it goes on for nobody."""

    @property
    def is_over(self) -> bool:
        """Whether there is a reply, or will be none."""

    def tell(self, told: Callable[[], object]) -> None:
        """Have something called in the event loop, once or more, when it is over."""

    def take(self) -> Reply:
        """The reply, once it is over; raises as `Caller.call`, each time."""

    async def reply(self) -> Reply:
        """Wait for the reply; as `take` then."""

    def drop(self) -> None:
        """Want no reply any more; once it was taken, this does nothing."""


Asked: TypeAlias = PendingCall
"""The former name."""


class Caller(Closeable, Protocol):
    """The asking end of a service."""

    @property
    def is_served(self) -> bool:
        """Whether a call would reach a server now; what changes it is a change of the graph."""

    async def call(self, request: object) -> Reply:
        """Send a request, and wait for the reply.

        Cancelling: safe; a server in the same process is told.

        Raises:
            InvalidMessage: if the request does not fit its type; nothing was sent.
            ServerUnavailable: if nobody serves it, or under another type, or the server went away.
            ServiceError: if the handler failed; what it raised on purpose comes as it is.
            TurtleactError: if the caller is closed.
        """

    def ask(self, request: object) -> PendingCall | None:
        """Send a request to another process now; None if that takes waiting: then see `call`.

        Raises:
            InvalidMessage: if the request does not fit its type; nothing was sent.
        """

    def why_not_served(self, suffix: str = "") -> str:
        """Why a call would reach no server; ``suffix`` is left out of the types that are named."""


@runtime_checkable
class AsyncHandler(Protocol):
    """A handler that answers callers of any process."""

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a request; ``caller`` is the gid of its client."""


@runtime_checkable
class SyncHandler(Protocol):
    """A `AsyncHandler` handler that needs no task for what it can answer at once."""

    def reply_now(self, request: object, caller: bytes) -> Reply | None:
        """Answer a request if that takes no waiting; else None, with nothing done."""


@runtime_checkable
class CallerAware(Protocol):
    """A handler that is told when a caller of its service has gone."""

    def caller_lost(self, caller: bytes) -> None:
        """Note that the client of this gid was closed, or has died."""


class Transport(Protocol):
    """A graph of endpoints.

    Attributes:
        clock: The time of all nodes on it.
        round_trip: How long others took to say who is there (s); 0 if nobody was asked.
        discovery_ends: Until when servers that exist already may not be seen yet (in the event
            loop's time, that of `anyio.current_time`); -inf if all are seen at once.
    """

    clock: Clock
    round_trip: float
    discovery_ends: float

    def advertise(
        self, endpoint: Endpoint, format: Format, source: Source | None = None
    ) -> Publication:
        """Open the sending end of a topic; with a source, nothing is latched but what it makes."""

    def subscribe(
        self, endpoint: Endpoint, format: Format, deliver: Callable[[object], None]
    ) -> Closeable:
        """Open the receiving end of a topic; ``deliver`` gets each message."""

    def serve(self, endpoint: Endpoint, format: Format, handler: object) -> Closeable:
        """Offer ``handler`` as the server of a service, and appear in the graph as such.

        Each request of another process runs in a task of its own, which the transport ends when it
        is closed itself; closing the service lets those under way go on.

        If a node serves a name and type more than once, it is one service to others, so that no
        client gets two replies: the handler that came first answers. It finds the others by
        `all_local`, in case it has to answer for them.
        """

    def join(self, endpoint: Endpoint, format: Format, target: Target = EVERY_SERVER) -> Caller:
        """Appear in the graph as a client of a service, and be able to call it."""

    def local(self, name: str, type_name: str) -> object | None:
        """The handler that serves a service in this very process, if there is one."""

    def all_local(self, name: str, type_name: str) -> tuple[object, ...]:
        """All handlers that serve it in this very process, in the order of their coming."""

    def enter(self, node: str) -> Closeable:
        """Appear in the graph as a node of this fully qualified name."""

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints of the graph, or those of a name, in the order of their opening."""

    def local_endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """Those of them that were opened in this very process."""

    def nodes(self) -> tuple[str, ...]:
        """The names of all nodes, in the order of their coming; a name may be there twice."""

    @property
    def changes(self) -> int:
        """How often a node or endpoint has come or gone: as long as it stands, all is as it was."""

    async def wait_for_change(self) -> None:
        """Wait until a node or endpoint comes or goes. Cancelling: safe."""


async def wait_until_served(
    transport: Transport, find: Callable[[], object | None], timeout: float | None
) -> bool:
    """Wait until ``find`` finds a server. Cancelling: safe.

    Args:
        transport: The graph.
        find: Gives the server, or None.
        timeout: How long to wait (s, by the clock of the graph); None for ever.

    Raises:
        InvalidOption: if ``timeout`` is not a number.
    """
    from turtleact.clock import check_timeout, within  # who only knows names does without

    check_timeout(timeout)
    async with within(timeout, transport.clock):
        while find() is None:
            await transport.wait_for_change()
    return find() is not None


async def find_server(transport: Transport, find: Callable[[], T | None]) -> T | None:
    """What ``find`` finds now, or while the graph is still being discovered.

    A transport that was opened a moment ago may not have seen a server that has been there for
    long. So this waits for a server until `Transport.discovery_ends`; after that it does not wait.

    Cancelling: safe.
    """
    import anyio  # the completion of command lines has no event loop, and starts without it

    found = find()
    if found is None and (rest := transport.discovery_ends - anyio.current_time()) > 0:
        with anyio.move_on_after(rest):
            while (found := find()) is None:
                await transport.wait_for_change()
    return found


def why_not_served(servers: Sequence[Endpoint], wanted: Endpoint, suffix: str = "") -> str:
    """Why a client finds no server.

    Args:
        servers: The endpoints of the service's name, clients among them.
        wanted: The client; its type hash is compared if it has one.
        suffix: What the types end in and users do not say.
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
