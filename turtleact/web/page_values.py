"""Prepares messages for the page: excerpts, numbers to plot, and descriptions of fields.

A message may hold a million numbers, but the page shows only a few. To save time, the functions of
this module read only the values that they return. `form` describes an action's fields, so that the
page can show input fields for a goal, and can label values. The comments in this description come
from `turtleact.interfaces.loading`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any, Final, TypeAlias

from turtleact.interfaces import Action, Message, fields
from turtleact.interfaces.definition import INTEGER_RANGES, Constant, Field
from turtleact.interfaces.loading import comments
from turtleact.interfaces.types import are_flags, choices, named_values, nested_classes
from turtleact.sim.pictures import hue_of

__all__ = [
    "LONGEST_TEXT",
    "MOST_ITEMS",
    "MOST_PLOTTED",
    "Plain",
    "excerpt",
    "form",
    "hues",
    "numbers_in",
]

Plain: TypeAlias = "dict[str, Plain] | list[Plain] | str | int | float | bool | None"

MOST_ITEMS: Final = 100
"""Each list in an excerpt has at most this many items."""

LONGEST_TEXT: Final = 1000
"""The maximum length of a text in an excerpt (characters)."""

MOST_PLOTTED: Final = 6
"""The maximum number of numbers that are plotted for a goal."""

LARGEST_EXACT: Final = 2**53
"""JavaScript rounds whole numbers beyond this limit, so they are written as text."""

NUMBERS: Final = frozenset(
    {"float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"}
)

QUOTED_WORD: Final = re.compile(r"``([\w-]+)``")

Described: TypeAlias = dict[str, Any]


def excerpt(value: object) -> Plain:
    """Return the values of a message, ready for JSON. Long lists and texts are cut.

    A cut list or text ends with the number of items or characters that are missing.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> excerpt(Fibonacci.Result([0, 1, 1]))
    {'sequence': [0, 1, 1]}
    """
    if isinstance(value, Message):
        return {
            field.name: excerpt(getattr(value, field.attribute)) for field in fields(type(value))
        }
    if isinstance(value, str):
        missing = len(value) - LONGEST_TEXT
        return f"{value[:LONGEST_TEXT]}… {missing} more" if missing > 0 else value
    if isinstance(value, bool | int | float):
        is_exact = isinstance(value, float) or -LARGEST_EXACT <= value <= LARGEST_EXACT
        return value if is_exact else str(value)
    # A list, bytes, or an array in a decoded message.
    items: Any = value
    some = items[:MOST_ITEMS]
    shown = [excerpt(each) for each in (some.tolist() if hasattr(some, "tolist") else some)]
    missing = len(items) - len(shown)
    return [*shown, f"… {missing} more"] if missing else shown


def numbers_in(message: Message) -> Iterator[tuple[str, float]]:
    """Yield numbers of a message with their paths, at most `MOST_PLOTTED`.

    Numbers in lists are left out. Numbers of nested messages come after the message's own numbers.
    """
    for path, attributes in _paths(type(message)):
        value: Any = message
        for attribute in attributes:
            value = getattr(value, attribute)
        yield path, value


def hues(topics: Iterable[str]) -> dict[str, int]:
    """The hues of turtles (degrees), by the topics of their poses.

    >>> hues(["/turtle1/pose"])
    {'/turtle1/pose': 145}
    """
    return {topic: hue_of(topic.removesuffix("/pose").removeprefix("/")) for topic in topics}


def form(action: type[Action]) -> Described:
    """Describe the fields of an action's goal, result and feedback.

    Each field has ``name``, ``type``, ``default`` and ``comment``. Some fields have more members:

    - ``array``: the ``form`` and ``size`` of a list.
    - ``longest``: the maximum length of a text.
    - ``least`` and ``most``: the range of a whole number, as text.
    - ``fields``: the fields of a nested message.
    - ``values``: the values that the field is limited to. Each is a pair of the value and its
      label, both as text.
    - ``suggested``: pairs of values and labels, for a field that may also have other values. For a
      text field without constants, each word that the field's comment quotes is both value and
      label.
    """
    parts: dict[str, type[Message]] = {
        "goal": action.Goal,
        "result": action.Result,
        "feedback": action.Feedback,
    }
    described = {part: _described(cls, comments(cls)) for part, cls in parts.items()}
    return {"type": action.type_name, **described}


@cache
def _paths(cls: type[Message]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    outermost_first = sorted(_walk(cls, "", ()), key=lambda found: len(found[1]))
    return tuple(outermost_first)[:MOST_PLOTTED]


def _walk(
    cls: type[Message], prefix: str, attributes: tuple[str, ...]
) -> Iterator[tuple[str, tuple[str, ...]]]:
    for field, nested in zip(fields(cls), nested_classes(cls), strict=True):
        path, here = f"{prefix}{field.name}", (*attributes, field.attribute)
        if field.type.is_sequence:
            continue
        if nested is not None:
            yield from _walk(nested, f"{path}.", here)
        elif field.type.name in NUMBERS:
            yield path, here


def _described(cls: type[Message], notes: dict[str, str]) -> list[Described]:
    defaults: Any = excerpt(cls())
    return [
        _field(field, nested, defaults[field.name], notes.get(field.name, ""))
        | _named(cls, field, notes.get(field.name, ""))
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


def _named(cls: type[Message], field: Field, comment: str) -> Described:
    """Describe the named values of a field. Flags are left out, because they may be combined."""
    limited, named = choices(cls, field), named_values(cls, field)
    if limited:
        return {"values": _labelled(field, limited)}
    if named and field.type.name != "bool" and not are_flags(named):
        return {"suggested": _labelled(field, named)}
    words = QUOTED_WORD.findall(comment) if field.type.name == "string" else []
    return {"suggested": [(word, word) for word in words]} if len(words) > 1 else {}


def _labelled(field: Field, named: list[Constant]) -> list[tuple[str, str]]:
    """Return each value as text, and its label."""
    prefix = f"{field.name.upper()}_"
    labels = [
        constant.value or "(empty)"
        if isinstance(constant.value, str)
        else f"{constant.name.removeprefix(prefix).lower()} ({constant.value})"
        for constant in named
    ]
    values = [str(constant.value) for constant in named]
    return list(zip(values, labels, strict=True))
