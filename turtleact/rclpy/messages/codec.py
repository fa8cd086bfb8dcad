"""Encodes and decodes messages of the classes of `turtleact.rclpy.messages.classes` as CDR.

turtleact's own codecs need only the declaration of a class, so they work for these classes, too. If
a codec rejects a value that rclpy would accept, this module converts the value. If rclpy would also
reject the value, this module raises a TypeError.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import cast

from turtleact.errors import InvalidMessage
from turtleact.interfaces import type_hash
from turtleact.interfaces.cdr import BYTE_ORDERS, HEADER, MISREAD, UNFIT, decoder, encoder
from turtleact.interfaces.definition import INTEGER_RANGES, ArrayForm, Field, FieldType
from turtleact.interfaces.loading import find_interface
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import maker, shape_of
from turtleact.rclpy.messages.fields import TYPECODES, sequence_of

__all__ = ["decode", "deserialize_message", "encode", "hash_of", "serialize_message"]


def encode(message: Anything, message_class: Anything) -> bytes:
    """Encode a message.

    Raises:
        TypeError: if the message is of another class, or a value does not fit its field.
    """
    if type(message) is not message_class:
        raise TypeError(
            f"Expected {message_class.__module__}.{message_class.__name__}, got {type(message)}"
        )
    try:
        return _encoder(message_class)(message)
    except UNFIT:
        return encoder(_wire_class(message_class))(_fitted(message, message_class, ""))


def decode(data: bytes, message_class: Anything) -> Anything:
    """Decode a message.

    Raises:
        InvalidMessage: if the bytes are not a message of ``message_class``.
    """
    order = BYTE_ORDERS.get(data[:2])
    if order is None or len(data) < len(HEADER):
        raise InvalidMessage("message", f"not plain CDR: its header is {data[:4].hex()}")
    try:
        return decoder(cast("Anything", maker(message_class)), order, "array")(data)
    except MISREAD as error:
        raise InvalidMessage("message", f"not a {shape_of(message_class).type_name}") from error


@functools.cache
def hash_of(type_name: str) -> str:
    """Return the type hash of an interface."""
    return type_hash(find_interface(type_name))


def _encoder(message_class: Anything) -> Callable[..., bytes]:
    return encoder(message_class)


def _wire_class(message_class: Anything) -> Anything:
    """Return turtleact's own class for the interface of ``message_class``."""
    return find_interface(shape_of(message_class).type_name)


def _fitted(message: Anything, message_class: Anything, path: str) -> Anything:
    """Return a message of turtleact's own class with the converted values of ``message``."""
    shape = shape_of(message_class)
    if not isinstance(message, message_class):
        expected = f"{message_class.__module__}.{message_class.__name__}"
        raise TypeError(f"{path or 'message'}: expected {expected}, got {type(message)}")
    values = [
        _fitted_field(field, nested, getattr(message, field.attribute), f"{path}.{field.name}")
        for field, nested in zip(shape.fields, shape.nested, strict=True)
    ]
    return _wire_class(message_class)(*values)


def _fitted_field(field: Field, nested: Anything, value: Anything, path: str) -> object:
    if not field.type.is_sequence:
        return _fitted_value(field.type, nested, value, path)
    if field.type.name in TYPECODES:
        if isinstance(value, str):
            raise TypeError(f"{path}: expected numbers, got {value!r}")
        return _sized(field.type, _converted(field.type, value, path), path)
    if isinstance(value, str) or not hasattr(value, "__iter__"):
        raise TypeError(f"{path}: expected a sequence, got {type(value)}")
    element = field.type.element
    values = [_fitted_value(element, nested, each, path) for each in value]
    return _sized(field.type, values, path)


def _converted(field_type: FieldType, value: Anything, path: str) -> list[object]:
    try:
        listed: list[object] = cast("Anything", sequence_of(field_type)(value)).tolist()
    except (TypeError, ValueError, OverflowError) as error:
        raise TypeError(f"{path}: {error}") from error
    return listed


def _sized(field_type: FieldType, values: list[object], path: str) -> object:
    size, form = field_type.size, field_type.form
    if form is ArrayForm.FIXED and len(values) != size:
        raise TypeError(f"{path}: expected {size} elements, got {len(values)}")
    if form is ArrayForm.BOUNDED and len(values) > size:
        raise TypeError(f"{path}: expected at most {size} elements, got {len(values)}")
    return values


def _fitted_value(field_type: FieldType, nested: Anything, value: Anything, path: str) -> object:
    kind = field_type.name
    if nested is not None:
        return _fitted(value, nested, path)
    if kind == "byte" and isinstance(value, bytes) and len(value) == 1:
        return value[0]
    if kind == "bool" and (isinstance(value, bool) or type(value).__name__ in ("bool", "bool_")):
        return bool(value)
    if field_type.is_string and isinstance(value, str):
        bound = field_type.string_bound
        if bound is None or len(value) <= bound:
            return str(value)
    elif kind in INTEGER_RANGES and hasattr(value, "__index__"):
        low, high = INTEGER_RANGES[kind]
        if low <= (number := value.__index__()) <= high:
            return number
    elif kind in ("float32", "float64") and hasattr(value, "__float__"):
        return float(value)
    raise TypeError(f"{path.lstrip('.')}: a {field_type} cannot be {value!r}")


def serialize_message(message: Anything) -> bytes:
    """Return a message as the bytes that ROS 2 sends."""
    return encode(message, type(message))


def deserialize_message(serialized_message: bytes, message_type: Anything) -> Anything:
    """Decode the bytes that ROS 2 sends, and return the message."""
    return decode(bytes(serialized_message), message_type)
