"""Finds the comments on the fields of an interface, where its author wrote them.

In a .msg, .srv or .action file, the comment on a field stands beside the field or on the lines
directly above it. In a class, the comment stands under ``Attributes:`` in the docstring.

Source: the ROS 2 article "Interface definition" for comments; Google's style of docstrings.
"""

from __future__ import annotations

import inspect
import re
from functools import cache

from turtleact.errors import TurtleactError
from turtleact.interfaces.loading import interface_source
from turtleact.interfaces.types import Action, Message, Service

__all__ = ["comments", "introduction"]

field_pattern = re.compile(
    r"\s*[\w/]+(?:<=\d+)?(?:\[[^\]]*\])?\s+(?P<name>[a-z]\w*)(?P<value>[^#]*)(?:#\s*(?P<note>.*))?"
)
attribute_pattern = re.compile(r" {4}(\w+): (.*)")


def comments(cls: type[Message]) -> dict[str, str]:
    """The comments on a message's fields, by field.

    A comment in a file takes precedence over one in a docstring.

    >>> class Move(Message, type_name="example_msgs/msg/Move"):
    ...     '''A move.
    ...
    ...     Attributes:
    ...         speed: How fast to go
    ...             at most (m/s).
    ...     '''
    ...
    ...     speed: float = 1.0
    >>> comments(Move)
    {'speed': 'How fast to go at most (m/s).'}
    """
    whole, _, part = cls.type_name.rpartition("_")
    index = PARTS.get(part)
    if index is None or whole.count("/") != 2:
        whole, index = cls.type_name, 0
    return _in_docstring(cls) | dict(_in_file(whole)[index])


PARTS = {"Goal": 0, "Result": 1, "Feedback": 2, "Request": 0, "Response": 1}


def introduction(cls: type[Message | Service | Action]) -> str:
    """What an interface is for: the first paragraph of its docstring.

    The text is empty if the class has no docstring of its own.
    """
    doc = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
    return " ".join(doc.partition("\n\n")[0].split())


def _in_docstring(cls: type[Message]) -> dict[str, str]:
    doc = inspect.cleandoc(cls.__doc__ or "")
    found: dict[str, str] = {}
    name = ""
    for line in doc.partition("Attributes:\n")[2].splitlines():
        begun = attribute_pattern.fullmatch(line)
        if begun:
            name = begun[1]
            found[name] = begun[2]
        elif not line.startswith(" " * 8):
            break
        else:
            found[name] += f" {line.strip()}"
    return found


@cache
def _in_file(type_name: str) -> tuple[dict[str, str], ...]:
    """The comments in each part of an interface's file; always three parts."""
    try:
        text = interface_source(type_name)
    except TurtleactError:  # the class was made by hand
        text = ""
    sections = re.split(r"^---\s*$", text, flags=re.MULTILINE)[:3]
    notes = [_in_section(section) for section in sections]
    return (*notes, *({} for _ in range(3 - len(notes))))


def _in_section(section: str) -> dict[str, str]:
    """The comment of each field: the one beside the field, or else the lines directly above it."""
    found: dict[str, str] = {}
    above: list[str] = []
    for line in section.splitlines():
        text = line.strip()
        if text.startswith("#"):
            above.append(text.lstrip("#").strip())
            continue
        match = field_pattern.fullmatch(line)
        note = (match["note"] or " ".join(filter(None, above))) if match else ""
        if match and note:
            found[match["name"]] = note
        above = []
    return found
