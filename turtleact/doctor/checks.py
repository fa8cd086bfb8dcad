"""What a graph looks like at one moment, and the checks that find its faults. Pure.

`Snapshot` is what one process can see of a graph. Each check finds one kind of fault in it. The
fields of a type are kept in one flat list that includes the fields of nested types, so that two
definitions of a type can be compared.

Source: rmw_zenoh_cpp ``liveliness_utils.cpp`` for what nodes write into their liveliness tokens;
type_description_interfaces/msg/TypeDescription and FieldType.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import product
from typing import Final

import msgspec

from turtleact.interfaces.type_hash import members
from turtleact.interfaces.types import Interface
from turtleact.names import EVENT_SUFFIX
from turtleact.transports.base import Endpoint
from turtleact.transports.graph import SEND_GOAL, Policy, is_hidden_node, misfits

__all__ = [
    "CLOCKS_APART",
    "HASHED",
    "Answer",
    "EndpointSeen",
    "Fault",
    "Fields",
    "NodeSeen",
    "Report",
    "Router",
    "Snapshot",
    "differing_definitions",
    "fields_of",
    "find_faults",
]

CLOCKS_APART: Final = 0.1
"""If two clocks differ by more than this (s), the difference is a fault."""

HASHED: Final = re.compile(r"RIHS[0-9]+_[0-9a-f]+")
"""Matches a type hash. ROS 2 Humble sends a placeholder instead, because it has no type hashes."""

LACKS: Final[dict[Policy, str]] = {
    "durability": "more durability (transient_local, not volatile)",
    "deadline": "a shorter deadline",
    "liveliness": "more liveliness (manual_by_topic, not automatic)",
    "lease": "a shorter lease duration",
    "reliability": "more reliability (reliable, not best_effort)",
}
"""For each QoS policy, describes a request of a subscription that exceeds a publisher's offer."""

MOST_FIELDS: Final = 4
"""At most this many differing fields are named."""

Fields = Mapping[str, str]
"""The fields of a type by path, such as ``targets[].x``, and the type of each."""

#: Of a service, the events repeat what its request and response are.
PARTS: Final = {"request_message": "request", "response_message": "response"}

EVENTS: Final = "event_message"


class NodeSeen(msgspec.Struct, frozen=True):
    """A node on the graph.

    Attributes:
        name: The fully qualified name of the node.
        session: The id of the node's Zenoh session. A process usually has one session.
    """

    name: str
    session: str = ""


class EndpointSeen(msgspec.Struct, frozen=True):
    """An endpoint on the graph, and the session that it belongs to.

    Attributes:
        endpoint: The endpoint.
        session: The id of the Zenoh session.
    """

    endpoint: Endpoint
    session: str = ""


class Answer(msgspec.Struct, frozen=True):
    """Whether the process of a session answered a call, and how far its clock is off.

    Attributes:
        session: The id of the session.
        node: The node whose service was called.
        is_answered: Whether the process answered in time.
        offset: How far the clock of the process is ahead of the clock here (s); None if unknown.
        uncertainty: The maximum error of ``offset`` (s).
    """

    session: str
    node: str
    is_answered: bool = True
    offset: float | None = None
    uncertainty: float = 0.0


class Report(msgspec.Struct, frozen=True):
    """A fault that a process has found in itself; see `turtleact.goals.fault_reports`.

    Attributes:
        name: The kind of fault and its subject, separated by a space, as in "disk /data/goals.db".
        problem: What is wrong.
        advice: What to do about it.
    """

    name: str
    problem: str
    advice: str = ""


