"""Reads names and types in the spellings of rosbridge's clients, and looks them up on the graph.

A name may lack its leading slash. A type may be spelled ``pkg/Name``, ``pkg/msg/Name`` or, as in
DDS, ``pkg::msg::dds_::Name_``. At each call, `Directory` looks at the current endpoints of the
graph, including hidden ones.

Source: rosbridge v2; the ROS 2 article "Topic and Service name mapping to DDS"; rosapi
``proxy.py``; rosbridge_library ``publishers.py`` and ``subscribers.py`` for types that a client
leaves out, or that differ from those on the graph.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal, cast

from turtleact.errors import InvalidOption, ServerUnavailable, UnknownInterface
from turtleact.interfaces import Action, Message, Service
from turtleact.interfaces.loading import find_interface
from turtleact.transports import Transport
from turtleact.transports.base import Endpoint, EndpointKind

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = [
    "ALWAYS",
    "SERVICE_KINDS",
    "Directory",
    "Kind",
    "action_class",
    "class_of_action",
    "message_class",
    "service_class",
    "type_name",
]

Kind = Literal["msg", "srv", "action"]
Interface = type[Message] | type[Service] | type[Action]

TOPIC_KINDS: tuple[EndpointKind, ...] = ("publisher", "subscription")
SERVICE_KINDS: tuple[EndpointKind, ...] = ("service",)

ALWAYS = {"/rosout": "rcl_interfaces/msg/Log"}
"""The names and types of topics that every ROS 2 graph has. ROS 2 nodes log to ``/rosout``."""


def type_name(spelled: str, kind: Kind) -> str:
    """Return the full name of a type, without checking whether the type exists.

    >>> type_name("turtlesim/Pose", "msg"), type_name("turtlesim::msg::dds_::Pose_", "msg")
    ('turtlesim/msg/Pose', 'turtlesim/msg/Pose')
    """
    parts = [part for part in spelled.replace("::", "/").split("/") if part != "dds_"]
    if "::" in spelled:
        parts[-1] = parts[-1].removesuffix("_")
    if len(parts) == 2:
        parts.insert(1, kind)
    return "/".join(parts)


def message_class(spelled: str) -> type[Message]:
    """Return the message class with this type name.

    Raises:
        UnknownInterface: if there is no interface with that name.
        InvalidInterface: if the file of the interface is malformed.
    """
    return cast("type[Message]", _class(spelled, "msg", Message))


def service_class(spelled: str) -> type[Service]:
    """Return the service class with this type name. The errors are those of `message_class`."""
    return cast("type[Service]", _class(spelled, "srv", Service))


def action_class(spelled: str) -> type[Action]:
    """Return the action class with this type name. The errors are those of `message_class`."""
    return cast("type[Action]", _class(spelled, "action", Action))


def class_of_action(node: Node, action: str, spelled: str) -> type[Action]:
    """Return the class of an action as its servers define it; without any, as `action_class` does.

    The errors are those of `message_class`.
    """
    found = node.learner.known(action, "action", type_name(spelled, "action"))
    return action_class(spelled) if found is None else cast("type[Action]", found)


class Directory:
    """Looks up names on a graph.

    Args:
        transport: The transport of the graph, which lists the endpoints.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def find(self, kinds: tuple[EndpointKind, ...], name: str = "") -> Iterator[Endpoint]:
        """Yield the endpoints of these kinds; if a name is given, only those with that name."""
        for endpoint in self._transport.endpoints(name):
            if endpoint.kind in kinds:
                yield endpoint

    def types(self, kinds: tuple[EndpointKind, ...], name: str) -> list[str]:
        """Return the types of the endpoints with this name and these kinds, sorted."""
        return sorted({endpoint.type_name for endpoint in self.find(kinds, name)})

    def is_latched(self, topic: str) -> bool:
        """Whether a publisher of the topic keeps messages for later subscriptions."""
        return any(
            endpoint.qos.durability == "transient_local"
            for endpoint in self.find(("publisher",), topic)
        )

    def topic_class(self, topic: str, spelled: str) -> type[Message]:
        """Return the class of a topic's messages.

        Args:
            topic: The topic's absolute name.
            spelled: The type as the client spells it; empty if the client gives no type.

        Raises:
            InvalidOption: if the client gives no type, and the graph does not have exactly one type
                for the topic; or if the client gives a type, and the graph has only other types for
                the topic.
            UnknownInterface: if the type is not known.
        """
        types = self.types(TOPIC_KINDS, topic)
        if spelled:
            wanted = type_name(spelled, "msg")
            # rosbridge refuses that, too (`TypeConflictException`).
            if types and wanted not in types:
                problem = f"topic '{topic}' is one of {', '.join(types)}, not of {wanted}"
                raise InvalidOption("type", problem)
            return message_class(wanted)
        if not types and topic in ALWAYS:
            return message_class(ALWAYS[topic])
        if len(types) != 1:
            known = f"has the types {', '.join(types)}" if types else "is not on the graph"
            raise InvalidOption("type", f"topic '{topic}' {known}: give its type")
        return message_class(types[0])

    def service_class(self, service: str, spelled: str) -> type[Service]:
        """Return the class of a service.

        Args:
            service: The service's absolute name.
            spelled: The type as the client spells it; empty if the client gives no type.

        Raises:
            ServerUnavailable: if the client gives no type and nobody serves the service.
            UnknownInterface: if the type is not known.
        """
        types = [] if spelled else self.types(SERVICE_KINDS, service)
        if not spelled and not types:
            raise ServerUnavailable(service, kind="service")
        return service_class(spelled or types[0])


def _class(spelled: str, kind: Kind, base: type) -> Interface:
    name = type_name(spelled, kind)
    found = find_interface(name)
    if not issubclass(found, base):
        raise UnknownInterface(name)
    return found
