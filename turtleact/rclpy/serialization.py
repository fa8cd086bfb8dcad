"""Converts messages to bytes and back."""

from __future__ import annotations

from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.codec import decode, encode

__all__ = ["deserialize_message", "serialize_message"]


def serialize_message(message: Anything) -> bytes:
    """Return a message as the bytes that ROS 2 sends."""
    return encode(message, type(message))


def deserialize_message(serialized_message: bytes, message_type: Anything) -> Anything:
    """Decode the bytes that ROS 2 sends, and return the message."""
    return decode(bytes(serialized_message), message_type)
