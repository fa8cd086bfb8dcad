"""How messages travel: publish and subscribe, serve and find, between the nodes of one graph.

A transport knows no goal and no message class. It carries what it is given between `Endpoint`
objects that agree in name and type. Its guarantees:

- The messages of one publisher reach each subscription in the order in which they were published.
- `Transport.subscribe` calls ``deliver`` in the event loop of the subscriber; what ``deliver``
  raises is logged and reaches no publisher.
- A transient-local publisher's last messages reach a subscription that comes later, first of all.
- What is closed gets and gives nothing more: the latched messages of a publisher go with it.
- Quality of service never keeps two endpoints apart.

Services, so far, are those of the same process: `Transport.serve` offers an object, and
`Transport.local` hands that very object to a client, which calls it; no request passes through the
transport. The calls of an action and of a plain service go this one way, each with its own kind of
object. A transport that reaches other processes brings calls of encoded messages besides.

Source: ROS 2 ``rmw``; the QoS policies of the ROS 2 documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, Protocol

import msgspec

from turtleact.clock import Clock, check_timeout, within
from turtleact.errors import InvalidMessage

__all__ = [
    "Closeable",
    "Endpoint",
    "EndpointKind",
    "Publication",
    "QoS",
    "Source",
    "Transport",
    "wait_until_served",
    "why_not_served",
]

EndpointKind = Literal["publisher", "subscription", "service", "client"]


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


class Endpoint(msgspec.Struct, frozen=True):
    """One end of a topic or service.

    Attributes:
        kind: What it does there.
        name: The fully qualified name of the topic or service.
        type_name: The interface, ``pkg/kind/Name``.
        node: The fully qualified name of its node.
        qos: Quality of service, for topics.
    """

    kind: EndpointKind
    name: str
    type_name: str
    node: str
    qos: QoS = QoS()


class Closeable(Protocol):
    """Something opened on a transport."""

    def close(self) -> None:
        """Close it; a second time does nothing."""


class Publication(Closeable, Protocol):
    """The sending end of a topic."""

    @property
    def has_readers(self) -> bool:
        """Whether anybody would get a message published now, or may later, as it is latched."""

    def publish(self, message: object) -> None:
        """Send a message to every subscription; it must not be changed afterwards."""


class Source(Protocol):
    """What publishes only while somebody reads, and tells a late reader how things stand."""

    def current(self) -> Sequence[object]:
        """What a late reader of a transient-local topic gets first, made when it comes."""

    def readers_changed(self, *, has_readers: bool) -> None:
        """Called when the first reader has come, and when the last one has gone."""


class Transport(Protocol):
    """A graph of endpoints.

    Attributes:
        clock: The time of all nodes on it.
    """

    clock: Clock

    def advertise(self, endpoint: Endpoint, source: Source | None = None) -> Publication:
        """Open the sending end of a topic; with a source, nothing is latched but what it makes."""

    def subscribe(self, endpoint: Endpoint, deliver: Callable[[object], None]) -> Closeable:
        """Open the receiving end of a topic; ``deliver`` gets each message."""

    def serve(self, endpoint: Endpoint, handler: object) -> Closeable:
        """Offer ``handler`` as the server of a service, and appear in the graph as such."""

    def join(self, endpoint: Endpoint) -> Closeable:
        """Appear in the graph as a client of a service."""

    def local(self, name: str, type_name: str) -> object | None:
        """The handler that serves a service in this very process, if there is one."""

    def enter(self, node: str) -> Closeable:
        """Appear in the graph as a node of this fully qualified name."""

    def endpoints(self) -> tuple[Endpoint, ...]:
        """All endpoints of the graph, in the order of their opening."""

    def nodes(self) -> tuple[str, ...]:
        """The names of all nodes, in the order of their coming; a name may be there twice."""

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
    check_timeout(timeout)
    async with within(timeout, transport.clock):
        while find() is None:
            await transport.wait_for_change()
    return find() is not None


def why_not_served(transport: Transport, service: str, wanted: str, suffix: str = "") -> str:
    """Why there is no server to be found.

    Args:
        transport: The graph.
        service: The fully qualified name of the service.
        wanted: The type that was looked for.
        suffix: What the types end in and users do not say.
    """
    types = {
        endpoint.type_name.removesuffix(suffix)
        for endpoint in transport.endpoints()
        if endpoint.kind == "service" and endpoint.name == service and endpoint.type_name != wanted
    }
    if not types:
        return "no server answers"
    return f"it is served as {', '.join(sorted(types))}, not as {wanted.removesuffix(suffix)}"
