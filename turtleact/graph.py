"""What exists on a graph, by name and type. Each action is listed once, not by its endpoints.

Source: rclpy ``node.py`` (``get_topic_names_and_types`` and similar methods); ros2cli for which
names are hidden.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

if TYPE_CHECKING:
    from turtleact.transports.base import Endpoint, EndpointKind, Transport

__all__ = ["Graph", "graph_of"]

_SEND_GOAL = "/_action/send_goal"


class Graph(msgspec.Struct, frozen=True):
    """The nodes, topics, services and actions that a node sees at this moment.

    Attributes:
        nodes: The fully qualified names of the nodes, sorted.
        topics: Topic names and the types used on them; the hidden topics of actions are left out.
        services: Service names and their types; the hidden services of actions are left out.
        actions: Action names and the types served under them.
    """

    nodes: tuple[str, ...]
    topics: dict[str, tuple[str, ...]]
    services: dict[str, tuple[str, ...]]
    actions: dict[str, tuple[str, ...]]


def graph_of(transport: Transport) -> Graph:
    """Return what exists on the graph of a transport."""
    endpoints = transport.endpoints()
    return Graph(
        nodes=tuple(sorted(set(transport.nodes()))),
        topics=_types_by_name(endpoints, ("publisher", "subscription")),
        services=_types_by_name(endpoints, ("service",)),
        actions={
            name.removesuffix(_SEND_GOAL): tuple(t.removesuffix("_SendGoal") for t in types)
            for name, types in _types_by_name(endpoints, ("service",), hidden=True).items()
            if name.endswith(_SEND_GOAL)
        },
    )


def _types_by_name(
    endpoints: tuple[Endpoint, ...], kinds: tuple[EndpointKind, ...], *, hidden: bool = False
) -> dict[str, tuple[str, ...]]:
    found: dict[str, set[str]] = {}
    for endpoint in endpoints:
        if endpoint.kind in kinds and (hidden or "/_" not in endpoint.name):
            found.setdefault(endpoint.name, set()).add(endpoint.type_name)
    return {name: tuple(sorted(types)) for name, types in sorted(found.items())}
