"""What exists on a graph, by name and type. The endpoints that make up an action are shown as one.

Source: rclpy ``node.py``, ``get_topic_names_and_types`` and those beside it; ros2cli for what is
hidden.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

if TYPE_CHECKING:
    from turtleact.transports.base import Endpoint, EndpointKind, Transport

__all__ = ["Graph", "graph_of"]

_SEND_GOAL = "/_action/send_goal"


class Graph(msgspec.Struct, frozen=True):
    """What exists, as a node sees it now.

    Attributes:
        nodes: The fully qualified names of the nodes, sorted.
        topics: Topic name to the types used on it; the hidden ones of actions are left out.
        services: Service name to its types; likewise.
        actions: Action name to the types that are served under it.
    """

    nodes: tuple[str, ...]
    topics: dict[str, tuple[str, ...]]
    services: dict[str, tuple[str, ...]]
    actions: dict[str, tuple[str, ...]]


def graph_of(transport: Transport) -> Graph:
    """What exists on the graph of a transport."""
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
