"""Classes that are made from the descriptions of types."""

from __future__ import annotations

from typing import Any

import pytest

from turtleact.errors import InvalidInterface
from turtleact.interfaces.learned import LearnedTypes
from turtleact.interfaces.standard.type_description_interfaces.msg import (
    Field,
    FieldType,
    IndividualTypeDescription,
)


def described(name: str, *fields: tuple[str, FieldType, str]) -> IndividualTypeDescription:
    return IndividualTypeDescription(f"robot_msgs/msg/{name}", [Field(*each) for each in fields])


def nested(name: str, number: int = 1, size: int = 0) -> FieldType:
    return FieldType(number, size, 0, f"robot_msgs/msg/{name}")


def made(*types: IndividualTypeDescription) -> Any:
    return LearnedTypes(types).interface(types[0].type_name)


def test_messages_that_are_nested_too_deep_are_refused():
    chain = [described(f"T{n}", ("next", nested(f"T{n + 1}"), "")) for n in range(60)]
    with pytest.raises(InvalidInterface, match="nested more than 50 deep"):
        made(*chain, described("T60", ("x", FieldType(6), "")))


def test_arrays_of_fixed_length_are_multiplied():
    outer = described("Outer", ("rows", nested("Inner", 49, 1001), ""))
    inner = described("Inner", ("cells", FieldType(50, 1000), ""))
    with pytest.raises(InvalidInterface, match="it has more than 1,000,000 values"):
        made(outer, inner)


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (FieldType(15), "True", True),
        (FieldType(2), "-50", -50),
        (FieldType(17), 'it\'s "said"', 'it\'s "said"'),
        (FieldType(63, 3), "(False, True, False)", [False, True, False]),
        (FieldType(161), "('a', 'b')", ["a", "b"]),
        (FieldType(6), "not a number", 0),
        (FieldType(6), "99999999999", 0),
        (FieldType(150), "[" * 5000, []),
    ],
)
def test_a_default_is_read_from_its_text_or_left_out(kind, text, value):
    assert made(described("Mode", ("mode", kind, text)))().mode == value


def test_a_message_without_fields_has_none():
    empty = described("Nothing", ("structure_needs_at_least_one_member", FieldType(3), ""))
    assert repr(made(empty)()) == "Nothing()"
