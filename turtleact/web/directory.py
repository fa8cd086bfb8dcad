"""What the graph says of a name: of which types it is, and who has it.

Reads the endpoints as they are now, hidden ones too; keeps nothing.

Source: rosapi ``proxy.py``; rosbridge_library ``publishers.py`` and ``subscribers.py`` for what
becomes of a type that is left out, or is another than the graph's.
"""

from __future__ import annotations

from collections.abc import Iterator

from turtleact.errors import InvalidOption, ServerUnavailable
from turtleact.interfaces import Message, Service
from turtleact.transports import Transport
from turtleact.transports.base import Endpoint, EndpointKind
from turtleact.web.spelling import message_class, service_class, type_name

__all__ = ["ALWAYS", "SERVICE_KINDS", "Directory"]

TOPIC_KINDS: tuple[EndpointKind, ...] = ("publisher", "subscription")
SERVICE_KINDS: tuple[EndpointKind, ...] = ("service",)

ALWAYS = {"/rosout": "rcl_interfaces/msg/Log"}
"""Topics that every graph of ROS 2 has, as its nodes log there, and their types."""


class Directory:
    """The names of a graph.

    Args:
        transport: The graph.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def find(self, kinds: tuple[EndpointKind, ...], name: str = "") -> Iterator[Endpoint]:
        """The endpoints of these kinds, of one name if it is given."""
        for endpoint in self._transport.endpoints():
            if endpoint.kind in kinds and (not name or endpoint.name == name):
                yield endpoint

    def types(self, kinds: tuple[EndpointKind, ...], name: str) -> list[str]:
        """The types that a name has, sorted."""
        return sorted({endpoint.type_name for endpoint in self.find(kinds, name)})

    def is_latched(self, topic: str) -> bool:
        """Whether somebody publishes to a topic for those who come later, too."""
        return any(
            endpoint.qos.durability == "transient_local"
            for endpoint in self.find(("publisher",), topic)
        )

    def topic_class(self, topic: str, spelled: str) -> type[Message]:
        """The class of a topic's messages.

        Args:
            topic: Its absolute name.
            spelled: The type that a client says it has; empty if it says none.

        Raises:
            InvalidOption: if it says none and the graph knows none, or several; if the graph knows
                others only.
            UnknownInterface: if there is no such type.
        """
        types = self.types(TOPIC_KINDS, topic)
        if spelled:
            wanted = type_name(spelled, "msg")
            if types and wanted not in types:
                problem = f"topic '{topic}' is one of {', '.join(types)}, not of {wanted}"
                raise InvalidOption("type", problem)
            return message_class(wanted)
        if not types and topic in ALWAYS:
            return message_class(ALWAYS[topic])
        if len(types) != 1:
            known = f"has the types {', '.join(types)}" if types else "is not on the graph"
            raise InvalidOption("type", f"topic '{topic}' {known}: say its type")
        return message_class(types[0])

    def service_class(self, service: str, spelled: str) -> type[Service]:
        """The class of a service.

        Args:
            service: Its absolute name.
            spelled: The type that a client says it has; empty if it says none.

        Raises:
            ServerUnavailable: if it says none and nobody serves it.
            UnknownInterface: if there is no such type.
        """
        types = [] if spelled else self.types(SERVICE_KINDS, service)
        if not spelled and not types:
            raise ServerUnavailable(service, kind="service")
        return service_class(spelled or types[0])
