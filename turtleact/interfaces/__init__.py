"""Interfaces: messages, services and actions as Python classes, and as text.

This package reads interface files and does no other I/O. It does not use an event loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.interfaces.cdr import GOAL_ID, FeedbackFormat, WireFormat, decode, encode
from turtleact.interfaces.classes import Implied, implied
from turtleact.interfaces.conversion import (
    SECOND,
    from_dict,
    nanoseconds,
    snapshot,
    snapshotter,
    stamp_of,
    to_dict,
)
from turtleact.interfaces.loading import (
    get_action,
    get_interface,
    get_message,
    get_service,
    interface_source,
    interface_text,
    known_interfaces,
    load_action,
    load_interface,
    load_interfaces,
    load_message,
    load_service,
    load_workspace,
    offer_interfaces,
)
from turtleact.interfaces.type_hash import type_hash
from turtleact.interfaces.types import (
    Action,
    Message,
    Service,
    array,
    bool_,
    bounded,
    byte,
    char,
    fields,
    float32,
    float64,
    int8,
    int16,
    int32,
    int64,
    string,
    uint8,
    uint16,
    uint32,
    uint64,
    wstring,
)

if TYPE_CHECKING:
    from turtleact.interfaces.text import from_text, to_json, to_yaml

__all__ = [
    "GOAL_ID",
    "SECOND",
    "Action",
    "FeedbackFormat",
    "Implied",
    "Message",
    "Service",
    "WireFormat",
    "array",
    "bool_",
    "bounded",
    "byte",
    "char",
    "decode",
    "encode",
    "fields",
    "float32",
    "float64",
    "from_dict",
    "from_text",
    "get_action",
    "get_interface",
    "get_message",
    "get_service",
    "implied",
    "int8",
    "int16",
    "int32",
    "int64",
    "interface_source",
    "interface_text",
    "known_interfaces",
    "load_action",
    "load_interface",
    "load_interfaces",
    "load_message",
    "load_service",
    "load_workspace",
    "nanoseconds",
    "offer_interfaces",
    "snapshot",
    "snapshotter",
    "stamp_of",
    "string",
    "to_dict",
    "to_json",
    "to_yaml",
    "type_hash",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
    "wstring",
]


def __getattr__(name: str) -> object:
    """Import ``text``, which imports PyYAML, at the first use of its functions."""
    if name in ("from_text", "to_json", "to_yaml"):
        from turtleact.interfaces import text

        return getattr(text, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
