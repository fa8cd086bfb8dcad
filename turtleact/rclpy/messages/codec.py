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
from turtleact.interfaces.loading import find_interface
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import maker, shape_of
from turtleact.rclpy.messages.fields import fitted

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
        fitted(
            field.type,
            nested,
            getattr(message, field.attribute),
            f"{path}.{field.name}".lstrip("."),
            _fitted,
        )
        for field, nested in zip(shape.fields, shape.nested, strict=True)
    ]
    return _wire_class(message_class)(*values)


def serialize_message(message: Anything) -> bytes:
    """Return a message as the bytes that ROS 2 sends."""
    return encode(message, type(message))


def deserialize_message(serialized_message: bytes, message_type: Anything) -> Anything:
    """Decode the bytes that ROS 2 sends, and return the message."""
    return decode(bytes(serialized_message), message_type)
