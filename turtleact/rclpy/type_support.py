"""Checks that a class is the class of a message, service or action."""

from __future__ import annotations

from turtleact.rclpy.exceptions import NoTypeSupportImportedException
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import is_interface

__all__ = [
    "check_for_type_support",
    "check_is_valid_action_type",
    "check_is_valid_msg_type",
    "check_is_valid_srv_type",
]

HINT = (
    " This might be a ROS 1 message type but it should be a ROS 2 message type."
    " Make sure to source your ROS 2 workspace after your ROS 1 workspace."
)


def check_for_type_support(msg_or_srv_type: Anything) -> None:
    """Check that an object is the class of a message, service or action.

    Raises:
        AttributeError: if the object is not the class of a message, service or action.
        NoTypeSupportImportedException: if the class is from the genuine ROS, and ROS has not loaded
            its type support.
    """
    if is_interface(msg_or_srv_type):
        return
    metaclass: Anything = type(msg_or_srv_type)
    support = vars(metaclass).get("_TYPE_SUPPORT", HINT)
    if support is HINT:
        raise AttributeError(f"{msg_or_srv_type!r} has no type support.{HINT}")
    if support is None:
        raise NoTypeSupportImportedException


def _check(interface: Anything, parts: tuple[str, ...], noun: str) -> None:
    check_for_type_support(interface)
    if not all(hasattr(interface, part) for part in parts):
        raise RuntimeError(
            f"The {noun} type provided is not valid ({interface})"
            f"{' this may be a message' if parts else ' this may be a service or action'}"
        )


def check_is_valid_msg_type(msg_type: Anything) -> None:
    """Check that a class is a message class. Raise RuntimeError for a service or action."""
    _check(msg_type, (), "message")
    if hasattr(msg_type, "type_name"):
        raise RuntimeError(
            f"The message type provided is not valid ({msg_type}) this may be a service or action"
        )


def check_is_valid_srv_type(srv_type: Anything) -> None:
    """Check that a class is a service class. Raise RuntimeError for a message or action."""
    _check(srv_type, ("Request", "Response"), "service")


def check_is_valid_action_type(action_type: Anything) -> None:
    """Check that a class is an action class. Raise RuntimeError for a message or service."""
    _check(action_type, ("Goal", "Result", "Feedback"), "action")