class Router(msgspec.Struct, frozen=True):
    """A router in reach.

    Attributes:
        zid: The Zenoh id of the router.
        version: The router's version of Zenoh, such as "1.10.2"; empty if the router does not send
            it.
        sessions: How many sessions are connected to the router; None if the router does not send
            it.
    """

    zid: str
    version: str = ""
    sessions: int | None = None


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """What a graph looks like at one moment.

    Attributes:
        domain: The ROS domain of the graph; None for a graph within one process.
        routers: The routers in reach; None for a graph within one process, which needs no router.
        zenoh: The version of Zenoh in this process; empty if unknown.
        nodes: All nodes on the graph. Several nodes may share a name.
        endpoints: All endpoints on the graph.
        answers: The answer of each session that was asked.
        reports: The faults that processes have found in themselves.
        known: The type hash that this process has for each type on the graph, by type name. Types
            that this process does not know are left out.
        fields: The fields of types that have several definitions, by type name and type hash.
        domains: The ROS domains in which other sessions have nodes; empty if nobody asked for the
            domains.
    """

    domain: int | None = None
    routers: tuple[Router, ...] | None = None
    zenoh: str = ""
    nodes: tuple[NodeSeen, ...] = ()
    endpoints: tuple[EndpointSeen, ...] = ()
    answers: tuple[Answer, ...] = ()
    reports: tuple[Report, ...] = ()
    known: Mapping[str, str] = {}
    fields: Mapping[tuple[str, str], Fields] = {}
    domains: tuple[int, ...] = ()


class Fault(msgspec.Struct, frozen=True):
    """Something that is wrong with a graph.

    Attributes:
        kind: The kind of fault, such as "duplicate-node".
        names: The names that the fault is about: nodes, topics, services, actions or types.
        problem: What is wrong.
        advice: What to do about it.
    """

    kind: str
    names: tuple[str, ...]
    problem: str
    advice: str

    def __str__(self) -> str:
        """The problem and the advice in one line."""
        return f"{self.kind}: {self.problem}{f'; {self.advice}' if self.advice else ''}"


def find_faults(snapshot: Snapshot) -> list[Fault]:
    """Return all faults, in the order of `CHECKS`."""
    return [fault for check in CHECKS for fault in check(snapshot)]


# the session and its router


def missing_router(snapshot: Snapshot) -> Iterator[Fault]:
    """Report a fault if a router is needed, but none is in reach."""
    if snapshot.routers == ():
        yield Fault(
            "no-router",
            (),
            "no router is in reach, so nodes that start later are not found",
            "start one with 'turtleact serve' or with rmw_zenohd",
        )


def empty_domain(snapshot: Snapshot) -> Iterator[Fault]:
    """Report a fault if the domain has no nodes although other domains have some."""
    others = [domain for domain in snapshot.domains if domain != snapshot.domain]
    if others and not snapshot.nodes:
        used = ", ".join(map(str, others))
        yield Fault(
            "domain",
            (),
            f"no node is in domain {snapshot.domain}, but there are some in {used}",
            f"set ROS_DOMAIN_ID={others[0]}, or give --domain {others[0]}",
        )


def unfitting_versions(snapshot: Snapshot) -> Iterator[Fault]:
    """Find routers and nodes whose version is incompatible with this program.

    A router is incompatible if its major version of Zenoh differs from this program's. A node is
    incompatible if it sends no type hashes.
    """
    for router in snapshot.routers or ():
        theirs, ours = _major(router.version), _major(snapshot.zenoh)
        if theirs and ours and theirs != ours:
            yield Fault(
                "version",
                (router.zid,),
                f"router {router.zid} has Zenoh {router.version}, this program {snapshot.zenoh}",
                "use the same major version on both sides",
            )
    found = {
        each.endpoint.node
        for each in _listed(snapshot.endpoints)
        if each.endpoint.type_hash and not HASHED.fullmatch(each.endpoint.type_hash)
    }
    for node in sorted(found):
        yield Fault(
            "version",
            (node,),
            f"node {node} sends no type hashes, as in ROS 2 Humble, so only nodes of that release "
            "can talk to it",
            "run it with ROS 2 Jazzy or later",
        )


def clocks_apart(snapshot: Snapshot) -> Iterator[Fault]:
    """Find processes whose clock differs by more than `CLOCKS_APART` from the clock here."""
    for answer in snapshot.answers:
        offset = answer.offset
        if offset is not None and abs(offset) - answer.uncertainty > CLOCKS_APART:
            where = "ahead of" if offset > 0 else "behind"
            yield Fault(
                "clock",
                (answer.node,),
                f"the clock of node {answer.node} is {abs(offset):.2g} s {where} the clock here",
                "synchronise the clocks of the machines, for example with chrony",
            )


