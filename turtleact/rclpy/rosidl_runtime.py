"""The part of ``rosidl_runtime_py`` that programs use: messages as plain data, classes by name."""

from __future__ import annotations

from collections.abc import Mapping

from turtleact.interfaces import decode, fields, to_yaml
from turtleact.interfaces import get_interface as find_by_name
from turtleact.interfaces.types import nested_classes
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages import InterfaceClass, encode, interface_class

__all__ = [
    "get_action",
    "get_interface",
    "get_message",
    "get_service",
    "message_to_ordereddict",
    "message_to_yaml",
    "set_message_fields",
]


def get_interface(identifier: str) -> InterfaceClass:
    """Return the class of an interface by its full name, or by ``package/Name``."""
    return interface_class(find_by_name(identifier).type_name)


get_message = get_service = get_action = get_interface


def message_to_ordereddict(msg: Anything) -> dict[str, Anything]:
    """Return the fields of a message as plain values, by name."""
    return {field.name: _plain(getattr(msg, field.attribute)) for field in fields(type(msg))}


def message_to_yaml(msg: Anything) -> str:
    """Return a message as YAML."""
    ours: Anything = find_by_name(type(msg).type_name)
    return to_yaml(decode(ours, encode(msg, type(msg))))


def set_message_fields(msg: Anything, values: Mapping[str, Anything]) -> None:
    """Set the fields of a message from plain values.

    Raises:
        AttributeError: if one of the names is not a field of the message.
    """
    pairs = zip(fields(type(msg)), nested_classes(type(msg)), strict=True)
    known = {field.name: (field, nested) for field, nested in pairs}
    for name, value in values.items():
        if name not in known:
            raise AttributeError(f"'{type(msg).__name__}' has no field '{name}'")
        field, nested = known[name]
        if nested is not None and field.type.is_sequence:
            value = [_filled(nested, each) for each in value]
        elif nested is not None:
            value = _filled(nested, value)
        setattr(msg, field.attribute, value)


def _filled(message_class: Anything, values: Anything) -> Anything:
    if isinstance(values, message_class):
        return values
    made = message_class()
    set_message_fields(made, values)
    return made


def _plain(value: Anything) -> Anything:
    if hasattr(value, "get_fields_and_field_types"):
        return message_to_ordereddict(value)
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return value.tolist() if hasattr(value, "tolist") else value
