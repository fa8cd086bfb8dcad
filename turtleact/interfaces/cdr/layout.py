"""Computes where values are in CDR data.

Consecutive values of fixed size form a *run*, which ``struct`` reads or writes in one call. The
padding in a run depends on the place where the run starts. If the place is known in advance, the
run has one ``Struct``. Otherwise, the run has eight: one for each remainder of the place modulo 8.
Places are counted from the start of the data, which begins with the header. Alignment is counted
from the end of the header.
"""

from __future__ import annotations

import functools
import struct
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from turtleact.interfaces.definition import BYTE_TYPES, ArrayForm
from turtleact.interfaces.types import Message, fields, nested_classes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from typing import Any

    from turtleact.interfaces.definition import Field, FieldType

__all__ = [
    "ANYWHERE",
    "BYTE_ORDERS",
    "COUNT",
    "EMPTY",
    "FORMATS",
    "HEADER",
    "HEADER_SIZE",
    "WIDEST",
    "Item",
    "Places",
    "Runs",
    "code_in_run",
    "common_alignment",
    "common_run",
    "is_in_run",
    "is_inlined",
    "members",
    "padding",
    "phases",
    "places_after",
    "places_aligned",
    "places_in_steps",
    "run",
    "size_of",
]

#: The header of written data: plain CDR, little endian, no options.
HEADER = b"\x00\x01\x00\x00"
HEADER_SIZE = len(HEADER)

#: The first two bytes of a header, and the byte order's name in ``struct``.
BYTE_ORDERS = {b"\x00\x01": "<", b"\x00\x00": ">"}

#: The format characters of ``struct`` for primitive types of fixed size.
FORMATS = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}

#: The format of the length before a string or sequence.
COUNT = "I"
#: The format of a message without fields: one byte.
EMPTY = "x"
#: The largest alignment.
WIDEST = 8

#: Where something may begin, modulo the largest alignment.
Places: TypeAlias = frozenset[int]

#: All places.
ANYWHERE: Places = frozenset(range(WIDEST))

#: Runs are cached for this many different numbers of values.
MOST_RUNS = 256

#: A message with a greater `weight` than this gets a function of its own.
MOST_INLINED = 64


class Item(NamedTuple):
    """One value of a run.

    Attributes:
        code: The value's format in ``struct``.
        text: The variable or expression of the value in the generated code; empty for padding.
    """

    code: str
    text: str = ""


def size_of(code: str) -> int:
    """Return the size of a value with this format of ``struct``, in bytes."""
    return struct.calcsize(f"<{code}")


def alignment(code: str) -> int:
    """Return the alignment of a value in bytes. It is 1 for a string of bytes."""
    return 1 if code[-1] == "s" else size_of(code)


def padding(place: int, size: int) -> int:
    """Return how many bytes of padding come at this place before a value of this size."""
    return (HEADER_SIZE - place) % size


def run(order: str, items: Iterable[Item], place: int) -> struct.Struct:
    """Return the ``Struct`` for adjacent values that start at the offset ``place``.

    ``order`` is the byte order, ``<`` or ``>``.
    """
    text, at = order, place
    for code, _ in items:
        pad = padding(at, alignment(code))
        text += f"{pad}x{code}"
        at += pad + size_of(code)
    return struct.Struct(text)


def phases(order: str, items: Sequence[Item]) -> list[struct.Struct]:
    """Return eight ``Struct`` objects for adjacent values: one for each start offset modulo 8."""
    return [run(order, items, place) for place in range(WIDEST)]


def common_run(order: str, items: Sequence[Item], places: Places) -> struct.Struct | None:
    """Return the ``Struct`` for adjacent values that may start at any offset in ``places``.

    The result is None if the padding differs between the offsets.
    """
    runs = [run(order, items, place) for place in places]
    return runs[0] if len({each.format for each in runs}) == 1 else None


def places_after(items: Sequence[Item], places: Places) -> Places:
    """Return the possible end offsets of adjacent values that start at an offset in ``places``."""
    return frozenset((place + run("<", items, place).size) % WIDEST for place in places)


