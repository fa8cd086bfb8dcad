"""Generates the encoder of a message class as source code.

An encoder accepts values of the expected Python type, and other values that ``struct`` can pack,
such as an int for a float. For any other value, the encoder raises an exception that does not say
which value is wrong. ``encode`` then calls ``snapshot``, which converts the message or reports the
wrong value. ``struct`` packs any object as a bool, so the generated code checks bools itself.
"""

from __future__ import annotations

import functools
import struct
import sys
from typing import TYPE_CHECKING

from turtleact.interfaces.cdr.layout import (
    ANYWHERE,
    COUNT,
    EMPTY,
    FORMATS,
    HEADER,
    HEADER_SIZE,
    WIDEST,
    Item,
    Places,
    Runs,
    code_in_run,
    common_alignment,
    common_run,
    is_in_run,
    is_inlined,
    members,
    padding,
    phases,
    places_after,
    places_aligned,
    places_in_steps,
    run,
    size_of,
)
from turtleact.interfaces.conversion import Source
from turtleact.interfaces.definition import BYTE_TYPES, ArrayForm
from turtleact.interfaces.types import fields

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.interfaces.definition import FieldType
    from turtleact.interfaces.types import Message

    Content = Callable[[object], bytes]

__all__ = ["encoder"]


@functools.cache
def encoder(cls: type[Message], size: int = HEADER_SIZE) -> Callable[..., bytes]:
    """Return a function that encodes messages of this class.

    If more than the header comes before the message, the function has a second argument: all the
    bytes before the message, header included.

    Args:
        cls: The class of the messages.
        size: How many bytes come before the message, header included.
    """
    writer = Writer("m, front=header", frozenset({0}))
    writer.source.names["header"] = HEADER
    writer.pending.append(Item(f"{size}s", "front"))
    writer.message(cls, "m")
    writer.finish()
    return writer.source.function()  # type: ignore[return-value]  # the text is made to be so


@functools.cache
def part_encoder(cls: type[Message]) -> Callable[[Message, bytearray], None]:
    """Return a function that encodes a nested message and appends it to a bytearray."""
    writer = Writer("m, out", ANYWHERE)
    writer.guard(f"type(m) is not {writer.source.hold(cls)}")
    writer.message(cls, "m")
    writer.flush()
    return writer.source.function()  # type: ignore[return-value]  # the text is made to be so


