"""Gives a node's view of the graph: names, types and numbers of endpoints."""

from __future__ import annotations

from turtleact.rclpy.exceptions import NameValidationException
from turtleact.rclpy.impl.connection import Connection
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.impl.waiting import wait_until
from turtleact.transports.base import Endpoint, EndpointKind
from turtleact.transports.graph import SEND_GOAL, types_by_name

__all__ = [
    "NodeGraph",
    "NodeNameNonExistentError",
    "endpoints_of",
    "get_action_client_names_and_types_by_node",
    "get_action_names_and_types",
    "get_action_server_names_and_types_by_node",
]

TOPIC_ENDS: tuple[EndpointKind, ...] = ("publisher", "subscription")


class NodeNameNonExistentError(RuntimeError):
    """There is no node of that name."""


class NodeGraph:
    """The methods of a node that look at the graph."""

    def get_node_names(self) -> list[str]:
        """Return the names of all nodes, without their namespaces."""
        return [name for name, _ in _names(self)]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """Return the names and namespaces of all nodes."""
        return _names(self)

    def get_node_names_and_namespaces_with_enclaves(self) -> list[tuple[str, str, str]]:
        """Return the names, namespaces and enclaves of all nodes."""
        return [(name, namespace, "/") for name, namespace in _names(self)]

    def get_fully_qualified_node_names(self) -> list[str]:
        """Return the full names of all nodes."""
        return [f"{namespace.rstrip('/')}/{name}" for name, namespace in _names(self)]

    def get_topic_names_and_types(
        self,
        no_demangle: bool = False,  # noqa: ARG002  # rclpy's signature
    ) -> list[tuple[str, list[str]]]:
        """Return the names of all topics, each with its types."""
        return _listed(self, "topic", *TOPIC_ENDS)

    def get_service_names_and_types(self) -> list[tuple[str, list[str]]]:
        """Return the names of all services, each with its types."""
        return _listed(self, "service", "service")

    def get_publisher_names_and_types_by_node(
        self,
        node_name: str,
        node_namespace: str,
        no_demangle: bool = False,  # noqa: ARG002  # rclpy's signature
    ) -> list[tuple[str, list[str]]]:
        """Return the topics that a node publishes, each with its types.

        Raises:
            NodeNameNonExistentError: if there is no such node.
        """
        return _of_node(self, node_name, node_namespace, "publisher")

    def get_subscriber_names_and_types_by_node(
        self,
        node_name: str,
        node_namespace: str,
        no_demangle: bool = False,  # noqa: ARG002  # rclpy's signature
    ) -> list[tuple[str, list[str]]]:
        """Return the topics that a node subscribes to, each with its types.

        Raises:
            NodeNameNonExistentError: if there is no such node.
        """
        return _of_node(self, node_name, node_namespace, "subscription")

    def get_service_names_and_types_by_node(
        self, node_name: str, node_namespace: str
    ) -> list[tuple[str, list[str]]]:
        """Return the services that a node offers, each with its types.

        Raises:
            NodeNameNonExistentError: if there is no such node.
        """
        return _of_node(self, node_name, node_namespace, "service")

    def get_client_names_and_types_by_node(
        self, node_name: str, node_namespace: str
    ) -> list[tuple[str, list[str]]]:
        """Return the services that a node has clients for, each with its types.

        Raises:
            NodeNameNonExistentError: if there is no such node.
        """
        return _of_node(self, node_name, node_namespace, "client")

    def count_publishers(self, topic_name: str) -> int:
        """Return how many publishers a topic has."""
        return _count(self, _topic(self, topic_name), "publisher")

    def count_subscribers(self, topic_name: str) -> int:
        """Return how many subscriptions a topic has."""
        return _count(self, _topic(self, topic_name), "subscription")

    def count_clients(self, service_name: str) -> int:
        """Return how many clients a service has."""
        return _count(self, _service(self, service_name), "client")

    def count_services(self: Anything, service_name: str) -> int:
        """Return how many servers a service has."""
        connection: Connection = self.connection
        return connection.count_servers(_service(self, service_name))

    def get_publishers_info_by_topic(
        self,
        topic_name: str,
        no_mangle: bool = False,  # rclpy's signature
    ) -> list[Anything]:
        """Return a `TopicEndpointInfo` for each publisher of a topic."""
        name = topic_name if no_mangle else _topic(self, topic_name)
        return _infos(self, name, "publisher")

    def get_subscriptions_info_by_topic(
        self,
        topic_name: str,
        no_mangle: bool = False,  # rclpy's signature
    ) -> list[Anything]:
        """Return a `TopicEndpointInfo` for each subscription of a topic."""
        name = topic_name if no_mangle else _topic(self, topic_name)
        return _infos(self, name, "subscription")

    def wait_for_node(self: Anything, fully_qualified_node_name: str, timeout: float) -> bool:
        """Wait until there is a node of that name; return whether there is one."""
        wanted = f"/{fully_qualified_node_name.lstrip('/')}"
        return wait_until(lambda: wanted in self.connection.nodes(), timeout, lambda: True)


