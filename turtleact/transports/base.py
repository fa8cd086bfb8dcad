"""How messages travel: publish and subscribe, serve and find, between the nodes of one graph.

A transport knows no goal and no message class. It carries what it is given between `Endpoint`
objects that agree in name and type. Its guarantees:

- The messages of one publisher reach each subscription in the order in which they were published.
- `Transport.subscribe` calls ``deliver`` in the event loop of the subscriber; what ``deliver``
  raises is logged and reaches no publisher.
- A transient-local publisher's last messages reach a subscription that comes later, first of all.
- What is closed gets and gives nothing more.

Services, so far, are those of the same process: `Transport.serve` offers an object, and
`Transport.local` hands that very object to a client, which calls it; no request passes through the
transport. The calls of an action and of a plain service go this one way, each with its own kind of
object. A transport that reaches other processes brings calls of encoded messages besides.

Source: ROS 2 ``rmw``; the QoS policies of the ROS 2 documentation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, Protocol

import msgspec

from turtleact.clock import Clock

__all__ = ["Closeable", "Endpoint", "EndpointKind", "Publication", "QoS", "Transport"]

EndpointKind = Literal["publisher", "subscription", "service", "client"]


class QoS(msgspec.Struct, frozen=True, kw_only=True):
    """Quality of service of a topic.

    Attributes:
        depth: How many messages are kept for a reader that lags (keep last), at least 1.
        durability: ``"transient_local"`` keeps them for readers that come later too.
        reliability: ``"best_effort"`` allows the transport to lose messages.
    """

    depth: int = 10
    durability: Literal["volatile", "transient_local"] = "volatile"
    reliability: Literal["reliable", "best_effort"] = "reliable"


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
        """Whether anybody would get a message published now."""

    def publish(self, message: object) -> None:
        """Send a message to every subscription; it must not be changed afterwards."""


class Transport(Protocol):
    """A graph of endpoints.

    Attributes:
        clock: The time of all nodes on it.
    """

    clock: Clock

    def advertise(self, endpoint: Endpoint) -> Publication:
        """Open the sending end of a topic."""

    def subscribe(self, endpoint: Endpoint, deliver: Callable[[object], None]) -> Closeable:
        """Open the receiving end of a topic; ``deliver`` gets each message."""

    def serve(self, endpoint: Endpoint, handler: object) -> Closeable:
        """Offer ``handler`` as the server of a service, and appear in the graph as such."""

    def join(self, endpoint: Endpoint) -> Closeable:
        """Appear in the graph as a client of a service."""

    def local(self, name: str, type_name: str) -> object | None:
        """The handler that serves a service in this very process, if there is one."""

    def endpoints(self) -> tuple[Endpoint, ...]:
        """All endpoints of the graph, in the order of their opening."""

    async def wait_for_change(self) -> None:
        """Wait until an endpoint is opened or closed."""
