"""Messages as rclpy prints them: what ``ros2 topic pub`` and ``ros2 service call`` show.

An array of fixed length is shown as numpy shows it, but always on one line.

Source: recordings of ROS 2 Jazzy; rosidl_generator_py ``resource/_msg.py.em`` for the rules.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.interfaces.definition import ArrayForm
from turtleact.interfaces.types import fields

if TYPE_CHECKING:
    from turtleact.interfaces import Message
    from turtleact.interfaces.definition import Field

__all__ = ["python_text"]

SILENT = frozenset({"float64", "int64", "bool"})
"""The types that numpy does not name."""

DTYPES = {"byte": "uint8", "char": "uint8"}
"""What numpy calls a type otherwise."""


def python_text(message: Message) -> str:
    """A message as rclpy's ``repr`` of it.

    >>> from turtleact.interfaces.standard import Time
    >>> python_text(Time(sec=1))
    'builtin_interfaces.msg.Time(sec=1, nanosec=0)'
    """
    cls = type(message)
    values = ", ".join(
        f"{field.name}={_value(field, getattr(message, field.attribute))}" for field in fields(cls)
    )
    return f"{cls.type_name.replace('/', '.')}({values})"


def _value(field: Field, value: object) -> str:
    kind = field.type
    if kind.is_nested:
        if not kind.is_sequence:
            return python_text(value)  # type: ignore[arg-type]  # a message, as declared
        return f"[{', '.join(map(python_text, value))}]"  # type: ignore[call-overload]  # likewise
    if kind.is_sequence:
        items = f"[{', '.join(map(repr, value))}]"  # type: ignore[call-overload]  # likewise
        if kind.form is not ArrayForm.FIXED or kind.is_string:
            return items
        name = DTYPES.get(kind.name, kind.name)
        return f"array({items})" if name in SILENT else f"array({items}, dtype={name})"
    return repr(value)
