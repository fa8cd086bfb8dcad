"""The values of parameters: as messages, as Python has them, and as text and files say them.

Source: rclpy ``parameter.py`` (ROS 2 Jazzy) for what a text means, and what is in a file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import msgspec

from turtleact.commands.goal_text import read_text_file
from turtleact.errors import UsageError
from turtleact.interfaces.standard.parameters import ParameterType, ParameterValue
from turtleact.interfaces.text import Document, tree_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

__all__ = ["BELOW", "KINDS", "WILDCARD", "kind_name", "parameter_value", "plain", "read_file"]

WILDCARD = "/**"
"""What a file of parameters calls all nodes."""

BELOW = "ros__parameters"
"""What a file of parameters puts them below."""


class Kind(NamedTuple):
    """A kind of value.

    Attributes:
        field: The field of ``ParameterValue`` that holds it.
        name: What it is called.
        label: What is printed before it.
    """

    field: str
    name: str
    label: str


KINDS: Final = {
    ParameterType.PARAMETER_BOOL: Kind("bool_value", "boolean", "Boolean value is:"),
    ParameterType.PARAMETER_INTEGER: Kind("integer_value", "integer", "Integer value is:"),
    ParameterType.PARAMETER_DOUBLE: Kind("double_value", "double", "Double value is:"),
    ParameterType.PARAMETER_STRING: Kind("string_value", "string", "String value is:"),
    ParameterType.PARAMETER_BYTE_ARRAY: Kind("byte_array_value", "byte array", "Byte values are:"),
    ParameterType.PARAMETER_BOOL_ARRAY: Kind(
        "bool_array_value", "boolean array", "Boolean values are:"
    ),
    ParameterType.PARAMETER_INTEGER_ARRAY: Kind(
        "integer_array_value", "integer array", "Integer values are:"
    ),
    ParameterType.PARAMETER_DOUBLE_ARRAY: Kind(
        "double_array_value", "double array", "Double values are:"
    ),
    ParameterType.PARAMETER_STRING_ARRAY: Kind(
        "string_array_value", "string array", "String values are:"
    ),
}

SINGLE: Final = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}
"""The kinds of values that a text can say; that of a list of them is five above."""

ARRAY: Final = ParameterType.PARAMETER_BOOL_ARRAY - ParameterType.PARAMETER_BOOL


def parameter_value(text: str) -> ParameterValue:
    """The value that a text says: a bool, a number, a list of one kind, or else the text itself.

    Raises:
        UsageError: if it is a list of several kinds, or nothing.
        InvalidMessage: if it is no YAML.

    >>> parameter_value("150").integer_value, parameter_value("it: is").string_value
    (150, 'it: is')
    """
    value = tree_of(Document(text, "value", "value", allow_nonfinite=True))
    return _message(text if isinstance(value, dict) else value, "value")


def read_file(path: str, *, use_wildcard: bool) -> dict[str, dict[str, ParameterValue]]:
    """The parameters in a file, by the name of their node as it is written there.

    Args:
        path: A file in YAML, such as `dump` prints.
        use_wildcard: Whether those for all nodes (``/**``) are meant, too.

    Raises:
        UsageError: if it cannot be read, or is no such file.
        InvalidMessage: if it is no YAML.
    """
    if not path:
        raise UsageError("FILE: the path is empty")
    text = read_text_file(path, path)
    tree = tree_of(Document(text, "parameters", path, allow_nonfinite=True))
    if not tree or not isinstance(tree, dict):
        problem = "is empty" if tree in ({}, None) else "holds no nodes with their parameters"
        raise UsageError(f"{path}: {problem}: 'param dump' prints such a file")
    found: dict[str, dict[str, ParameterValue]] = {}
    for name, below in tree.items():
        values = below.get(BELOW) if isinstance(below, dict) else None
        if not isinstance(values, dict):
            raise UsageError(f"{path}: {name} has no {BELOW}: 'param dump' prints such a file")
        if use_wildcard or name != WILDCARD:
            found[name] = {key: _message(each, f"{path}: {key}") for key, each in _flat(values)}
    return found


def plain(value: ParameterValue) -> object:
    """A value as Python has it; None if it is not set."""
    kind = KINDS.get(value.type)
    found = None if kind is None else getattr(value, kind.field)
    return found if found is None or isinstance(found, bool | int | float | str) else list(found)


def kind_name(number: int) -> str:
    """What a kind of value is called."""
    kind = KINDS.get(number)
    return "not set" if kind is None else kind.name


def _message(value: object, where: str) -> ParameterValue:
    """A plain value as a message."""
    items = value if isinstance(value, list) else [value]
    kinds = {type(item) for item in items} or {bool}  # as rclpy takes an empty list
    number = SINGLE.get(kinds.pop())
    if number is None or kinds:
        problem = "a bool, a number, text, or a list of values of one kind"
        raise UsageError(f"{where}: a parameter is {problem}, not {value!r}")
    if isinstance(value, list):
        number += ARRAY
    return msgspec.structs.replace(ParameterValue(number), **{KINDS[number].field: value})


def _flat(tree: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """The values of a tree, with dots between the names on the way to them."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
