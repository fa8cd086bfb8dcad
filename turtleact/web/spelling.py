"""Names and types as clients of rosbridge spell them, and what they mean here.

A name comes with or without its leading slash, a type as ``pkg/Name``, ``pkg/msg/Name`` or, from
DDS, ``pkg::msg::dds_::Name_``. Pure text and a look into what is known of interfaces.

Source: rosbridge v2; the ROS 2 article "Topic and Service name mapping to DDS".
"""

from __future__ import annotations

from typing import Literal, cast

from turtleact.errors import InvalidName, UnknownInterface
from turtleact.interfaces import Action, Message, Service, get_interface
from turtleact.names import resolve_name

__all__ = ["Kind", "absolute", "action_class", "message_class", "service_class", "type_name"]

Kind = Literal["msg", "srv", "action"]
Interface = type[Message] | type[Service] | type[Action]

LONGEST = 255
"""Longest name of a topic, service, action or type, as in DDS (characters)."""


def absolute(name: str) -> str:
    """The absolute form of the name of a topic, service or action.

    Raises:
        InvalidName: if it breaks ROS 2's rules, or is longer than `LONGEST`.

    >>> absolute("turtle1/pose")
    '/turtle1/pose'
    """
    if len(name) > LONGEST:
        shown = f"{name[:40]}…"
        raise InvalidName(shown, f"{len(name)} characters are too many: at most {LONGEST}", 40)
    return resolve_name(name)


def type_name(spelled: str, kind: Kind) -> str:
    """The full name of a type; what has no known form stays as it is.

    >>> type_name("turtlesim/Pose", "msg"), type_name("turtlesim::msg::dds_::Pose_", "msg")
    ('turtlesim/msg/Pose', 'turtlesim/msg/Pose')
    """
    parts = [part for part in spelled.replace("::", "/").split("/") if part != "dds_"]
    if "::" in spelled:
        parts[-1] = parts[-1].removesuffix("_")
    if len(parts) == 2:
        parts.insert(1, kind)
    return "/".join(parts)


def message_class(spelled: str) -> type[Message]:
    """The class of a message.

    Raises:
        UnknownInterface: if there is none of that name.
        InvalidInterface: if the file that holds it is malformed.
    """
    return cast("type[Message]", _class(spelled, "msg", Message))


def service_class(spelled: str) -> type[Service]:
    """The class of a service; raises as `message_class` does."""
    return cast("type[Service]", _class(spelled, "srv", Service))


def action_class(spelled: str) -> type[Action]:
    """The class of an action; raises as `message_class` does."""
    return cast("type[Action]", _class(spelled, "action", Action))


def _class(spelled: str, kind: Kind, base: type) -> Interface:
    if len(spelled) > LONGEST:
        raise UnknownInterface(f"{spelled[:40]}…")
    name = type_name(spelled, kind)
    found = get_interface(name)
    if not issubclass(found, base):
        raise UnknownInterface(name)
    return found