class Writer:
    """Writes the source code of an encoder.

    Attributes:
        source: The code so far.
        pending: The pending run: the values for which no code has been added yet.
        places: The offsets, modulo 8, at which the pending run may start.
        pieces: The expressions for the data before the pending run. Not used after the generated
            code creates ``out``, because the code then appends data directly to ``out``.
        is_begun: Whether the code has created the bytearray ``out`` for the data.
    """

    def __init__(self, signature: str, places: Places) -> None:
        self.source = Source(signature)
        self.source.names |= {"unfit": struct.error, "join": b"".join}
        self.pending: list[Item] = []
        self.places = places
        self.pieces: list[str] = []
        self.is_begun = places is ANYWHERE

    def guard(self, condition: str) -> None:
        """Add code that refuses the message if this condition is true."""
        self.source.add(f"if {condition}: raise unfit")

    def message(self, cls: type[Message], value: str) -> None:
        """Add code that writes the fields of the message that the expression ``value`` names."""
        for field, nested in members(cls):
            variable = self.source.fresh()
            self.source.add(f"{variable} = {value}.{field.attribute}")
            if field.type.is_sequence:
                self.sequence(field.type, nested, variable)
            else:
                self.single(field.type, nested, variable)
        if not fields(cls):
            self.pending.append(Item(EMPTY))

    def single(self, field_type: FieldType, nested: type[Message] | None, value: str) -> None:
        """Add code that writes one number, text or message."""
        if nested is None and is_in_run(field_type):
            if field_type.name == "bool":
                self.guard(f"{value} is not True and {value} is not False")
            self.pending.append(Item(code_in_run(field_type), value))
        elif nested is None:
            self.text(field_type, value)
        elif is_inlined(nested):
            self.guard(f"type({value}) is not {self.source.hold(nested)}")
            self.message(nested, value)
        else:
            self.begin()
            part = self.source.hold(part_encoder(nested))
            self.source.add(f"{part}({value}, out)")
            self.places = ANYWHERE

    def text(self, field_type: FieldType, value: str) -> None:
        """Add code that writes a text: its length, then its characters."""
        self.bound(field_type.string_bound, value)
        content = self.source.fresh()
        if field_type.name == "string":
            self.source.add(f"{content} = {self.source.hold(str.encode)}({value})")
            self.pending.append(Item(COUNT, f"len({content}) + 1"))
            self.content(content, 1)
            self.pending.append(Item("x"))  # the NUL that ends it
        else:
            self.source.add(f"{content} = {self.source.hold(wide)}({value})")
            self.pending.append(Item(COUNT, f"len({content}) // 4"))
            self.content(content, 4)

    def sequence(self, field_type: FieldType, nested: type[Message] | None, value: str) -> None:
        """Add code that writes a sequence.

        The code writes the length, unless the length is fixed, and then the elements.
        """
        if field_type.form is ArrayForm.FIXED:
            self.guard(f"len({value}) != {field_type.size}")
        else:
            self.bound(field_type.size or None, value)
            self.pending.append(Item(COUNT, f"len({value})"))
        if field_type.name in FORMATS:
            self.numbers(field_type, value)
            return
        self.guard(f"type({value}) is not list")
        self.begin()
        counted = field_type.form is not ArrayForm.FIXED
        size = 0 if nested is None else common_alignment(nested, counted=counted)
        if nested is None:
            text = text_encoder(field_type)
            self.source.add(f"for x in {value}: {self.source.hold(text)}(x, out)")
        elif not size:
            part = part_encoder(nested)
            self.source.add(f"for x in {value}: {self.source.hold(part)}(x, out)")
        else:
            self.rows(nested, value, size)
        self.places = ANYWHERE

    def numbers(self, field_type: FieldType, value: str) -> None:
        """Add code that writes the numbers of a sequence."""
        code = FORMATS[field_type.name]
        is_plain = field_type.name != "bool" and field_type.name not in BYTE_TYPES
        if is_plain and self.is_common([*self.pending, Item(code)]):
            self.numbers_behind(field_type, value, code)
            return
        content = self.source.fresh()
        if field_type.name in BYTE_TYPES:
            other = f"{self.source.hold(octets)}({value})"
            self.source.add(f"{content} = {value} if type({value}) is bytes else {other}")
        elif field_type.name == "bool":
            self.source.add(f"{content} = {self.source.hold(truths)}({value})")
        else:
            runs = Runs("pack", "<", (), HEADER_SIZE, code)
            fast = f"{self.source.hold(runs)}[len({value})](*{value})"
            other = f"{self.source.hold(functools.partial(copied, code))}({value})"
            self.source.add(f"{content} = {fast} if type({value}) is list else {other}")
        if is_in_run(field_type):
            self.pending.append(Item(code_in_run(field_type), content))
            return
        self.align(size_of(code), content)
        self.content(content, size_of(code))

    def numbers_behind(self, field_type: FieldType, value: str, code: str) -> None:
        """Add code that writes the pending values and a sequence of numbers in one call."""
        items, self.pending = self.pending, []
        runs = Runs("pack", "<", items, min(self.places), code)
        values = "".join(f"{item.text}, " for item in items if item.text)
        if field_type.form is ArrayForm.FIXED:
            fast = f"{self.source.hold(runs[field_type.size])}({values}*{value})"
        else:
            fast = f"{self.source.hold(runs)}[len({value})]({values}*{value})"
        other = f"{self.source.hold(functools.partial(behind, runs))}({values}{value})"
        piece = self.source.fresh()
        self.source.add(f"{piece} = {fast} if type({value}) is list else {other}")
        self.add(piece)
        first = places_after([*items, Item(code)], self.places)
        self.places = places_in_steps(size_of(code), first) | places_after(items, self.places)

    def is_common(self, items: list[Item]) -> bool:
        """Whether the padding in a run is the same at each offset where the run may start.

        The result is false if the padding differs when the run's last item is left out.
        """
        return all(common_run("<", each, self.places) for each in (items, items[:-1]))

    def rows(self, cls: type[Message], value: str, size: int) -> None:
        """Add code that writes a sequence of messages, if one struct fits all of them.

        ``size`` is the alignment of the messages; see `common_alignment`.
        """
        self.align(size, value)
        self.source.add(f"for x in {value}:")
        self.source.depth += 1
        self.guard(f"type(x) is not {self.source.hold(cls)}")
        self.message(cls, "x")
        items, self.pending = self.pending, []
        self.source.add(f"out += {self.call(run('<', items, HEADER_SIZE).pack, items)}")
        self.source.depth -= 1

    def align(self, size: int, value: str) -> None:
        """Add code that writes the padding before the first element, if there are elements."""
        self.flush()
        if any(padding(place, size) for place in self.places):
            self.begin()
            pads = [bytes(padding(place, size)) for place in range(WIDEST)]
            self.source.add(f"if {value}: out += {self.source.hold(pads)}[len(out) & 7]")
            self.places = places_aligned(size, self.places)

    def bound(self, size: int | None, value: str) -> None:
        """Add code that refuses a value that is longer than ``size``; add nothing for None."""
        if size is not None:
            self.guard(f"len({value}) > {size}")

    def content(self, value: str, size: int) -> None:
        """Add code that writes the bytes of any number of values, each ``size`` bytes long."""
        self.flush()
        self.add(value)
        self.places = places_in_steps(size, self.places)

    def flush(self) -> None:
        """Add code that writes the pending run."""
        if not self.pending:
            return
        items, self.pending = self.pending, []
        common = common_run("<", items, self.places)
        if common is None:
            self.begin()
            table = [packer.pack for packer in phases("<", items)]
            self.add(self.call(table, items, "[len(out) & 7]"))
        elif any(item.text for item in items):
            self.add(self.call(common.pack, items))
        else:
            self.add(self.source.hold(common.pack()))
        self.places = places_after(items, self.places)

    def add(self, piece: str) -> None:
        """Add code that writes the bytes to which the expression ``piece`` evaluates."""
        if self.is_begun:
            self.source.add(f"out += {piece}")
        else:
            self.pieces.append(piece)

    def begin(self) -> None:
        """Add code that writes the pending values and creates ``out`` with all bytes so far."""
        self.flush()
        if not self.is_begun:
            self.source.add(f"out = bytearray({self.joined()})")
            self.is_begun = True

    def finish(self) -> None:
        """Add code that writes the pending values and returns the bytes of the message."""
        self.flush()
        self.source.add(f"return {'bytes(out)' if self.is_begun else self.joined()}")

    def joined(self) -> str:
        """Return an expression that joins all pieces of the data so far."""
        return self.pieces[0] if len(self.pieces) == 1 else f"join(({', '.join(self.pieces)}))"

    def call(self, function: object, items: list[Item], index: str = "") -> str:
        """Return an expression that calls a ``pack`` function with the values of ``items``."""
        values = ", ".join(item.text for item in items if item.text)
        return f"{self.source.hold(function)}{index}({values})"


