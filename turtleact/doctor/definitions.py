"""Lists all fields of a type, nested ones included, to compare two definitions of the type.

Source: type_description_interfaces/msg/TypeDescription and FieldType.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from turtleact.doctor.snapshot import Fields
from turtleact.interfaces.type_hash import NESTED_ID, TYPE_IDS, description, referenced
from turtleact.interfaces.types import Interface

__all__ = ["described_fields", "own_fields"]

#: Of a service, the events repeat what its request and response are.
PARTS: Final = {"request_message": "request", "response_message": "response"}
EVENTS: Final = "event_message"

#: Numbers below this are single values; numbers of lists of them follow in steps of this size.
FORM_STEP: Final = 48

NAMES: Final = {number: name for name, number in TYPE_IDS.items() if name != "char"}

Row = tuple[str, Mapping[str, Any]]


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
