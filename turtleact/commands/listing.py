"""Implements ``list``, ``type``, ``find`` and ``info``, which print what exists, as ``ros2`` does.

The same functions list actions, services and topics; `Kind` says which. A name is hidden if a part
between its slashes begins with an underscore. Hidden names are listed only on request. If you name
a hidden action, service or topic, it is always found.

Source: ros2cli ``ros2{action,node,service,topic}/verb/*.py`` for the order of the output;
recordings of Jazzy for the words.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from turtleact.commands.graph import note_differing
from turtleact.commands.output import note, say_names
from turtleact.errors import TurtleactError, UnknownInterface
from turtleact.interfaces import get_interface, type_hash
from turtleact.interfaces.definition import names_like, nearest
from turtleact.names import action_names, resolve_name
from turtleact.transports.graph import Kind, is_hidden_node, types_by_name

if TYPE_CHECKING:
    from turtleact.node import Node
    from turtleact.transports.base import Endpoint, EndpointKind

__all__ = [
    "print_action_info",
    "print_found",
    "print_list",
    "print_node_info",
    "print_nodes",
    "print_service_info",
    "print_topic_info",
    "print_topics_in_full",
    "print_type",
]

FOUND, NOT_FOUND = 0, 1
"""Exit statuses."""

SIDES: dict[str, EndpointKind] = {"Publish": "publisher", "Subscrib": "subscription"}


# all kinds


async def print_list(node: Node, kind: Kind, *, types: bool, count: bool, hidden: bool) -> int:
    """Print the names of all actions, services or topics, or only how many there are."""
    found = types_by_name(node.transport.endpoints(), kind, hidden=hidden)
    if count:
        say_names(f"{len(found)}\n")
    else:
        _say_lines(_with_types(name, found[name] if types else ()) for name in found)
    return FOUND


async def print_type(node: Node, kind: Kind, name: str) -> int:
    """Print the types of an action, service or topic.

    If the name is not on the graph, print nothing and return the exit status 1.
    """
    types = types_by_name(node.transport.endpoints(), kind, hidden=True).get(name, ())
    _say_lines(types)
    return FOUND if types else NOT_FOUND


async def print_found(node: Node, kind: Kind, type_name: str, *, count: bool, hidden: bool) -> int:
    """Print the names of the actions, services or topics of a type, or only how many there are."""
    found = types_by_name(node.transport.endpoints(), kind, hidden=hidden)
    names = [name for name, types in found.items() if type_name in types]
    _say_lines([str(len(names))] if count else names)
    return FOUND


# actions


async def print_action_info(node: Node, name: str, *, types: bool, count: bool) -> int:
    """Print the nodes that are clients of an action, and the nodes that serve it.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
    """
    full_name = resolve_name(name)
    say_names(f"Action: {name}\n")
    sides: dict[str, EndpointKind] = {"clients": "client", "servers": "service"}
    for side, kind in sides.items():
        nodes = list(_nodes_of_action(node, full_name, kind))
        say_names(f"Action {side}: {len(nodes)}\n")
        if not count:
            _say_lines(f"    {_with_types(who, known if types else ())}" for who, known in nodes)
    served = types_by_name(node.transport.endpoints(), "action", "service", hidden=True)
    if full_name not in served and (near := nearest(full_name, served)):
        note(f"nobody serves '{full_name}', did you mean '{near}'?")
    return FOUND


def _nodes_of_action(
    node: Node, name: str, kind: EndpointKind
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the names of an action's client nodes or server nodes, each with the action's types.

    If several nodes share a name, the name is yielded several times.
    """
    for who in sorted(set(node.transport.nodes())):
        own = _endpoints_of(node, who)
        types = types_by_name(own, "action", kind, hidden=True).get(name, ())
        ends = Counter(each.type_name for each in own if each.kind == kind and _is_of(each, name))
        yield from ((who, types) for _ in range(max(ends.values(), default=0)))


def _is_of(endpoint: Endpoint, action: str) -> bool:
    """Whether an endpoint belongs to the ``send_goal`` service of an action."""
    return endpoint.name == action_names(action).send_goal


# services


async def print_service_info(node: Node, name: str) -> int:
    """Print the type of a service, and how many clients and servers it has.

    Raises:
        TurtleactError: if there is no such service. The error suggests the nearest name.
    """
    endpoints = node.transport.endpoints()
    name = _full(name)
    types = _needed_types(endpoints, "service", name)
    counts = Counter(endpoint.kind for endpoint in endpoints if endpoint.name == name)
    say_names(f"Type: {_as_said(types)}\n")
    say_names(f"Clients count: {counts['client']}\nServices count: {counts['service']}\n")
    return FOUND


# topics


async def print_topics_in_full(node: Node, *, hidden: bool) -> int:
    """Print the topics that have publishers, and then the topics that have subscriptions.

    Each line says how many publishers or subscriptions the topic has.
    """
    endpoints = node.transport.endpoints()
    topics = types_by_name(endpoints, "topic", hidden=hidden)
    for word, kind in SIDES.items():
        counts = Counter(endpoint.name for endpoint in endpoints if endpoint.kind == kind)
        say_names(f"{word}ed topics:\n")
        for name, types in topics.items():
            if number := counts[name]:
                plural = "s" if number > 1 else ""
                say_names(f" * {_with_types(name, types)} {number} {word.lower()}er{plural}\n")
        say_names("\n")
    return FOUND