@functools.cache
def text_encoder(field_type: FieldType) -> Callable[[str, bytearray], None]:
    """Return a function that encodes one string of a sequence and appends it to a bytearray."""
    writer = Writer("m, out", ANYWHERE)
    writer.text(field_type.element, "m")
    writer.flush()
    return writer.source.function()  # type: ignore[return-value]  # the text is made to be so


def wide(text: str) -> bytes:
    """Encode the characters of a wstring: each UTF-16 unit takes four bytes, as in ROS 2."""
    units = str.encode(text, "utf-16-le")
    count = len(units) // 2
    return struct.pack(f"<{count}I", *struct.unpack(f"<{count}H", units))


def octets(value: object) -> bytes:
    """Encode the elements of a sequence of bytes, without its length."""
    return bytes(value) if type(value) is list else copied("B", value)


def truths(value: object) -> bytes:
    """Encode the elements of a sequence of bools, without its length.

    The elements are checked here, because ``struct`` would accept any object as a bool.
    """
    if type(value) is not list:
        return copied("?", value)
    if any(item is not True and item is not False for item in value):
        raise TypeError("a sequence of bools")
    return bytes(value)


#: The element kinds of arrays, by ``memoryview``'s codes.
KINDS = {
    "?": "bool",
    **dict.fromkeys("bhilq", "signed"),
    **dict.fromkeys("BHILQ", "unsigned"),
    **dict.fromkeys("fd", "float"),
}


def behind(runs: Runs, *values: object) -> bytes:
    """Pack all values except the last, and append the bytes of the last value, an array."""
    *others, value = values
    content = copied(runs.code, value)
    first: bytes = runs[0](*others)
    pad = padding(runs.place + len(first), size_of(runs.code)) if content else 0
    return b"".join((first, bytes(pad), content))


def copied(code: str, value: object) -> bytes:
    """Return the bytes of an array.

    Raises:
        TypeError: if CDR would store the elements of the array differently.
    """
    view = memoryview(value)  # type: ignore[arg-type]  # raises TypeError if it is not an array
    wanted = (KINDS[code], size_of(code), 1, "little")
    if (KINDS.get(view.format), view.itemsize, view.ndim, sys.byteorder) != wanted:
        raise TypeError("an array of other elements")
    return view.tobytes()
