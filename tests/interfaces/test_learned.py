"""Classes that are made from the descriptions of types."""

from __future__ import annotations

from typing import Any

import pytest

from turtleact.interfaces.learned import LearnedTypes
from turtleact.interfaces.standard.type_description_interfaces.msg import (
    Field,
    FieldType,
    IndividualTypeDescription,
    TypeSource,
)


def described(name: str, *fields: tuple[str, FieldType, str]) -> IndividualTypeDescription:
    return IndividualTypeDescription(f"robot_msgs/msg/{name}", [Field(*each) for each in fields])


def made(*types: IndividualTypeDescription) -> Any:
    return LearnedTypes(types).interface(types[0].type_name)


@pytest.mark.parametrize("encoding", ["msg", "idl"])
def test_a_default_is_taken_from_the_text_or_left_out(encoding):
    mode = described("Mode", ("mode", FieldType(2), "-50"), ("name", FieldType(17), "x"))
    text = TypeSource(mode.type_name, encoding, 'int8 mode -50\nstring name "it\'s"\n')
    types = LearnedTypes([mode], [text])
    default: Any = types.interface(mode.type_name)()
    assert types.has_own_defaults == (encoding == "msg")
    assert (default.mode, default.name) == ((-50, "it's") if encoding == "msg" else (0, ""))


def test_a_message_without_fields_has_none():
    empty = described("Nothing", ("structure_needs_at_least_one_member", FieldType(3), ""))
    assert repr(made(empty)()) == "Nothing()"