async def print_topic_info(node: Node, name: str, *, verbose: bool) -> int:
    """Print the type of a topic, and how many publishers and subscriptions it has.

    With ``verbose``, also describe each publisher and subscription in full.

    Raises:
        TurtleactError: if there is no such topic. The error suggests the nearest name.
    """
    endpoints = node.transport.endpoints()
    name = _full(name)
    types = _needed_types(endpoints, "topic", name)
    end = "\n\n" if verbose else "\n"
    say_names(f"Type: {_as_said(types)}{end}")
    for word, kind in {"Publisher": "publisher", "Subscription": "subscription"}.items():
        there = [each for each in endpoints if each.name == name and each.kind == kind]
        say_names(f"{word} count: {len(there)}{end}")
        if verbose:
            _say_lines(f"{_in_full(endpoint)}\n" for endpoint in there)
    return FOUND


def _in_full(endpoint: Endpoint) -> str:
    """Describe an endpoint in full, as ``ros2 topic info -v`` prints it."""
    namespace, _, name = endpoint.node.rpartition("/")
    gid = f"GID: {endpoint.gid.hex('.')}\n" if endpoint.gid else ""
    qos, times = endpoint.qos, endpoint.times
    return (
        f"Node name: {name}\n"
        f"Node namespace: {namespace or '/'}\n"
        f"Topic type: {endpoint.type_name}\n"
        f"Topic type hash: {endpoint.type_hash or _hash_of(endpoint.type_name)}\n"
        f"Endpoint type: {endpoint.kind.upper()}\n"
        f"{gid}"
        "QoS profile:\n"
        f"  Reliability: {qos.reliability.upper()}\n"
        f"  History (Depth): KEEP_LAST ({qos.depth})\n"
        f"  Durability: {qos.durability.upper()}\n"
        f"  Lifespan: {_duration(times.lifespan)}\n"
        f"  Deadline: {_duration(times.deadline)}\n"
        f"  Liveliness: {times.liveliness.upper()}\n"
        f"  Liveliness lease duration: {_duration(times.lease)}"
    )


def _duration(nanoseconds: int | None) -> str:
    """Return a duration as rclpy prints it."""
    return "Infinite" if nanoseconds is None else f"{nanoseconds} nanoseconds"


def _hash_of(type_name: str) -> str:
    try:
        return type_hash(get_interface(type_name))
    except UnknownInterface:
        return "INVALID"


# nodes


async def print_nodes(node: Node, *, count: bool, hidden: bool) -> int:
    """Print the names of all nodes, or their number. If nodes share a name, also print a note."""
    names = sorted(name for name in node.transport.nodes() if hidden or not is_hidden_node(name))
    shared = [name for name, number in Counter(names).items() if number > 1]
    if shared:
        note(f"several nodes have the same name: {', '.join(shared)}")
    _say_lines([str(len(names))] if count else names)
    return FOUND


async def print_node_info(node: Node, name: str, *, hidden: bool) -> int:
    """Print the topics, services and actions of a node, with their types.

    Raises:
        TurtleactError: if there is no such node. The error suggests the nearest name.
    """
    names = [each for each in node.transport.nodes() if hidden or not is_hidden_node(each)]
    name = _full(name)
    if name not in names:
        raise TurtleactError(f"there is no node '{name}'{names_like(name, names)}")
    if names.count(name) > 1:
        note(f"{names.count(name)} nodes have the name '{name}'; this list is for all of them")
    own = _endpoints_of(node, name)
    say_names(f"{name}\n")
    sections: tuple[tuple[str, Kind, EndpointKind], ...] = (
        ("Subscribers", "topic", "subscription"),
        ("Publishers", "topic", "publisher"),
        ("Service Servers", "service", "service"),
        ("Service Clients", "service", "client"),
        ("Action Servers", "action", "service"),
        ("Action Clients", "action", "client"),
    )
    for title, kind, end in sections:
        say_names(f"  {title}:\n")
        found = types_by_name(own, kind, end, hidden=hidden)
        _say_lines([f"    {each}: {', '.join(types)}" for each, types in found.items()] or [""])
    names_here = {each.name for each in own}
    note_differing(node, [e for e in node.transport.endpoints() if e.name in names_here], {})
    return FOUND


# what they share


def _full(name: str) -> str:
    """Return a name with a slash at its beginning."""
    return name if name.startswith("/") else f"/{name}"


def _endpoints_of(node: Node, name: str) -> list[Endpoint]:
    return [endpoint for endpoint in node.transport.endpoints() if endpoint.node == name]


def _needed_types(endpoints: Iterable[Endpoint], kind: Kind, name: str) -> tuple[str, ...]:
    found = types_by_name(endpoints, kind, hidden=True)
    if name not in found:
        visible = [each for each in found if "/_" not in each]
        raise TurtleactError(f"unknown {kind} '{name}'{names_like(name, visible)}")
    return found[name]


def _as_said(types: tuple[str, ...]) -> str:
    """Return types as text: a single type unchanged, several types as a Python list."""
    return types[0] if len(types) == 1 else str(list(types))


def _with_types(name: str, types: Iterable[str]) -> str:
    said = ", ".join(types)
    return f"{name} [{said}]" if said else name


def _say_lines(lines: Iterable[str]) -> None:
    say_names("".join(f"{line}\n" for line in lines))
