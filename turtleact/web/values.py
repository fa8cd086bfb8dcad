"""Messages as JSON and CBOR say them, and back.

What JSON has no word for is bent both ways, as rosbridge does:

- ``uint8[]`` and ``char[]`` are base64 text; a list of numbers is taken, too.
- NaN and infinity are null; null is taken for NaN where a number with a point belongs.
- A time is ``sec`` and ``nanosec``; ``secs`` and ``nsecs`` are taken, too.
- A whole number is taken where one with a point belongs: JavaScript writes ``1`` for ``1.0``.
- A list in place of the outermost object gives the fields in their order.

CBOR has bytes, and tags for lists of numbers.

Source: rosbridge_library ``message_conversion.py`` and ``cbor_conversion.py``; RFC 8746, section 2.
"""

from __future__ import annotations

import binascii
import functools
import math
import struct
from collections.abc import Callable
from typing import Any, TypeVar, cast

import cbor2

from turtleact.errors import InvalidMessage
from turtleact.interfaces import Message, fields, from_dict
from turtleact.interfaces.definition import Field
from turtleact.interfaces.types import nested_classes

__all__ = ["cbor_values", "json_values", "message_from"]

M = TypeVar("M", bound=Message)
Convert = Callable[[Any], object]

BASE64 = frozenset({"uint8", "char"})
FLOATS = frozenset({"float32", "float64"})
TIMES = frozenset({"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"})
TIME_SPELLINGS = {"secs": "sec", "nsecs": "nanosec"}

TYPED_ARRAYS = {
    "uint16": (69, "H"),
    "uint32": (70, "I"),
    "uint64": (71, "Q"),
    "byte": (72, "B"),
    "int8": (72, "b"),
    "int16": (77, "h"),
    "int32": (78, "i"),
    "int64": (79, "q"),
    "float32": (85, "f"),
    "float64": (86, "d"),
}
"""The tag of a list of such numbers, little-endian, and how `struct` writes one of them."""


def json_values(message: Message) -> object:
    """What msgspec writes as the JSON of a message; the message itself where that will do."""
    convert = _writer(type(message), is_json=True)
    return message if convert is None else convert(message)


def cbor_values(message: Message) -> dict[str, object]:
    """What cbor2 writes as the CBOR of a message."""
    convert = cast("Convert", _writer(type(message), is_json=False))
    return cast("dict[str, object]", convert(message))


def message_from(cls: type[M], values: object, *, root: str) -> M:
    """The message that a client's values say; what is left out keeps its default.

    Args:
        cls: The class.
        values: An object by field names, or a list of the fields in their order; None for nothing.
        root: The first word of the path in errors.

    Raises:
        InvalidMessage: with the path of the first value or name that does not fit.

    >>> from turtleact.interfaces.standard import Point, Time
    >>> message_from(Point, [1, 2], root="args")
    Point(x=1.0, y=2.0, z=0.0)
    >>> message_from(Time, {"secs": 1, "nsecs": 2}, root="args")
    Time(sec=1, nanosec=2)
    """
    if values is None:
        values = {}
    if isinstance(values, list):
        known = fields(cls)
        if len(values) > len(known):
            raise InvalidMessage(root, f"{len(values)} values for {len(known)} fields")
        values = {field.name: value for field, value in zip(known, values, strict=False)}
    convert = _reader(cls)
    return from_dict(cls, values if convert is None else convert(values), root=root)  # type: ignore[arg-type]  # it checks that


# out


@functools.cache
def _writer(cls: type[Message], *, is_json: bool) -> Convert | None:
    """What makes plain values of a message; None where JSON takes it as it is."""
    converters = [
        (field, _field_writer(field, nested, is_json=is_json))
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    ]
    if is_json and all(c is None and f.name == f.attribute for f, c in converters):
        return None

    def convert(message: Message) -> dict[str, object]:
        return {
            field.name: getattr(message, field.attribute)
            if change is None
            else change(getattr(message, field.attribute))
            for field, change in converters
        }

    return convert


def _field_writer(field: Field, nested: type[Message] | None, *, is_json: bool) -> Convert | None:
    kind = field.type
    if nested is not None:
        element = _writer(nested, is_json=is_json)
        if not kind.is_sequence or element is None:
            return element
        return lambda items: [element(item) for item in items]
    if not kind.is_sequence:
        return None
    if kind.name in BASE64:
        return bytes  # msgspec writes them as base64
    if not is_json and kind.name in TYPED_ARRAYS:
        return functools.partial(_typed_array, *TYPED_ARRAYS[kind.name])
    return list if kind.name == "byte" else None


def _typed_array(tag: int, code: str, numbers: list[float]) -> cbor2.CBORTag:
    return cbor2.CBORTag(tag, struct.pack(f"<{len(numbers)}{code}", *numbers))


# in


@functools.cache
def _reader(cls: type[Message]) -> Convert | None:
    """What makes a client's values those of ROS; None where they are already."""
    converters = {
        field.name: change
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
        if (change := _field_reader(field, nested)) is not None
    }
    spellings = TIME_SPELLINGS if cls.type_name in TIMES else {}
    if not converters and not spellings:
        return None

    def convert(values: object) -> object:
        if not isinstance(values, dict):
            return values
        return {
            spellings.get(name, name): converters[name](value) if name in converters else value
            for name, value in values.items()
        }

    return convert


def _field_reader(field: Field, nested: type[Message] | None) -> Convert | None:
    kind = field.type
    if kind.is_sequence and kind.name in BASE64:
        return functools.partial(_from_base64, field.name)
    element = _reader(nested) if nested is not None else None
    if kind.name in FLOATS:
        element = _number
    if element is None or not kind.is_sequence:
        return element
    return functools.partial(_each, element)


def _each(element: Convert, values: object) -> object:
    return [element(value) for value in values] if isinstance(values, list) else values


def _number(value: object) -> object:
    return math.nan if value is None else value


def _from_base64(name: str, value: object) -> object:
    if not isinstance(value, str):
        return value
    try:
        return binascii.a2b_base64(value, strict_mode=True)
    except ValueError as error:
        raise InvalidMessage(name, f"expected base64 text or a list of numbers: {error}") from None
