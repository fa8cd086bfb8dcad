"""A node's view of the graph: names, types, numbers and descriptions of endpoints."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import TypeAlias

import msgspec

from turtleact.rclpy.exceptions import NameValidationException
from turtleact.rclpy.impl.connection import Connection
from turtleact.rclpy.impl.entity import wait_until
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.qos import QoSPresetProfiles, QoSProfile
from turtleact.transports.base import Endpoint, EndpointKind
from turtleact.transports.graph import Kind, types_by_name

__all__ = [
    "NodeGraph",
    "NodeNameNonExistentError",
    "TopicEndpointInfo",
    "TopicEndpointTypeEnum",
    "TypeHash",
    "get_action_client_names_and_types_by_node",
    "get_action_names_and_types",
    "get_action_server_names_and_types_by_node",
    "info_of",
]

Listed: TypeAlias = list[tuple[str, list[str]]]
"""Names, each with its types."""

SIZE = 32
"""How many bytes a type hash has."""


class NodeNameNonExistentError(RuntimeError):
    """There is no node of that name."""


class TypeHash(msgspec.Struct, frozen=True):
    """The hash of an interface type.

    Attributes:
        version: The version of the algorithm; -1 if there is no hash.
        value: The 32 bytes of the hash.
    """

    version: int = -1
    value: bytes = bytes(SIZE)

    @classmethod
    def from_text(cls, text: str) -> TypeHash:
        """Parse a hash such as ``RIHS01_…``. For any other text, return a hash with version -1."""
        version, _, digits = text.removeprefix("RIHS").partition("_")
        try:
            return cls(int(version), bytes.fromhex(digits))
        except ValueError:
            return cls()

    def __str__(self) -> str:
        if self.version <= 0 or len(self.value) != SIZE:
            return "INVALID"
        return f"RIHS{self.version:02}_{self.value.hex()}"


class TopicEndpointTypeEnum(IntEnum):
    """The kinds of endpoints."""

    INVALID = 0
    PUBLISHER = 1
    SUBSCRIPTION = 2


class TopicEndpointInfo(msgspec.Struct, kw_only=True):
    """A description of an endpoint: a publisher or subscription.

    Attributes:
        node_name: The name of the endpoint's node.
        node_namespace: The namespace of the node.
        topic_type: The type of the messages.
        topic_type_hash: The hash of that type.
        endpoint_type: Whether the endpoint is a publisher or a subscription.
        endpoint_gid: The bytes that identify the endpoint.
        qos_profile: The quality of service of the endpoint.
    """

    node_name: str = ""
    node_namespace: str = ""
    topic_type: str = ""
    topic_type_hash: TypeHash = TypeHash()
    endpoint_type: TopicEndpointTypeEnum = TopicEndpointTypeEnum.INVALID
    endpoint_gid: list[int] = []
    qos_profile: QoSProfile = msgspec.field(default_factory=lambda: QoSPresetProfiles.UNKNOWN.value)


class NodeGraph:
    """The methods of a node that look at the graph.

    The argument ``no_demangle`` of some methods has no effect, because turtleact's names are not
    mangled. A method whose name ends in ``by_node`` raises `NodeNameNonExistentError` if there is
    no such node.
    """

    def get_node_names(self) -> list[str]:
        """Return the names of all nodes, without their namespaces."""
        return [name for name, _ in self.get_node_names_and_namespaces()]

    def get_node_names_and_namespaces(self: Anything) -> list[tuple[str, str]]:
        """Return the names and namespaces of all nodes."""
        found = (name.rpartition("/") for name in self.connection.nodes())
        return [(name, above or "/") for above, _, name in found]

    def get_node_names_and_namespaces_with_enclaves(self) -> list[tuple[str, str, str]]:
        """Return the names, namespaces and enclaves of all nodes."""
        return [(*both, "/") for both in self.get_node_names_and_namespaces()]

    def get_fully_qualified_node_names(self: Anything) -> list[str]:
        """Return the full names of all nodes."""
        return list(self.connection.nodes())

    def get_topic_names_and_types(self: Anything, no_demangle: bool = False) -> Listed:  # noqa: ARG002
        """Return the names of all topics, each with its types."""
        return _listed(self.connection.endpoints(), "topic")

    def get_service_names_and_types(self: Anything) -> Listed:
        """Return the names of all services, each with its types."""
        return _listed(self.connection.endpoints(), "service", "service")

    def get_publisher_names_and_types_by_node(
        self,
        node_name: str,
        node_namespace: str,
        no_demangle: bool = False,  # noqa: ARG002
    ) -> Listed:
        """Return the topics that a node publishes, each with its types."""
        return _listed(_ends_of_node(self, node_name, node_namespace), "topic", "publisher")

    def get_subscriber_names_and_types_by_node(
        self,
        node_name: str,
        node_namespace: str,
        no_demangle: bool = False,  # noqa: ARG002
    ) -> Listed:
        """Return the topics that a node subscribes to, each with its types."""
        return _listed(_ends_of_node(self, node_name, node_namespace), "topic", "subscription")

    def get_service_names_and_types_by_node(self, node_name: str, node_namespace: str) -> Listed:
        """Return the services that a node offers, each with its types."""
        return _listed(_ends_of_node(self, node_name, node_namespace), "service", "service")

    def get_client_names_and_types_by_node(self, node_name: str, node_namespace: str) -> Listed:
        """Return the services that a node has clients for, each with its types."""
        return _listed(_ends_of_node(self, node_name, node_namespace), "service", "client")

    def count_publishers(self: Anything, topic_name: str) -> int:
        """Return how many publishers a topic has."""
        return len(_ends(self, _resolved(self.resolve_topic_name, topic_name), "publisher"))

    def count_subscribers(self: Anything, topic_name: str) -> int:
        """Return how many subscriptions a topic has."""
        return len(_ends(self, _resolved(self.resolve_topic_name, topic_name), "subscription"))

    def count_clients(self: Anything, service_name: str) -> int:
        """Return how many clients a service has."""
        return len(_ends(self, _resolved(self.resolve_service_name, service_name), "client"))

    def count_services(self: Anything, service_name: str) -> int:
        """Return how many nodes serve a service."""
        return len(_ends(self, _resolved(self.resolve_service_name, service_name), "service"))

    def get_publishers_info_by_topic(
        self: Anything, topic_name: str, no_mangle: bool = False
    ) -> list[TopicEndpointInfo]:
        """Return a `TopicEndpointInfo` for each publisher of a topic."""
        name = topic_name if no_mangle else _resolved(self.resolve_topic_name, topic_name)
        return [info_of(each) for each in _ends(self, name, "publisher")]

    def get_subscriptions_info_by_topic(
        self: Anything, topic_name: str, no_mangle: bool = False
    ) -> list[TopicEndpointInfo]:
        """Return a `TopicEndpointInfo` for each subscription of a topic."""
        name = topic_name if no_mangle else _resolved(self.resolve_topic_name, topic_name)
        return [info_of(each) for each in _ends(self, name, "subscription")]

    def wait_for_node(self: Anything, fully_qualified_node_name: str, timeout: float) -> bool:
        """Wait until there is a node of that name; return whether there is one."""
        wanted = f"/{fully_qualified_node_name.lstrip('/')}"
        return wait_until(lambda: wanted in self.connection.nodes(), timeout, lambda: True)


def get_action_client_names_and_types_by_node(
    node: Anything, remote_node_name: str, remote_node_namespace: str
) -> Listed:
    """Return the names and types of the actions for which a node has clients.

    Raises:
        RuntimeError: if there is no such node.
    """
    ends = _ends_of_node(node, remote_node_name, remote_node_namespace)
    return _listed(ends, "action", "client")


def get_action_server_names_and_types_by_node(
    node: Anything, remote_node_name: str, remote_node_namespace: str
) -> Listed:
    """Return the names and types of the actions that a node serves.

    Raises:
        RuntimeError: if there is no such node.
    """
    ends = _ends_of_node(node, remote_node_name, remote_node_namespace)
    return _listed(ends, "action", "service")


def get_action_names_and_types(node: Anything) -> Listed:
    """Return the names and types of all actions that have a server or a client."""
    return _listed(node.connection.endpoints(), "action", "service", "client")


def _resolved(resolve: Callable[[str], str], name: str) -> str:
    try:
        return resolve(name)
    except NameValidationException as error:
        raise ValueError(f"the name is invalid: {error}") from error


def _listed(ends: tuple[Endpoint, ...], kind: Kind, *kinds: EndpointKind) -> Listed:
    found = types_by_name(ends, kind, *kinds, hidden=True)
    return [(name, list(types)) for name, types in found.items()]


def _ends_of_node(node: Anything, name: str, namespace: str) -> tuple[Endpoint, ...]:
    connection: Connection = node.connection
    full = f"{namespace.rstrip('/')}/{name}"
    if full not in connection.nodes():
        raise NodeNameNonExistentError(f"Cannot get the names of an unknown node: {full}")
    return tuple(each for each in connection.endpoints() if each.node == full)


def _ends(node: Anything, name: str, kind: EndpointKind) -> list[Endpoint]:
    return [each for each in node.connection.endpoints(name) if each.kind == kind]


def info_of(endpoint: Endpoint) -> TopicEndpointInfo:
    """Return the description of an endpoint on the graph."""
    namespace, _, name = endpoint.node.rpartition("/")
    return TopicEndpointInfo(
        node_name=name,
        node_namespace=namespace or "/",
        topic_type=endpoint.type_name,
        topic_type_hash=TypeHash.from_text(endpoint.type_hash),
        endpoint_type=TopicEndpointTypeEnum[endpoint.kind.upper()],
        endpoint_gid=list(endpoint.gid),
        qos_profile=QoSProfile.from_transport(endpoint.qos, endpoint.times),
    )
