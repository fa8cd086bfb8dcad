"""Interfaces as rosapi describes them: one typedef a message, and their full text.

Source: rosapi ``objectutils.py`` and ``stringify_field_types.py`` for the form.
"""

from __future__ import annotations

from collections.abc import Iterator

from turtleact.interfaces import Message, fields, interface_text
from turtleact.interfaces.definition import ArrayForm, Field
from turtleact.interfaces.types import constants, nested_classes

__all__ = ["full_text", "short_name", "typedefs"]

RULE = "=" * 80


def short_name(type_name: str) -> str:
    """A type's name without its kind.

    >>> short_name("geometry_msgs/msg/Point")
    'geometry_msgs/Point'
    """
    package, _, name = type_name.rpartition("/")
    return f"{package.partition('/')[0]}/{name}"


def typedefs(cls: type[Message]) -> list[dict[str, object]]:
    """A message and all messages in it, each once, the outermost first."""
    return [_typedef(each) for each in _with_nested(cls)]


def full_text(cls: type[Message]) -> str:
    """The text of a message, then those of the messages in it."""
    first, *rest = _with_nested(cls)
    blocks = [f"{RULE}\nMSG: {short_name(each.type_name)}\n{interface_text(each)}" for each in rest]
    return "\n".join([interface_text(first), *blocks])


def _with_nested(cls: type[Message]) -> list[type[Message]]:
    found: dict[type[Message], None] = {}
    _collect(cls, found)
    return list(found)


def _collect(cls: type[Message], found: dict[type[Message], None]) -> None:
    if cls not in found:
        found[cls] = None
        for nested in nested_classes(cls):
            if nested is not None:
                _collect(nested, found)


def _typedef(cls: type[Message]) -> dict[str, object]:
    known = fields(cls)
    return {
        "type": short_name(cls.type_name),
        "fieldnames": [field.name for field in known],
        "fieldtypes": list(_field_types(cls)),
        "fieldarraylen": [_array_length(field) for field in known],
        "examples": [_example(cls, field) for field in known],
        "constnames": [constant.name for constant in constants(cls)],
        "constvalues": [str(constant.value) for constant in constants(cls)],
    }


def _field_types(cls: type[Message]) -> Iterator[str]:
    for field in fields(cls):
        yield short_name(field.type.name) if field.type.is_nested else field.type.name


def _array_length(field: Field) -> int:
    """-1 for a single element, 0 for a list of any length, else the length."""
    if not field.type.is_sequence:
        return -1
    return field.type.size if field.type.form is ArrayForm.FIXED else 0


def _example(cls: type[Message], field: Field) -> str:
    if field.type.is_sequence:
        return "[]"
    return "{}" if field.type.is_nested else str(getattr(cls(), field.attribute))