def silent_nodes(snapshot: Snapshot) -> Iterator[Fault]:
    """Find processes that are on the graph but do not answer."""
    for answer in snapshot.answers:
        if not answer.is_answered:
            names = _nodes_of(snapshot, answer.session) or (answer.node,)
            yield Fault(
                "silent-node",
                names,
                f"{_list('node', names)} {_do(names)} not answer: the process hangs, is "
                "overloaded, or has died and stays on the graph until its lease ends",
                "look at that process, or start it again",
            )


# names


def duplicate_nodes(snapshot: Snapshot) -> Iterator[Fault]:
    """Find names that several nodes share."""
    counts = Counter(each.name for each in snapshot.nodes if not is_hidden_node(each.name))
    for name, count in sorted(counts.items()):
        if count > 1:
            yield Fault(
                "duplicate-node",
                (name,),
                f"{count} nodes are called {name}",
                "give each node a name of its own; 'turtleact serve' has --node-name",
            )


def several_servers(snapshot: Snapshot) -> Iterator[Fault]:
    """Find actions that several nodes serve.

    A ROS 2 client sends its goal to all of these nodes, and each of them executes the goal.
    """
    servers: dict[str, set[tuple[str, str]]] = {}
    for each in snapshot.endpoints:
        if each.endpoint.kind == "service" and each.endpoint.name.endswith(SEND_GOAL):
            action = each.endpoint.name.removesuffix(SEND_GOAL)
            servers.setdefault(action, set()).add((each.endpoint.node, each.session))
    for action, found in sorted(servers.items()):
        if len(found) > 1:
            nodes = sorted(node for node, _ in found)
            yield Fault(
                "several-servers",
                (action, *nodes),
                f"{len(found)} nodes serve action {action}: {', '.join(nodes)}",
                "stop all but one: clients of ROS 2 send each goal to all of them",
            )


# types


def differing_types(snapshot: Snapshot) -> Iterator[Fault]:
    """Find topics, services and actions that are offered, but not with the type that a node wants.

    A node may offer several types under one name, as turtleact's server does for ``/fibonacci``.
    """
    told: set[tuple[str, str]] = set()
    for name, ends in sorted(_by_name(snapshot).items()):
        for offering, wanting in (("publisher", "subscription"), ("service", "client")):
            offers, wants = _nodes_by_type(ends, offering), _nodes_by_type(ends, wanting)
            for type_name in sorted(wants.keys() - offers.keys()):
                subject = _plain(name), type_name
                if offers and subject not in told:
                    told.add(subject)
                    yield _type_fault(*subject, wants[type_name], offers)


def _type_fault(
    name: str, type_name: str, wanting: list[str], offers: dict[str, list[str]]
) -> Fault:
    offering = sorted({node for nodes in offers.values() for node in nodes})
    return Fault(
        "type",
        (name, type_name, *wanting, *offering),
        f"{name} has type {' and '.join(offers)} at {', '.join(offering)}, but {type_name} at "
        f"{', '.join(wanting)}",
        "use the same type on both sides, or another name",
    )


def differing_definitions(snapshot: Snapshot) -> Iterator[Fault]:
    """Find types that nodes define differently, because such nodes cannot communicate.

    An action is reported once, even if the types of several of its topics and services differ.
    """
    told: set[tuple[str, str]] = set()
    for (name, type_name), found in sorted(_by_name_and_type(snapshot).items()):
        subject = _plain(name), _owner(type_name)
        holders = _holders(snapshot, type_name, found)
        if len(holders) < 2 or subject in told:
            continue
        told.add(subject)
        who = " and ".join(
            f"{_short(type_hash)} {'' if nodes == ['here'] else 'at '}{', '.join(nodes)}"
            for type_hash, nodes in sorted(holders.items())
        )
        nodes = sorted({node for nodes in holders.values() for node in nodes} - {"here"})
        yield Fault(
            "type-hash",
            (subject[0], subject[1], *nodes),
            f"the definitions of {subject[1]} on {subject[0]} differ: {who}"
            f"{_why_differing(snapshot, type_name, sorted(holders))}",
            "use the same interface files everywhere, and build them again",
        )


