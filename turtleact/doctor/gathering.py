"""Takes a snapshot of a running graph: reads liveliness tokens, and calls each process.

To call a process, this module sends a harmless request to one of the services of the process. The
request cancels a goal that does not exist, lists parameters with a prefix that no parameter has, or
asks for the description of a type. A process that offers none of these services is not called. An
answer shows that the process is alive. The time stamp of the answer shows how far the clock of the
process differs from the local clock.

Source: action_msgs/srv/CancelGoal, rcl_interfaces/srv/ListParameters,
type_description_interfaces/srv/GetTypeDescription.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final

import anyio
import msgspec

from turtleact.doctor.checks import (
    HASHED,
    Answer,
    EndpointSeen,
    Fields,
    NodeSeen,
    Report,
    Router,
    Snapshot,
    fields_of,
)
from turtleact.errors import NotLearned, TurtleactError
from turtleact.goals.fault_reports import ADVICE, TOPIC, UNTIL
from turtleact.interfaces import WireFormat, get_interface, type_hash
from turtleact.interfaces.standard import UUID, CancelGoal, GoalInfo
from turtleact.interfaces.standard.diagnostic_msgs.msg import DiagnosticArray
from turtleact.node.learning import Use
from turtleact.transports import QoS, ZenohTransport
from turtleact.transports.base import Endpoint

if TYPE_CHECKING:
    from turtleact.node import Node
    from turtleact.transports.base import Caller, Transport

__all__ = ["take_snapshot"]

FieldsByType = dict[tuple[str, str], Fields]

PATIENCE: Final = 2.0
"""How long to wait for the answers of processes (s, event loop time)."""

REPORTING: Final = 1.0
"""How long to wait for the faults that processes report (s, event loop time)."""

READ_QOS: Final = QoS(depth=1000, durability="transient_local")

LIST_PARAMETERS: Final = "rcl_interfaces/srv/ListParameters"
GET_DESCRIPTION: Final = "type_description_interfaces/srv/GetTypeDescription"

QUESTIONS: Final = (CancelGoal.type_name, LIST_PARAMETERS, GET_DESCRIPTION)
"""The types of services that the doctor may call as a probe, in order of preference.