def places_aligned(size: int, places: Places) -> Places:
    """Add to ``places`` the offsets after the padding before a value of this size."""
    return places | {(place + padding(place, size)) % WIDEST for place in places}


def places_in_steps(size: int, places: Places) -> Places:
    """Return the offsets at which a sequence that starts at an offset in ``places`` may end.

    ``size`` is the size of each element.
    """
    steps = range(0, WIDEST, min(size, WIDEST))
    return frozenset((place + step) % WIDEST for place in places for step in steps)


class Runs(dict[int, "Callable[..., Any]"]):
    """Maps a number N to the method that reads or writes a run, then N values of one type.

    A run consists of adjacent values of fixed size.

    Args:
        method: The name of a method of ``struct.Struct``: ``pack`` or ``unpack_from``.
        order: The byte order, ``<`` or ``>``.
        items: The values of the run.
        place: Where the run starts, modulo 8.
        code: The format character of the N values.

    Attributes:
        place: Where the run starts, modulo 8.
        code: The format character of the N values.
    """

    def __init__(
        self, method: str, order: str, items: Sequence[Item], place: int, code: str
    ) -> None:
        super().__init__()
        self._method = method
        self._order = order
        self._items = tuple(items)
        self.place = place
        self.code = code

    def __missing__(self, count: int) -> Callable[..., Any]:
        """Make the method for adjacent values of fixed size, followed by ``count`` values.

        Only the first `MOST_RUNS` methods are stored.
        """
        items = [*self._items, Item(self.code)] if count else self._items
        text = run(self._order, items, self.place).format
        made = struct.Struct(f"{text}{count - 1}{self.code}" if count > 1 else text)
        method: Callable[..., Any] = getattr(made, self._method)
        if len(self) < MOST_RUNS:
            self[count] = method
        return method


def members(cls: type[Message]) -> Iterator[tuple[Field, type[Message] | None]]:
    """Return pairs of a field and its message class. The class is None for a primitive field."""
    return zip(fields(cls), nested_classes(cls), strict=True)


def is_in_run(field_type: FieldType) -> bool:
    """Whether ``struct`` can read or write a field together with its neighbours.

    This is true for a number, a bool and a fixed array of bytes.
    """
    if field_type.form is ArrayForm.FIXED:
        return field_type.name in BYTE_TYPES
    return not field_type.is_sequence and field_type.name in FORMATS


def code_in_run(field_type: FieldType) -> str:
    """Return the ``struct`` format of a field that is part of a run."""
    if field_type.is_sequence:
        return f"{field_type.size}s"
    return FORMATS[field_type.name]


@functools.cache
def weight(cls: type[Message]) -> int:
    """Return the number of fields in a message, plus one. The fields of nested messages count.

    A sequence of messages counts as one field.
    """
    return 1 + sum(
        1 if nested is None or field.type.is_sequence else weight(nested)
        for field, nested in members(cls)
    )


def is_inlined(cls: type[Message]) -> bool:
    """Whether the code for this class is inlined in the code for a class that contains it."""
    return weight(cls) <= MOST_INLINED


def row(cls: type[Message]) -> list[Item] | None:
    """Return the values of a message if one ``struct`` call can handle all; otherwise None."""
    if not is_inlined(cls):
        return None
    items: list[Item] = []
    for field, nested in members(cls):
        if is_in_run(field.type):
            items.append(Item(code_in_run(field.type)))
            continue
        inner = None if nested is None or field.type.is_sequence else row(nested)
        if inner is None:
            return None
        items += inner
    return items or [Item(EMPTY)]


def common_alignment(cls: type[Message], *, counted: bool) -> int:
    """Return the alignment of the messages in a sequence; 0 if their layouts may differ.

    Args:
        cls: The class of the messages.
        counted: Whether the length of the sequence comes before the messages. If so, the first
            message starts at a multiple of 4 bytes, because the length ends at one.
    """
    items = row(cls)
    if items is None:
        return 0
    widest = max(alignment(code) for code, _ in items)
    first = max(alignment(items[0].code), size_of(COUNT) if counted else 1)
    is_even = first >= widest and run("<", items, HEADER_SIZE).size % widest == 0
    return widest if is_even else 0
