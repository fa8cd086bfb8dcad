"""What a graph looks like at one moment, as far as one process can see it. Pure.

The fields of a type are kept in one flat list that includes the fields of nested types, so that two
definitions of a type can be compared.

Source: type_description_interfaces/msg/TypeDescription and FieldType.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import msgspec

from turtleact.interfaces.type_hash import NESTED_ID, TYPE_IDS, description, referenced
from turtleact.interfaces.types import Interface
from turtleact.transports.base import Endpoint

__all__ = [
    "Answer",
    "EndpointSeen",
    "Fields",
    "NodeSeen",
    "Report",
    "Router",
    "Snapshot",
    "described_fields",
    "own_fields",
]

Fields = Mapping[str, str]
"""The fields of a type by path, such as ``targets[].x``, and the type of each."""

#: Of a service, the events repeat what its request and response are.
PARTS: Final = {"request_message": "request", "response_message": "response"}

EVENTS: Final = "event_message"

#: Numbers below this are single values; numbers of lists of them follow in steps of this size.
FORM_STEP: Final = 48

NAMES: Final = {number: name for name, number in TYPE_IDS.items() if name != "char"}

Row = tuple[str, Mapping[str, Any]]


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


def own_fields(interface: Interface) -> Fields:
    """The fields of an interface that is known in this process."""
    others = {name: _rows(description(each)) for name, each in referenced(interface).items()}
    return dict(_flat(_rows(description(interface)), others))


def described_fields(said: Any) -> Fields:  # noqa: ANN401  # a TypeDescription, of any class
    """The fields of a type that a node has described."""
    others = {each.type_name: _said_rows(each) for each in said.referenced_type_descriptions}
    return dict(_flat(_said_rows(said.type_description), others))


def _rows(described: Mapping[str, Any]) -> list[Row]:
    return [(each["name"], each["type"]) for each in described["fields"]]


def _said_rows(described: Any) -> list[Row]:  # noqa: ANN401  # an IndividualTypeDescription
    keys = "type_id", "capacity", "string_capacity", "nested_type_name"
    return [
        (each.name, {key: getattr(each.type, key) for key in keys}) for each in described.fields
    ]


def _flat(
    rows: list[Row], others: Mapping[str, list[Row]], prefix: str = ""
) -> Iterator[tuple[str, str]]:
    for name, kind in rows:
        if name == EVENTS:
            continue
        form = kind["type_id"] // FORM_STEP * FORM_STEP
        path = f"{prefix}{PARTS.get(name, name)}{'' if form == 0 else '[]'}"
        nested = others.get(kind["nested_type_name"])
        if kind["type_id"] - form == NESTED_ID and nested is not None:
            yield from _flat(nested, others, f"{path}.")
        else:
            yield path, _type_text(kind, form)


def _type_text(kind: Mapping[str, Any], form: int) -> str:
    number = kind["type_id"] - form
    bounded = {each + 4: f"{name}<={kind['string_capacity']}" for each, name in NAMES.items()}
    name = kind["nested_type_name"] or NAMES.get(number) or bounded.get(number, f"type {number}")
    return f"{name}{_brackets(form, kind['capacity'])}"


def _brackets(form: int, capacity: int) -> str:
    return {0: "", 48: f"[{capacity}]", 96: f"[<={capacity}]"}.get(form, "[]")