def _topic(node: Anything, name: str) -> str:
    try:
        return str(node.resolve_topic_name(name))
    except NameValidationException as error:
        raise ValueError(f"topic name is invalid: {error}") from error


def _service(node: Anything, name: str) -> str:
    try:
        return str(node.resolve_service_name(name))
    except NameValidationException as error:
        raise ValueError(f"service name is invalid: {error}") from error


def _names(node: Anything) -> list[tuple[str, str]]:
    found = (name.rpartition("/") for name in node.connection.nodes())
    return [(name, above or "/") for above, _, name in found]


def _listed(node: Anything, kind: Anything, *kinds: EndpointKind) -> list[tuple[str, list[str]]]:
    found = types_by_name(node.connection.endpoints(), kind, *kinds, hidden=True)
    return [(name, list(types)) for name, types in found.items()]


def _of_node(
    node: Anything, name: str, namespace: str, kind: EndpointKind
) -> list[tuple[str, list[str]]]:
    ends = endpoints_of(node.connection, name, namespace)
    noun: Anything = "topic" if kind in TOPIC_ENDS else "service"
    return [
        (each, list(types)) for each, types in types_by_name(ends, noun, kind, hidden=True).items()
    ]


def endpoints_of(connection: Connection, name: str, namespace: str) -> list[Endpoint]:
    """Return the endpoints of a node.

    Raises:
        NodeNameNonExistentError: if there is no such node.
    """
    full = f"{namespace.rstrip('/')}/{name}"
    if full not in connection.nodes():
        raise NodeNameNonExistentError(f"Cannot get the names of an unknown node: {full}")
    return [each for each in connection.endpoints() if each.node == full]


def _ends(node: Anything, name: str, kind: EndpointKind) -> list[Endpoint]:
    return [each for each in node.connection.endpoints(name) if each.kind == kind]


def _count(node: Anything, name: str, kind: EndpointKind) -> int:
    return len(_ends(node, name, kind))


def _infos(node: Anything, name: str, kind: EndpointKind) -> list[Anything]:
    from turtleact.rclpy.topic_endpoint_info import info_of

    return [info_of(each) for each in _ends(node, name, kind)]


def get_action_client_names_and_types_by_node(
    node: Anything, remote_node_name: str, remote_node_namespace: str
) -> list[tuple[str, list[str]]]:
    """Return the names and types of the actions for which a node has clients.

    Raises:
        RuntimeError: if there is no such node.
    """
    ends = endpoints_of(node.connection, remote_node_name, remote_node_namespace)
    return _actions(ends, "client")


def get_action_server_names_and_types_by_node(
    node: Anything, remote_node_name: str, remote_node_namespace: str
) -> list[tuple[str, list[str]]]:
    """Return the names and types of the actions that a node serves.

    Raises:
        RuntimeError: if there is no such node.
    """
    ends = endpoints_of(node.connection, remote_node_name, remote_node_namespace)
    return _actions(ends, "service")


def get_action_names_and_types(node: Anything) -> list[tuple[str, list[str]]]:
    """Return the names and types of all actions that have a server or a client."""
    return _actions(node.connection.endpoints(), "service", "client")


def _actions(
    ends: tuple[Endpoint, ...] | list[Endpoint], *kinds: EndpointKind
) -> list[tuple[str, list[str]]]:
    served = [each for each in ends if each.name.endswith(SEND_GOAL)]
    found = types_by_name(served, "action", *kinds, hidden=True)
    return [(name, list(types)) for name, types in found.items()]
