"""What the page needs to make a form for an action, and to label its values.

`turtleact.interfaces.comments` has the comments.
"""

from __future__ import annotations

from typing import Any, TypeAlias

from turtleact.interfaces import Action, Message, fields
from turtleact.interfaces.comments import comments
from turtleact.interfaces.definition import INTEGER_RANGES, Field
from turtleact.interfaces.types import nested_classes
from turtleact.web.excerpts import excerpt

__all__ = ["form"]

Described: TypeAlias = dict[str, Any]


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
    described = {part: _described(cls, comments(cls)) for part, cls in parts.items()}
    return {"type": action.type_name, **described}


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
        said["fields"] = _described(nested, comments(nested))
    return said
