"""What the page shows of a message: plain values of bounded size, and the numbers to plot.

A message may hold a million numbers, and the page shows a few of them. So nothing here looks at
more than it returns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, Final, TypeAlias, cast

from turtleact.interfaces import Message, fields
from turtleact.interfaces.types import nested_classes

__all__ = [
    "CHARACTERS",
    "LONGEST_TEXT",
    "MOST_PLOTTED",
    "MOST_VALUES",
    "Plain",
    "excerpt",
    "numbers_in",
]

Plain: TypeAlias = "dict[str, Plain] | list[Plain] | str | int | float | bool | None"

MOST_VALUES: Final = 400
"""An excerpt holds at most this many numbers and texts."""

CHARACTERS: Final = 20
"""So many characters of a text count as one more value."""

LONGEST_TEXT: Final = 1000
"""The maximum length of a text in an excerpt (characters)."""

MOST_PLOTTED: Final = 6
"""The maximum number of numbers that are plotted for a goal."""

LARGEST_EXACT: Final = 2**53
"""JavaScript rounds whole numbers beyond this one, so they are written as text."""

NUMBERS: Final = frozenset(
    {"float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"}
)


def excerpt(message: Message) -> Plain:
    """The values of a message as JSON can write them; long lists and texts are cut.

    A cut list ends with a text that says how many values are missing.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> excerpt(Fibonacci.Result([0, 1, 1]))
    {'sequence': [0, 1, 1]}
    """
    return _Cutter().plain(message)


def numbers_in(message: Message) -> Iterator[tuple[str, float]]:
    """Up to `MOST_PLOTTED` numbers outside of lists, by path; the outermost come first."""
    for path, attributes in _paths(type(message)):
        value: Any = message
        for attribute in attributes:
            value = getattr(value, attribute)
        yield path, value


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
    """The first values of a list, of bytes, or of an array as decoded messages hold it."""
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