The doctor's requests to these services change nothing.
"""


async def take_snapshot(node: Node, *, with_domains: bool = False) -> Snapshot:
    """Describe the graph that a node is on, with the faults that other processes report.

    This takes about `PATIENCE` seconds if a process does not answer. Cancelling: safe.

    Args:
        node: A node on the graph. The snapshot does not contain this node.
        with_domains: Whether to always find out which ROS domains are in use. If False, this is
            done only if there are no other nodes on the graph.

    Raises:
        ExceptionGroup: with a `TurtleactError`, if the node is closed, or loses its connection to
            the graph meanwhile.
    """
    nodes, endpoints = _seen(node)
    answers: list[Answer] = []
    reports: list[Report] = []
    around: list[Snapshot] = []
    known = _known({each.endpoint.type_name for each in endpoints})
    fields: FieldsByType = {}
    async with anyio.create_task_group() as group:
        for session, asked in _to_ask(endpoints).items():
            group.start_soon(_ask, node, session, asked, answers)
        group.start_soon(_collect_reports, node, reports)
        group.start_soon(_look_around, node, around, with_domains or not nodes)
        group.start_soon(_find_fields, node, endpoints, known, fields)
    return msgspec.structs.replace(
        around[0],
        nodes=nodes,
        endpoints=endpoints,
        answers=tuple(sorted(answers, key=lambda each: each.node)),
        reports=tuple(sorted(set(reports), key=lambda each: each.name)),
        known=known,
        fields=fields,
    )


def _seen(node: Node) -> tuple[tuple[NodeSeen, ...], tuple[EndpointSeen, ...]]:
    """The nodes and endpoints on the graph, without those of the node that takes the snapshot."""
    transport, own = node.transport, node.fully_qualified_name
    near: Transport = transport
    if isinstance(transport, ZenohTransport):
        tokens = list(transport.graph.tokens.values())
        zid, near = transport.context.session.zid, transport.context.near
    else:
        tokens, zid = [], ""
    nodes = [NodeSeen(name, zid) for name in near.nodes() if name != own]
    ends = [EndpointSeen(each, zid) for each in near.endpoints() if each.node != own]
    nodes += [NodeSeen(each.node, each.zid) for each in tokens if each.endpoint is None]
    ends += [EndpointSeen(t.endpoint, t.zid) for t in tokens if t.endpoint is not None]
    return tuple(nodes), tuple(ends)


# questions to processes


def _to_ask(endpoints: Iterable[EndpointSeen]) -> dict[str, Endpoint]:
    """Return the service to call in each session, by session id.

    A session is left out if none of its services has a type from `QUESTIONS`.
    """
    best: dict[str, Endpoint] = {}
    for each in endpoints:
        endpoint = each.endpoint
        if endpoint.kind == "service" and endpoint.type_name in QUESTIONS:
            other = best.get(each.session)
            if other is None or _rank(endpoint) < _rank(other):
                best[each.session] = endpoint
    return best


def _rank(service: Endpoint) -> int:
    return QUESTIONS.index(service.type_name)


async def _ask(node: Node, session: str, service: Endpoint, answers: list[Answer]) -> None:
    """Call a process twice: first to see whether it answers, then to read its clock."""
    caller, request = _join(node, service)
    sent = received = stamp = 0
    is_answered = False
    try:
        with anyio.move_on_after(PATIENCE):
            await caller.call(request)  # the first call takes longer, because it finds the way
            is_answered = True
            sent = time.time_ns()
            stamp = (await caller.call(request)).stamp
            received = time.time_ns()
    except TurtleactError:
        is_answered = True  # with an error, or it has just gone
    finally:
        caller.close()
    offset = None if not stamp else (stamp - (sent + received) / 2) / 1e9
    doubt = (received - sent) / 2e9
    answers.append(Answer(session, service.node, is_answered, offset, doubt))


def _join(node: Node, service: Endpoint) -> tuple[Caller, object]:
    """Return a client of a service, and a request that changes nothing when it is sent."""
    interface: Any = get_interface(service.type_name)
    described = Endpoint("client", service.name, service.type_name, node.fully_qualified_name)
    caller = node.transport.join(described, WireFormat(interface, asks=True))
    if interface is CancelGoal:
        return caller, CancelGoal.Request(GoalInfo(UUID(os.urandom(16))))
    if service.type_name == GET_DESCRIPTION:
        return caller, interface.Request(type_name=CancelGoal.type_name)
    return caller, interface.Request(prefixes=["nothing.like.this"])


# what processes report


async def _collect_reports(node: Node, reports: list[Report]) -> None:
    """Collect the faults that processes have reported.

    The topic is latched, so the last message of each publisher is delivered to a new subscription.
    """
    left = node.count_publishers(TOPIC)
    if not left:
        return
    subscription = node.subscription(DiagnosticArray, TOPIC, READ_QOS)
    try:
        with anyio.move_on_after(REPORTING):
            async for message in subscription:
                for status in message.status:
                    said = {each.key: each.value for each in status.values}
                    if float(said.get(UNTIL) or "inf") > time.time():
                        reports.append(Report(status.name, status.message, said.get(ADVICE, "")))
                left -= 1
                if left <= 0:
                    return
    finally:
        await subscription.aclose()


# the session and its routers


async def _look_around(node: Node, around: list[Snapshot], with_domains: bool) -> None:
    transport = node.transport
    if not isinstance(transport, ZenohTransport):
        around.append(Snapshot())
        return
    routers = [_router(zid, said) for zid, said in sorted((await transport.routers()).items())]
    around.append(
        Snapshot(
            domain=transport.context.domain,
            routers=tuple(routers),
            zenoh=version("eclipse-zenoh"),
            domains=await transport.domains() if with_domains else (),
        )
    )


def _router(zid: str, said: str) -> Router:
    """Make a `Router` from the JSON text in the admin space of a Zenoh router."""
    try:
        told = msgspec.json.decode(said, type=_Told)
    except msgspec.DecodeError:
        return Router(zid)
    number = told.version.lstrip("v").partition("-")[0]
    return Router(zid, number, len(told.sessions))


class _Told(msgspec.Struct):
    """The values that `_router` reads from the JSON text in a router's admin space."""

    version: str = ""
    sessions: list[object] = []


# definitions of types


def _known(type_names: Iterable[str]) -> dict[str, str]:
    """The type hash of each type that is known in this process."""
    known: dict[str, str] = {}
    for name in type_names:
        try:
            known[name] = type_hash(get_interface(name))
        except TurtleactError:
            continue
    return known


async def _find_fields(
    node: Node,
    endpoints: Sequence[EndpointSeen],
    known: Mapping[str, str],
    fields: FieldsByType,
) -> None:
    """Find the fields of types that have several definitions on the graph."""
    holders: dict[str, dict[str, str]] = {}  # type name to hash to one node that has it
    for each in endpoints:
        end = each.endpoint
        if HASHED.fullmatch(end.type_hash):
            holders.setdefault(end.type_name, {}).setdefault(end.type_hash, end.node)
    async with anyio.create_task_group() as group:
        for type_name, found in holders.items():
            ours = known.get(type_name, "")
            if len({*found, ours} - {""}) < 2:
                continue
            if ours:
                fields[type_name, ours] = fields_of(get_interface(type_name))
            for type_hash_, holder in found.items():
                if type_hash_ != ours:
                    use = Use("topic", type_name, (type_hash_,))
                    group.start_soon(_learn_fields, node, use, holder, fields)


async def _learn_fields(node: Node, use: Use, holder: str, fields: FieldsByType) -> None:
    """Ask a node for the fields of a type that it uses."""
    with suppress(NotLearned):
        described = await node.learner.described(use, [holder])
        fields[use.type_name, use.hashes[0]] = fields_of(described)
