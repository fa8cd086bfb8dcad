"""What rclpy makes of bytes, and the type hashes that ROS 2's generators gave; run by its Python.

Reads ``{"types": [...], "messages": [[type name, hex], ...]}`` from stdin. Prints one object:
``hashes`` has the hash of each type and of all that it refers to or implies, ``messages`` for each
message the values that rclpy reads from the bytes, and the bytes that it makes of these values.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

PREFIXES = [*filter(None, os.getenv("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]


def hashes_of(type_name: str) -> dict[str, str]:
    files = [Path(prefix, "share", f"{type_name}.json") for prefix in PREFIXES]
    described = json.loads(next(filter(Path.exists, files)).read_text("utf-8"))
    return {each["type_name"]: each["hash_string"] for each in described["type_hashes"]}


def class_of(type_name: str) -> Any:
    """The class of a message; of a part of a service or action, too."""
    package, kind, name = type_name.split("/")
    outer, *parts = name.split("_")
    found = getattr(importlib.import_module(f"{package}.{kind}"), outer)
    for part in parts:
        inner = getattr(found, "Impl", None)
        wrapped = getattr(inner, part, None) or getattr(inner, f"{part}Service", None)
        found = wrapped or getattr(found, part)
    return found


def plain(value: Any) -> Any:
    """A value as JSON has it: fields by their names, bytes as numbers."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, (bool, int, float, str)):
        return value
    return [plain(each) for each in (value.tolist() if hasattr(value, "tolist") else value)]


def read(type_name: str, data: str) -> list[object]:
    message = deserialize_message(bytes.fromhex(data), class_of(type_name))
    return [plain(message), serialize_message(message).hex()]


def main() -> None:
    asked = json.load(sys.stdin)
    hashes: dict[str, str] = {}
    for type_name in asked["types"]:
        hashes |= hashes_of(type_name)
    messages = [read(type_name, data) for type_name, data in asked["messages"]]
    json.dump({"hashes": hashes, "messages": messages}, sys.stdout)


if __name__ == "__main__":
    main()