def _holders(
    snapshot: Snapshot, type_name: str, found: Iterable[EndpointSeen]
) -> dict[str, list[str]]:
    """Return the names of the nodes that use each definition of a type, by type hash.

    If this process has a definition that none of the nodes uses, the result lists this process as
    the node ``here``.
    """
    holders: dict[str, set[str]] = {}
    for each in _listed(found):
        if HASHED.fullmatch(each.endpoint.type_hash):
            holders.setdefault(each.endpoint.type_hash, set()).add(each.endpoint.node)
    ours = snapshot.known.get(type_name, "")
    if ours and holders and ours not in holders:
        holders[ours] = {"here"}
    return {type_hash: sorted(nodes) for type_hash, nodes in holders.items()}


def unknown_interfaces(snapshot: Snapshot) -> Iterator[Fault]:
    """Find types on the graph for which this process has no definition."""
    where: dict[str, set[str]] = {}
    for each in _listed(snapshot.endpoints):
        if each.endpoint.type_name not in snapshot.known:
            owner = _owner(each.endpoint.type_name)
            where.setdefault(owner, set()).add(_plain(each.endpoint.name))
    for type_name, names in sorted(where.items()):
        yield Fault(
            "unknown-interface",
            (type_name, *sorted(names)),
            f"{type_name} of {', '.join(sorted(names))} is not known here",
            "source the ROS workspace that has it, or give --interfaces DIR",
        )


# quality of service


def incompatible_qos(snapshot: Snapshot) -> Iterator[Fault]:
    """Find subscriptions that request a higher quality of service than a publisher offers."""
    for (name, _), found in sorted(_by_name_and_type(snapshot).items()):
        ends = {each.endpoint for each in _listed(found)}
        publishers = sorted((e for e in ends if e.kind == "publisher"), key=_order)
        readers = sorted((e for e in ends if e.kind == "subscription"), key=_order)
        for publisher, reader in product(publishers, readers):
            if lacks := [_lack(each, reader) for each in misfits(publisher, reader)]:
                yield Fault(
                    "qos",
                    (name, publisher.node, reader.node),
                    f"on topic {name}, {reader.node} asks for {' and '.join(lacks)} than "
                    f"{publisher.node} offers",
                    "choose the same quality of service on both sides",
                )


def _lack(policy: Policy, reader: Endpoint) -> str:
    """Describe a policy in which a subscription requests more than a publisher offers."""
    limits = {"deadline": reader.times.deadline, "lease": reader.times.lease}
    limit = limits.get(policy)
    return LACKS[policy] if limit is None else f"{LACKS[policy]} ({limit / 1e9:g} s)"


# what processes report themselves


def reported(snapshot: Snapshot) -> Iterator[Fault]:
    """Return the faults that processes have found in themselves, such as a full disk."""
    for report in snapshot.reports:
        kind, _, subject = report.name.partition(" ")
        yield Fault(kind, (subject,), report.problem, report.advice)


CHECKS: Final[tuple[Callable[[Snapshot], Iterable[Fault]], ...]] = (
    missing_router,
    empty_domain,
    unfitting_versions,
    silent_nodes,
    clocks_apart,
    duplicate_nodes,
    several_servers,
    differing_types,
    differing_definitions,
    unknown_interfaces,
    incompatible_qos,
    reported,
)
"""All checks, the most fundamental faults first."""


def _major(version: str) -> str:
    return version.lstrip("v").partition(".")[0]


def _nodes_of(snapshot: Snapshot, session: str) -> tuple[str, ...]:
    return tuple(sorted({each.name for each in snapshot.nodes if each.session == session}))


