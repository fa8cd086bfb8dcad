"""Where values stand in CDR, and the text of functions that read or write them.

Values of fixed size that follow each other are a *run*, which ``struct`` reads or writes in one
call. The padding in a run depends on where it starts: a run at a place that is known beforehand has
one ``Struct``, any other run eight, by its place modulo 8. Places are counted from the start of the
data, where the header stands; alignment is counted from its end.
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
    "Source",
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

#: The header of what is written: plain CDR, little endian, no options.
HEADER = b"\x00\x01\x00\x00"
HEADER_SIZE = len(HEADER)

#: The first two bytes of a header, and what ``struct`` calls that order.
BYTE_ORDERS = {b"\x00\x01": "<", b"\x00\x00": ">"}

#: What ``struct`` calls each primitive type of fixed size.
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

#: The length before a string or a sequence.
COUNT = "I"
#: What stands for the fields of a message that has none: one byte.
EMPTY = "x"
#: The largest alignment.
WIDEST = 8

#: Where something may stand, modulo the largest alignment.
Places: TypeAlias = frozenset[int]

#: Every place.
ANYWHERE: Places = frozenset(range(WIDEST))

#: So many numbers of values have a run of their own.
MOST_RUNS = 256

#: A message of more fields than this, those of the messages in it included, is a function's call.
MOST_INLINED = 64


class Item(NamedTuple):
    """One value of a run.

    Attributes:
        code: What ``struct`` calls it.
        text: In the generated text, its variable or expression; empty where it has no value.
    """

    code: str
    text: str = ""


class Source:
    """The text of a function as it grows, and the objects that it names."""

    def __init__(self, signature: str) -> None:
        self.lines = [f"def function({signature}):"]
        self.names: dict[str, object] = {}
        self.count = 0
        self.depth = 1

    def add(self, line: str) -> None:
        """Adds a statement."""
        self.lines.append(" " * self.depth + line)

    def fresh(self, prefix: str = "v") -> str:
        """A name that is not used yet."""
        self.count += 1
        return f"{prefix}{self.count}"

    def hold(self, value: object) -> str:
        """A name for an object."""
        name = self.fresh("k")
        self.names[name] = value
        return name

    def function(self) -> Callable[..., object]:
        """The function. The text is made of field names, which are identifiers, and of numbers."""
        exec("\n".join(self.lines), self.names)  # noqa: S102
        return self.names["function"]  # type: ignore[return-value]  # the text defines it


def size_of(code: str) -> int:
    """The size of a value in bytes."""
    return struct.calcsize(f"<{code}")


def alignment(code: str) -> int:
    """A value starts at a multiple of this; strings of bytes anywhere."""
    return 1 if code[-1] == "s" else size_of(code)


def padding(place: int, size: int) -> int:
    """How many bytes are left out at this place before a value that is aligned to its size."""
    return (HEADER_SIZE - place) % size


def run(order: str, items: Iterable[Item], place: int) -> struct.Struct:
    """What reads or writes these values, starting at a place, in ``<`` or ``>`` byte order."""
    text, at = order, place
    for code, _ in items:
        pad = padding(at, alignment(code))
        text += f"{pad}x{code}"
        at += pad + size_of(code)
    return struct.Struct(text)


def phases(order: str, items: Sequence[Item]) -> list[struct.Struct]:
    """The same for each place modulo 8."""
    return [run(order, items, place) for place in range(WIDEST)]


def common_run(order: str, items: Sequence[Item], places: Places) -> struct.Struct | None:
    """The same for all of these places, or None if the padding is not."""
    runs = [run(order, items, place) for place in places]
    return runs[0] if len({each.format for each in runs}) == 1 else None


def places_after(items: Sequence[Item], places: Places) -> Places:
    """Where a run may end that starts at one of these places."""
    return frozenset((place + run("<", items, place).size) % WIDEST for place in places)


def places_aligned(size: int, places: Places) -> Places:
    """These places, as nothing may follow, and where a value that is aligned to a size starts."""
    return places | {(place + padding(place, size)) % WIDEST for place in places}


def places_in_steps(size: int, places: Places) -> Places:
    """Where any number of values of a size may end that start at one of these places."""
    steps = range(0, WIDEST, min(size, WIDEST))
    return frozenset((place + step) % WIDEST for place in places for step in steps)


class Runs(dict[int, "Callable[..., Any]"]):
    """A run and a number of equal values behind it: what reads or writes it, by that number.

    Args:
        method: The method of ``struct.Struct`` that is wanted.
        order: The byte order, ``<`` or ``>``.
        items: The run.
        place: Where it starts.
        code: What ``struct`` calls one of the values.

    Attributes:
        place: Where it starts.
        code: What ``struct`` calls one of the values.
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
        """Makes it; kept for the first `MOST_RUNS` numbers that are asked for."""
        items = [*self._items, Item(self.code)] if count else self._items
        text = run(self._order, items, self.place).format
        made = struct.Struct(f"{text}{count - 1}{self.code}" if count > 1 else text)
        method: Callable[..., Any] = getattr(made, self._method)
        if len(self) < MOST_RUNS:
            self[count] = method
        return method


def members(cls: type[Message]) -> Iterator[tuple[Field, type[Message] | None]]:
    """The fields of a message class, each with the class of its messages or None."""
    return zip(fields(cls), nested_classes(cls), strict=True)


def is_in_run(field_type: FieldType) -> bool:
    """Whether such a field is a value of a run: a number, or an array of bytes of fixed length."""
    if field_type.form is ArrayForm.FIXED:
        return field_type.name in BYTE_TYPES
    return not field_type.is_sequence and field_type.name in FORMATS


def code_in_run(field_type: FieldType) -> str:
    """What ``struct`` calls a field that is a value of a run."""
    if field_type.is_sequence:
        return f"{field_type.size}s"
    return FORMATS[field_type.name]


@functools.cache
def weight(cls: type[Message]) -> int:
    """How many fields a message has, with those of the single messages in it."""
    return 1 + sum(
        1 if nested is None or field.type.is_sequence else weight(nested)
        for field, nested in members(cls)
    )


def is_inlined(cls: type[Message]) -> bool:
    """Whether the code for such a message stands among that for the message around it."""
    return weight(cls) <= MOST_INLINED


def row(cls: type[Message]) -> list[Item] | None:
    """The values of a message that is nothing but a run, or None."""
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
    """What messages in a sequence are aligned to, if they are runs at equal distances; else 0.

    Args:
        cls: Their class.
        counted: Whether a count stands before them, and aligns the first to its own size.
    """
    items = row(cls)
    if items is None:
        return 0
    widest = max(alignment(code) for code, _ in items)
    first = max(alignment(items[0].code), size_of(COUNT) if counted else 1)
    is_even = first >= widest and run("<", items, HEADER_SIZE).size % widest == 0
    return widest if is_even else 0
