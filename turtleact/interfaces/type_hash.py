"""Computes type hashes (RIHS01), by which ROS 2 nodes see whether they use the same definitions.

The hash is the SHA-256 of a description of the type and of all types in it. The description
consists of the names of the types, and the names and types of their fields, in order. Defaults,
constants and comments do not change the hash. The description is JSON with exact spacing: ``", "``
and ``": "`` as separators, only ASCII characters, and no line break.

Source: REP 2016 (rosidl calls it REP 2011), ``rosidl_generator_type_description/__init__.py``, and
the numbers of ``type_description_interfaces/msg/FieldType.msg``.
"""

from __future__ import annotations

import functools
from itertools import zip_longest
from typing import TYPE_CHECKING, NamedTuple

from turtleact.interfaces.classes import event_message, implied
from turtleact.interfaces.definition import ArrayForm, FieldType, check_type_name
from turtleact.interfaces.types import Action, Service, fields, nested_classes

if TYPE_CHECKING:
    from turtleact.interfaces.standard.type_description_interfaces.msg import (
        IndividualTypeDescription,
        TypeDescription,
    )
    from turtleact.interfaces.types import Interface

__all__ = ["first_difference", "structure_hash", "type_hash"]

#: The number of each type; a ``char`` is a uint8 in ROS 2.
TYPE_IDS = {
    "int8": 2,
    "uint8": 3,
    "char": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
}
NESTED_ID = 1

#: Added to the number of a string that has a bound.
BOUNDED_STRING = 4

#: What each form of array adds to the number of its element.
FORM_IDS = {
    ArrayForm.SINGLE: 0,
    ArrayForm.FIXED: 48,
    ArrayForm.BOUNDED: 96,
    ArrayForm.UNBOUNDED: 144,
}


class Member(NamedTuple):
    """One field in a description.

    If the field contains messages, ``nested`` is their class, otherwise None.
    """

    name: str
    type: FieldType
    nested: Interface | None = None

    def __str__(self) -> str:
        return f"{self.type} {self.name}"


#: C has no empty structs, so rosidl puts this field into them.
PLACEHOLDER = Member("structure_needs_at_least_one_member", FieldType("uint8"))


def type_hash(cls: Interface) -> str:
    """Return the type hash of a message, service or action, as in ROS 2 from Iron on.

    The hash is computed once per class, on first use. Nodes announce the hashes of messages and
    services, including those derived from an action. They do not announce the hash of the action
    itself.

    Raises:
        InvalidInterface: if the class has no type name.

    >>> from turtleact.interfaces.standard import Point
    >>> type_hash(Point)
    'RIHS01_6963084842a9b04494d6b2941d11444708d892da2f4b09843b9c43f42a7f6881'
    """
    # mypy wants the class's instances to be hashable, but the class itself is looked up.
    return hashed(cls)  # type: ignore[arg-type]


@functools.cache
def hashed(cls: Interface) -> str:
    """Compute the type hash of an interface."""
    check_type_name(cls.type_name)
    others = referenced(cls)
    return digest(description(cls), [description(others[name]) for name in sorted(others)])


def structure_hash(described: TypeDescription) -> str:
    """Return the hash of a description that a node has sent."""
    others = described.referenced_type_descriptions
    return digest(plain(described.type_description), [plain(each) for each in others])


def first_difference(ours: Interface, theirs: Interface) -> str:
    """Name the first field that differs between two definitions of a type; empty if none does."""
    for own, other in zip_longest(members(ours), members(theirs)):
        if own is None or other is None or own[:2] != other[:2]:
            here, there = (f"'{each}'" if each else "no further field" for each in (own, other))
            return f"{ours.type_name} has {here} here, {there} there"
        if own.nested is not None and other.nested is not None:
            inner = first_difference(own.nested, other.nested)
            if inner:
                return inner
    return ""


def digest(whole: dict[str, object], others: list[dict[str, object]]) -> str:
    """Return the hash of a type's description and of those of the types in it."""
    import json  # only this function needs these two, which are slow to import
    from hashlib import sha256

    said = {"type_description": whole, "referenced_type_descriptions": others}
    return f"RIHS01_{sha256(json.dumps(said).encode()).hexdigest()}"


def plain(described: IndividualTypeDescription) -> dict[str, object]:
    """Return the part of a type's description that the hash covers."""
    rows = [
        {
            "name": field.name,
            "type": {name: getattr(field.type, name) for name in field.type.__struct_fields__},
        }
        for field in described.fields
    ]
    return {"type_name": described.type_name, "fields": rows}


def referenced(cls: Interface) -> dict[str, Interface]:
    """Return all types that an interface contains, at any depth, by type name."""
    found: dict[str, Interface] = {}
    waiting = [cls]
    while waiting:
        for member in members(waiting.pop()):
            if member.nested is not None and member.nested.type_name not in found:
                found[member.nested.type_name] = member.nested
                waiting.append(member.nested)
    return found


def description(cls: Interface) -> dict[str, object]:
    """Return the description of one type.

    The order of the keys matters, because the description is hashed as text.
    """
    rows = [{"name": member.name, "type": field_type(member.type)} for member in members(cls)]
    return {"type_name": cls.type_name, "fields": rows}


def field_type(kind: FieldType) -> dict[str, object]:
    """Return the description of a field's type.

    The order of the keys matters, because the description is hashed as text.
    """
    bound = kind.string_bound or 0
    if kind.name == "wstring" and bound and kind.form is ArrayForm.UNBOUNDED:
        # rosidl_parser mistakes the bound of the wstring for the bound of the list.
        kind = FieldType(kind.name, bound, ArrayForm.BOUNDED, bound)
    element = NESTED_ID if kind.is_nested else TYPE_IDS[kind.name] + BOUNDED_STRING * bool(bound)
    return {
        "type_id": element + FORM_IDS[kind.form],
        "capacity": kind.size,
        "string_capacity": bound,
        "nested_type_name": kind.name if kind.is_nested else "",
    }


def members(cls: Interface) -> list[Member]:
    """Return the fields of a message, or one field for each type in a service or action."""
    if issubclass(cls, Action):
        types = implied(cls)
        inside: dict[str, Interface] = {
            "goal": cls.Goal,
            "result": cls.Result,
            "feedback": cls.Feedback,
            "send_goal_service": types.send_goal,
            "get_result_service": types.get_result,
            "feedback_message": types.feedback_message,
        }
    elif issubclass(cls, Service):
        inside = {
            "request_message": cls.Request,
            "response_message": cls.Response,
            "event_message": event_message(cls),
        }
    else:
        own = zip(fields(cls), nested_classes(cls), strict=True)
        return [Member(field.name, field.type, nested) for field, nested in own] or [PLACEHOLDER]
    return [Member(name, FieldType(each.type_name), each) for name, each in inside.items()]
