"""Prepares messages for the page: plain values of limited size, numbers to plot, and forms.

A message may hold a million numbers, but the page shows only a few. So the functions here look at
no more values than they return. `form` describes an action's fields, so that the page can ask for a
goal and label values. `turtleact.interfaces.comments` has the comments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, Final, TypeAlias, cast

from turtleact.interfaces import Action, Message, fields
from turtleact.interfaces.comments import comments
from turtleact.interfaces.definition import INTEGER_RANGES, Field
from turtleact.interfaces.types import nested_classes

__all__ = [
    "CHARACTERS",
    "LONGEST_TEXT",
    "MOST_PLOTTED",
    "MOST_VALUES",
    "Plain",
    "excerpt",
    "form",
    "numbers_in",
]

Plain: TypeAlias = "dict[str, Plain] | list[Plain] | str | int | float | bool | None"

MOST_VALUES: Final = 400
"""An excerpt holds at most this many numbers and texts."""

CHARACTERS: Final = 20
"""Each group of this many characters of a text counts as one more value."""

LONGEST_TEXT: Final = 1000
"""The maximum length of a text in an excerpt (characters)."""

MOST_PLOTTED: Final = 6
"""The maximum number of numbers that are plotted for a goal."""

LARGEST_EXACT: Final = 2**53
"""JavaScript rounds whole numbers beyond this limit, so they are written as text."""

NUMBERS: Final = frozenset(
    {"float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"}
)

Described: TypeAlias = dict[str, Any]


def excerpt(message: Message) -> Plain:
    """The values of a message in a form for JSON. Long lists and texts are cut.

    A cut list ends with a text that says how many values are missing.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> excerpt(Fibonacci.Result([0, 1, 1]))
    {'sequence': [0, 1, 1]}
    """
    return _Cutter().plain(message)


def numbers_in(message: Message) -> Iterator[tuple[str, float]]:
    """Yield up to `MOST_PLOTTED` numbers outside of lists, with their paths, outermost first."""
    for path, attributes in _paths(type(message)):
        value: Any = message
        for attribute in attributes:
            value = getattr(value, attribute)
        yield path, value


def form(action: type[Action]) -> Described:
    """The fields of an action's goal, result and feedback.

    Each field has ``name``, ``type``, ``default`` and ``comment``. Where they apply, it also has
    ``array`` (``form`` and ``size``), ``longest``, ``least``, ``most`` and ``fields``.
    """
    parts: dict[str, type[Message]] = {
        "goal": action.Goal,
        "result": action.Result,
        "feedback": action.Feedback,
    }
    described = {part: _described(cls, comments(cls)) for part, cls in parts.items()}
    return {"type": action.type_name, **described}


class _Cutter:
    """Makes one excerpt."""

    def __init__(self) -> None:
        self._left = MOST_VALUES

    def plain(self, value: object) -> Plain:
        if isinstance(value, Message):
            return {
                field.name: self.plain(getattr(value, field.attribute))
                for field in fields(type(value))
            }
        if isinstance(value, str):
            return self._text(value)
        if isinstance(value, bool | int | float):
            self._left -= 1
            is_exact = isinstance(value, float) or -LARGEST_EXACT <= value <= LARGEST_EXACT
            return value if is_exact else str(value)
        return self._items(cast("Sequence[object]", value))

    def _text(self, value: str) -> str:
        most = min(LONGEST_TEXT, max(0, self._left) * CHARACTERS)
        shown = value[:most]
        self._left -= 1 + len(shown) // CHARACTERS
        return shown if shown == value else f"{shown}… {len(value) - most} more"

    def _items(self, values: Sequence[object]) -> list[Plain]:
        shown: list[Plain] = []
        for value in _first(values, self._left):
            if self._left <= 0:
                break
            shown.append(self.plain(value))
        missing = len(values) - len(shown)
        return [*shown, f"… {missing} more"] if missing else shown


def _first(values: Sequence[object], count: int) -> list[object]:
    """The first values of a list, of bytes, or of an array in a decoded message."""
    some = values[: max(0, count)]
    return cast("list[object]", some.tolist()) if hasattr(some, "tolist") else list(some)


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
