"""Lists what exists on a graph. The endpoints that make up an action appear as one action.

The shell's completion needs this list within milliseconds, so this module imports nothing that is
slow to import.

Source: rclpy ``node.py``, ``get_topic_names_and_types`` and the functions beside it; ros2cli for
the rules of hidden names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from turtleact.transports.base import Endpoint, EndpointKind, Transport

__all__ = [
    "Graph",
    "Kind",
    "Policy",
    "graph_of",
    "is_hidden_node",
    "misfits",
    "types_by_name",
]

Kind = Literal["action", "service", "topic"]

Policy = Literal["durability", "deadline", "liveliness", "lease", "reliability"]
"""The policies that can keep a subscription from receiving a publisher's messages.

`turtleact.transports.base` explains these policies.
"""

SEND_GOAL = "/_action/send_goal"

ENDPOINTS: dict[Kind, tuple[EndpointKind, ...]] = {
    "action": ("service",),
    "service": ("service",),
    "topic": ("publisher", "subscription"),
}
"""For each kind of name, the kinds of endpoints that show that the name exists."""


class Graph(NamedTuple):
    """The nodes, topics, services and actions that a node sees at this moment.

    Attributes:
        nodes: The fully qualified names of the nodes, sorted.
        topics: Topic names and their types; the hidden topics of actions are left out.
        services: Service names and their types; the hidden services of actions are left out.
        actions: Action names and their types.
    """

    nodes: tuple[str, ...]
    topics: dict[str, tuple[str, ...]]
    services: dict[str, tuple[str, ...]]
    actions: dict[str, tuple[str, ...]]


def graph_of(transport: Transport) -> Graph:
    """Return the nodes, topics, services and actions that a transport sees."""
    endpoints = transport.endpoints()
    return Graph(
        nodes=tuple(sorted(set(transport.nodes()))),
        topics=types_by_name(endpoints, "topic"),
        services=types_by_name(endpoints, "service"),
        actions=types_by_name(endpoints, "action"),
    )


def types_by_name(
    endpoints: Iterable[Endpoint],
    kind: Kind,
    *kinds: EndpointKind,
    hidden: bool = False,
) -> dict[str, tuple[str, ...]]:
    """Return the names of all actions, services or topics, sorted, each with its sorted types.

    Args:
        endpoints: The endpoints of the whole graph, or of one node.
        kind: What to list: actions, services or topics.
        *kinds: The kinds of endpoints to look at. If left out, they are the kinds in
            ``ENDPOINTS[kind]``.
        hidden: Whether to include hidden names.
    """
    found: dict[str, set[str]] = {}
    for endpoint in endpoints:
        name, type_name = endpoint.name, endpoint.type_name
        if endpoint.kind not in (kinds or ENDPOINTS[kind]):
            continue
        if kind == "action":
            if not name.endswith(SEND_GOAL):
                continue
            name, type_name = name.removesuffix(SEND_GOAL), type_name.removesuffix("_SendGoal")
        if hidden or "/_" not in name:
            found.setdefault(name, set()).add(type_name)
    return {name: tuple(sorted(types)) for name, types in sorted(found.items())}


def misfits(one: Endpoint, other: Endpoint) -> Iterator[Policy]:
    """Yield the policies in which a publisher offers less than a subscription requests.

    Args:
        one: One of the two endpoints, either the publisher or the subscription.
        other: The other endpoint.

    Source: DDS 1.4, section 2.2.3; the tables of "Quality of Service settings" of ROS 2.
    """
    offered, requested = (one, other) if one.kind == "publisher" else (other, one)
    if (offered.qos.durability, requested.qos.durability) == ("volatile", "transient_local"):
        yield "durability"
    if _is_longer(offered.times.deadline, requested.times.deadline):
        yield "deadline"
    asserted = offered.times.liveliness, requested.times.liveliness
    if asserted == ("automatic", "manual_by_topic"):
        yield "liveliness"
    if _is_longer(offered.times.lease, requested.times.lease):
        yield "lease"
    if (offered.qos.reliability, requested.qos.reliability) == ("best_effort", "reliable"):
        yield "reliability"


def is_hidden_node(name: str) -> bool:
    """Whether a node is hidden: its name without the namespace begins with an underscore.

    >>> is_hidden_node("/_ros2cli"), is_hidden_node("/_lab/turtlesim")
    (True, False)
    """
    return name.rpartition("/")[2].startswith("_")


def _is_longer(offered: int | None, requested: int | None) -> bool:
    """Whether an offered time exceeds the requested one; None is an infinite time."""
    return requested is not None and (offered is None or offered > requested)
