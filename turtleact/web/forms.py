"""What the page needs to make a form for an action, and to label its values.

Comments come from where the author of the interface wrote them: beside a field in a .action or .msg
file, or under ``Attributes:`` in the docstring of a class.

Source: the ROS 2 article "Interface definition" for comments; Google's style of docstrings.
"""

from __future__ import annotations

import inspect
import re
from functools import cache
from typing import Any, TypeAlias

from turtleact.errors import TurtleactError
from turtleact.interfaces import Action, Message, fields, interface_source
from turtleact.interfaces.definition import INTEGER_RANGES, Field
from turtleact.interfaces.types import nested_classes
from turtleact.web.excerpts import excerpt

__all__ = ["comments", "form"]

Described: TypeAlias = dict[str, Any]

field_pattern = re.compile(r"\s*[\w/]+(?:<=\d+)?(?:\[[^\]]*\])?\s+([a-z]\w*)[^#]*(?:#\s*(.*))?")
attribute_pattern = re.compile(r" {4}(\w+): (.*)")


def form(action: type[Action]) -> Described:
    """The fields of an action's goal, result and feedback.

    Each field has ``name``, ``type``, ``default`` and ``comment``, and where they apply ``array``
    (``form`` and ``size``), ``longest``, ``least`` and ``most``, and ``fields``.
    """
    parts: dict[str, type[Message]] = {
        "goal": action.Goal,
        "result": action.Result,
        "feedback": action.Feedback,
    }
    notes = _notes_in_file(action.type_name, len(parts))
    described = {
        part: _described(cls, comments(cls) | note)
        for (part, cls), note in zip(parts.items(), notes, strict=True)
    }
    return {"type": action.type_name, **described}


def comments(cls: type[Message]) -> dict[str, str]:
    """The comments on a message's fields.

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
def _notes_in_file(type_name: str, parts: int) -> list[dict[str, str]]:
    """The comments in each part of an interface's file."""
    try:
        text = interface_source(type_name)
    except TurtleactError:  # the class was made by hand
        text = ""
    sections = re.split(r"^---\s*$", text, flags=re.MULTILINE)
    notes = [
        {match[1]: match[2] for line in section.splitlines() if (match := _noted(line))}
        for section in sections[:parts]
    ]
    return notes + [{}] * (parts - len(notes))


def _noted(line: str) -> re.Match[str] | None:
    """A line that declares a field and has a comment."""
    match = field_pattern.fullmatch(line)
    return match if match and match[2] else None


def _described(cls: type[Message], notes: dict[str, str]) -> list[Described]:
    defaults: Any = excerpt(cls())
    return [
        _field(field, nested, defaults[field.name], notes.get(field.name, ""))
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    ]


def _field(field: Field, nested: type[Message] | None, default: object, comment: str) -> Described:
    kind = field.type
    said: Described = {
        "name": field.name,
        "type": kind.name,
        "default": default,
        "comment": comment,
    }
    if kind.is_sequence:
        said["array"] = {"form": kind.form.name.lower(), "size": kind.size}
    if kind.string_bound is not None:
        said["longest"] = kind.string_bound
    if kind.name in INTEGER_RANGES:  # as text: JavaScript would round the largest
        least, most = INTEGER_RANGES[kind.name]
        said |= {"least": str(least), "most": str(most)}
    if nested is not None:
        notes = comments(nested) | _notes_in_file(nested.type_name, 1)[0]
        said["fields"] = _described(nested, notes)
    return said
