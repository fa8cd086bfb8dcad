"""Lists the actions that a node serves, the actions for which it has clients, or all actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.rclpy.impl.node_graph import endpoints_of
from turtleact.transports.base import Endpoint, EndpointKind
from turtleact.transports.graph import SEND_GOAL, types_by_name

if TYPE_CHECKING:
    from turtleact.rclpy.node import Node

__all__ = [
    "get_action_client_names_and_types_by_node",
    "get_action_names_and_types",
    "get_action_server_names_and_types_by_node",
]


def get_action_client_names_and_types_by_node(
    node: Node, remote_node_name: str, remote_node_namespace: str
) -> list[tuple[str, list[str]]]:
    """Return the names and types of the actions for which a node has clients.

    Raises:
        RuntimeError: if there is no such node.
    """
    ends = endpoints_of(node.connection, remote_node_name, remote_node_namespace)
    return _listed(ends, "client")


def get_action_server_names_and_types_by_node(
    node: Node, remote_node_name: str, remote_node_namespace: str
) -> list[tuple[str, list[str]]]:
    """Return the names and types of the actions that a node serves.

    Raises:
        RuntimeError: if there is no such node.
    """
    ends = endpoints_of(node.connection, remote_node_name, remote_node_namespace)
    return _listed(ends, "service")


def get_action_names_and_types(node: Node) -> list[tuple[str, list[str]]]:
    """Return the names and types of all actions that have a server or a client."""
    return _listed(node.connection.endpoints(), "service", "client")


def _listed(
    ends: tuple[Endpoint, ...] | list[Endpoint], *kinds: EndpointKind
) -> list[tuple[str, list[str]]]:
    served = [each for each in ends if each.name.endswith(SEND_GOAL)]
    found = types_by_name(served, "action", *kinds, hidden=True)
    return [(name, list(types)) for name, types in found.items()]
