"""What a graph looks like at one moment, as far as one process can see it. Pure.

The fields of types are listed flat, nested ones included, so that two definitions of a type can be
compared.

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
        name: Its fully qualified name.
        session: The id of its session; a process usually has one session.
    """

    name: str
    session: str = ""


class EndpointSeen(msgspec.Struct, frozen=True):
    """An endpoint on the graph.

    Attributes:
        endpoint: The endpoint.
        session: The id of its session.
    """

    endpoint: Endpoint
    session: str = ""


class Answer(msgspec.Struct, frozen=True):
    """Whether and how a session answered a question.

    Attributes:
        session: The id of the session.
        node: The node that was asked.
        is_answered: Whether it has answered in time.
        offset: How far its clock is ahead of ours (s); None if unknown.
        uncertainty: How far the offset may be wrong (s).
    """

    session: str
    node: str
    is_answered: bool = True
    offset: float | None = None
    uncertainty: float = 0.0


class Report(msgspec.Struct, frozen=True):
    """A fault that a process has found in itself; see `turtleact.fault_reports`.

    Attributes:
        name: What is at fault.
        problem: What is wrong.
        advice: What to do.
    """

    name: str
    problem: str
    advice: str = ""


class Router(msgspec.Struct, frozen=True):
    """A router in reach.

    Attributes:
        zid: Its id.
        version: The version of its Zenoh, such as "1.10.2"; empty if it does not tell.
        sessions: How many sessions are connected to it; None if it does not tell.
    """

    zid: str
    version: str = ""
    sessions: int | None = None


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """What a graph looks like at one moment.

    Attributes:
        domain: The ROS domain; None within a process.
        routers: The routers in reach; None within a process, where no router is needed.
        zenoh: The version of our Zenoh; empty if unknown.
        nodes: All nodes. Several may share a name.
        endpoints: All endpoints.
        answers: One for each session that was asked.
        reports: The faults that processes have found in themselves.
        known: This process's hash of each type on the graph that it knows, by type name.
        fields: The fields of types that have several definitions, by type name and hash.
        domains: The ROS domains that others use; empty if that was not asked.
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
    """The fields of an interface that is known here."""
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