def _list(what: str, names: tuple[str, ...]) -> str:
    return f"{what if len(names) == 1 else f'{what}s'} {', '.join(names)}"


def _do(names: tuple[str, ...]) -> str:
    return "does" if len(names) == 1 else "do"


def _listed(endpoints: Iterable[EndpointSeen]) -> Iterator[EndpointSeen]:
    """Yield the endpoints of nodes that are not hidden.

    Hidden nodes belong to command-line tools, which use the types that they find on the graph.
    """
    return (each for each in endpoints if not is_hidden_node(each.endpoint.node))


def _by_name(snapshot: Snapshot) -> dict[str, list[Endpoint]]:
    found: dict[str, list[Endpoint]] = {}
    for each in _listed(snapshot.endpoints):
        found.setdefault(each.endpoint.name, []).append(each.endpoint)
    return found


def _nodes_by_type(endpoints: Iterable[Endpoint], kind: str) -> dict[str, list[str]]:
    found: dict[str, set[str]] = {}
    for each in endpoints:
        if each.kind == kind:
            found.setdefault(_owner(each.type_name), set()).add(each.node)
    return {type_name: sorted(nodes) for type_name, nodes in sorted(found.items())}


def _by_name_and_type(snapshot: Snapshot) -> dict[tuple[str, str], list[EndpointSeen]]:
    found: dict[tuple[str, str], list[EndpointSeen]] = {}
    for each in snapshot.endpoints:
        found.setdefault((each.endpoint.name, each.endpoint.type_name), []).append(each)
    return found


def _short(type_hash: str) -> str:
    return f"{type_hash[:14]}…"


def _plain(name: str) -> str:
    """The name that users know, such as ``/fibonacci`` for ``/fibonacci/_action/status``."""
    return name.partition("/_action/")[0].removesuffix(EVENT_SUFFIX)


def _owner(type_name: str) -> str:
    """The type that users know, such as ``lab/action/Dock`` for ``lab/action/Dock_SendGoal``."""
    package, _, rest = type_name.partition("/")
    kind, _, name = rest.partition("/")
    if kind in ("action", "srv"):
        name = name.partition("_")[0]
    return f"{package}/{kind}/{name}"


def _order(endpoint: Endpoint) -> tuple[str, bytes]:
    return endpoint.node, endpoint.gid


def _why_differing(snapshot: Snapshot, type_name: str, hashes: list[str]) -> str:
    """Name the fields in which the definitions differ, if the definitions are known."""
    known = [
        (each, fields)
        for each in hashes
        if (fields := snapshot.fields.get((type_name, each))) is not None
    ]
    if len(known) < 2:
        return ""
    is_implied = "/action/" in type_name
    differences = [
        f"{_shown(path, is_implied=is_implied)} is {' and '.join(words)}"
        for path, words in _differences([fields for _, fields in known])
    ]
    more = len(differences) - MOST_FIELDS
    shown = [*differences[:MOST_FIELDS], *([f"and {more} more"] if more > 0 else [])]
    return f" ({', '.join(shown)})" if shown else " (the fields have another order)"


def _shown(path: str, *, is_implied: bool) -> str:
    """Return the path of a field, without an action's leading ``request.`` or ``response.``."""
    return path.removeprefix("request.").removeprefix("response.") if is_implied else path


def _differences(definitions: list[Fields]) -> Iterator[tuple[str, list[str]]]:
    paths = list(dict.fromkeys(path for each in definitions for path in each))
    for path in paths:
        words = [each.get(path, "missing") for each in definitions]
        if len(set(words)) > 1:
            yield path, words


# the fields of types


def fields_of(interface: Interface) -> Fields:
    """The fields of an interface, with those of the messages in it."""
    return dict(_flat(interface))


def _flat(interface: Interface, prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, kind, nested in members(interface):
        if name == EVENTS:
            continue
        path = f"{prefix}{PARTS.get(name, name)}{'[]' if kind.is_sequence else ''}"
        if nested is not None:
            yield from _flat(nested, f"{path}.")
        else:
            yield path, str(kind).replace("char", "uint8")  # one type in a hash
