"""Generates the decoder of a message class as source code.

For data that it cannot read, a decoder raises ``struct.error`` or ``ValueError`` without saying
where the error is. ``locate`` then reads the data again, value by value, and finds the error. A
decoder never creates more elements than the data has bytes, whatever length the data claims: each
element takes at least one byte, and the decoder stops at the end of the data.
"""

from __future__ import annotations

import array
import functools
import struct
import sys
from typing import TYPE_CHECKING, TypeVar

from turtleact.errors import InvalidMessage
from turtleact.interfaces.cdr.layout import (
    ANYWHERE,
    COUNT,
    EMPTY,
    FORMATS,
    HEADER_SIZE,
    WIDEST,
    Item,
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
from turtleact.interfaces.definition import ArrayForm
from turtleact.interfaces.types import Message, fields

if TYPE_CHECKING:
    from collections.abc import Callable

    from turtleact.interfaces.definition import Field, FieldType

    #: Makes a sequence from the bytes of its elements.
    Make = Callable[[bytes], object]
    #: Reads an element at a place, and returns it with the place after it.
    Part = Callable[[bytes, int], tuple[object, int]]

__all__ = ["decoder", "locate", "narrow"]

M = TypeVar("M", bound=Message)


@functools.cache
def decoder(
    cls: type[M], order: str, arrays: str, place: int = HEADER_SIZE
) -> Callable[[bytes], M]:
    """Return a function that decodes messages of this class.

    Args:
        cls: The class of the messages.
        order: The byte order, ``<`` or ``>``.
        arrays: The type for sequences of numbers: ``list``, ``array`` or ``numpy``.
        place: Where the message begins, in bytes from the start of the data.
    """
    reader = Reader("data", order, arrays, place=place)
    value = reader.message(cls)
    reader.flush()
    reader.source.add(f"return {value}")
    return reader.source.function()  # type: ignore[return-value]  # generated so


@functools.cache
def part_decoder(cls: type[Message], order: str, arrays: str) -> Part:
    """Return a function that decodes the nested message at a given place in the data."""
    reader = Reader("data, p", order, arrays, place=None)
    value = reader.message(cls)
    reader.flush()
    reader.source.add(f"return {value}, p")
    return reader.source.function()  # type: ignore[return-value]  # generated so


@functools.cache
def text_decoder(field_type: FieldType, order: str) -> Part:
    """Return a function that decodes the text at a given place in the data."""
    reader = Reader("data, p", order, "list", place=None)
    reader.source.add(f"return {reader.text(field_type.element)}, p")
    return reader.source.function()  # type: ignore[return-value]  # generated so


class Reader:
    """Writes the source code of a decoder.

    The methods for fields add code that reads a value, and return an expression for the value. The
    expression is valid only after the code that `flush` adds. That code reads the pending run:
    consecutive values that ``struct`` reads in one call.

    Attributes:
        source: The code so far.
        pending: The pending run: the values for which no code has been added yet.
        place: The offset at which the pending run starts. None means that the generated code
            computes the offset in the variable ``p``.
        places: The offsets, modulo 8, at which the pending run may start. Used only if ``place`` is
            None.
    """

    def __init__(self, signature: str, order: str, arrays: str, *, place: int | None) -> None:
        self.source = Source(signature)
        self.source.names["short"] = struct.error
        self.pending: list[Item] = []
        self.order = order
        self.arrays = arrays
        self.place = place
        self.places = ANYWHERE

    def message(self, cls: type[Message]) -> str:
        """Add code that reads a message's fields."""
        values = [self.field(cls, field, nested) for field, nested in members(cls)]
        if not values:
            self.pending.append(Item(EMPTY))
        return f"{self.source.hold(cls)}({', '.join(values)})"

    def field(self, cls: type[Message], field: Field, nested: type[Message] | None) -> str:
        """Add code that reads one field."""
        is_bytes = field.name in cls._shape.bytes_fields
        if field.type.name in FORMATS:
            return self.numbers(field.type, is_bytes=is_bytes)
        if field.type.is_sequence:
            return self.sequence(field.type, nested)
        if nested is None:
            return self.text(field.type)
        if is_inlined(nested):
            return self.message(nested)
        value = self.source.fresh()
        part = self.source.hold(part_decoder(nested, self.order, self.arrays))
        self.flush()
        self.settle()
        self.source.add(f"{value}, p = {part}(data, p)")
        self.places = ANYWHERE
        return value

    def numbers(self, field_type: FieldType, *, is_bytes: bool) -> str:
        """Add code that reads a number, or a sequence of numbers."""
        value = self.source.fresh()
        if not field_type.is_sequence:
            self.pending.append(Item(code_in_run(field_type), value))
            return value
        code = FORMATS[field_type.name]
        make = "" if is_bytes else self.source.hold(maker(self.arrays, self.order, code))
        if is_in_run(field_type):
            self.pending.append(Item(code_in_run(field_type), value))
            return f"{make}({value})"
        count = self.count(field_type)
        self.align(size_of(code), count)
        if self.arrays == "list" and not is_bytes:
            runs = self.source.hold(Runs("unpack_from", self.order, (), HEADER_SIZE, code))
            self.source.add(f"{value} = [*{runs}[{count}](data, p)]")
            self.source.add(f"p += {count} * {size_of(code)}")
            self.places = places_in_steps(size_of(code), self.places)
            return value
        self.slice(value, f"{count} * {size_of(code)}")
        return f"{make}({value})"

    def text(self, field_type: FieldType) -> str:
        """Add code that reads a text.

        The code expects no NUL at the end of a wstring, because ROS 2 writes none there.
        """
        count, value = self.source.fresh(), self.source.fresh()
        self.pending.append(Item(COUNT, count))
        self.flush()
        if field_type.name == "string":
            self.slice(value, count)
            self.source.add(f'{value} = {value}.decode("utf-8", "replace").removesuffix("\\0")')
        else:
            self.slice(value, f"{count} * 4")
            self.source.add(f"{value} = {self.source.hold(narrow)}({value}, {self.order!r})")
        if field_type.string_bound is not None:
            self.guard(f"len({value}) > {field_type.string_bound}")
        return value

    def sequence(self, field_type: FieldType, nested: type[Message] | None) -> str:
        """Add code that reads a sequence of texts or messages."""
        value = self.source.fresh()
        count = self.count(field_type)
        counted = field_type.form is not ArrayForm.FIXED
        size = 0 if nested is None else common_alignment(nested, counted=counted)
        if nested is not None and size:
            self.rows(nested, value, count, size)
            return value
        part = (
            text_decoder(field_type, self.order)
            if nested is None
            else part_decoder(nested, self.order, self.arrays)
        )
        self.source.add(f"{value} = []")
        self.source.add(f"for _ in range({count}):")
        self.source.add(f" x, p = {self.source.hold(part)}(data, p); {value}.append(x)")
        self.places = ANYWHERE
        return value

    def rows(self, cls: type[Message], value: str, count: str, size: int) -> None:
        """Add code that reads a sequence of messages, if one struct fits all of them.

        ``size`` is the alignment of the messages; see `common_alignment`.
        """
        self.align(size, count)
        expression = self.message(cls)
        items, self.pending = self.pending, []
        reader = run(self.order, items, HEADER_SIZE)
        self.slice(value, f"{count} * {reader.size}")
        each = f"for {targets(items)} in {self.source.hold(reader.iter_unpack)}({value})"
        self.source.add(f"{value} = [{expression} {each}]")

    def count(self, field_type: FieldType) -> str:
        """Add code that reads a sequence's length, and sets ``p`` to the place after the length.

        If the length is fixed, the data does not contain the length, so the code only sets ``p``.
        """
        if field_type.form is ArrayForm.FIXED:
            self.flush()
            self.settle()
            return str(field_type.size)
        count = self.source.fresh()
        self.pending.append(Item(COUNT, count))
        self.flush()
        self.settle()
        if field_type.form is ArrayForm.BOUNDED:
            self.guard(f"{count} > {field_type.size}")
        return count

    def slice(self, value: str, size: str) -> None:
        """Add code that puts the next ``size`` bytes into the variable ``value``."""
        self.settle()
        self.source.add(f"q = p; p += {size}")
        self.guard("p > len(data)")
        self.source.add(f"{value} = data[q:p]")
        self.places = ANYWHERE

    def align(self, size: int, count: str) -> None:
        """Add code that skips the padding before the first element, if there are elements."""
        if any(padding(place, size) for place in self.places):
            pads = [padding(place, size) for place in range(WIDEST)]
            self.source.add(f"if {count}: p += {self.source.hold(pads)}[p & 7]")
            self.places = places_aligned(size, self.places)

    def guard(self, condition: str) -> None:
        """Add code that refuses the data if this condition is true."""
        self.source.add(f"if {condition}: raise short")

    def settle(self) -> None:
        """Add code that sets the offset variable ``p`` to ``place``, unless ``place`` is None."""
        if self.place is not None:
            self.source.add(f"p = {self.place}")
            self.places = frozenset({self.place % WIDEST})
            self.place = None

    def flush(self) -> None:
        """Add code that reads the pending values with one ``struct`` call."""
        if not self.pending:
            return
        items, self.pending = self.pending, []
        into = targets(items)
        if self.place is not None:
            reader = run(self.order, items, self.place)
            self.source.add(f"{into} = {self.source.hold(reader.unpack_from)}(data, {self.place})")
            self.place += reader.size
            return
        common = common_run(self.order, items, self.places)
        if common is None:
            table = [(reader.unpack_from, reader.size) for reader in phases(self.order, items)]
            self.source.add(f"read, size = {self.source.hold(table)}[p & 7]")
            self.source.add(f"{into} = read(data, p); p += size")
        else:
            self.source.add(f"{into} = {self.source.hold(common.unpack_from)}(data, p)")
            self.source.add(f"p += {common.size}")
        self.places = places_after(items, self.places)


def targets(items: list[Item]) -> str:
    """Return the assignment target for the values of a run, such as ``[v1, v2]``."""
    return f"[{', '.join(item.text for item in items if item.text)}]"


def narrow(content: bytes, order: str) -> str:
    """Decode the text of a wstring. Every four bytes hold a character or half a surrogate pair.

    Raises:
        ValueError: if four bytes hold neither a character nor half of a surrogate pair.
    """
    codec = "utf-32-le" if order == "<" else "utf-32-be"
    units = content.decode(codec, "surrogatepass")
    return units.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")


def maker(arrays: str, order: str, code: str) -> Make:
    """Return a function that makes a sequence of numbers from bytes."""
    if arrays == "numpy":
        return numpy_maker(order, code)
    if arrays == "array" and code != "?":
        is_swapped = (order == "<") != (sys.byteorder == "little")
        return functools.partial(as_array, code, is_swapped=is_swapped)
    return functools.partial(as_list, order, code)


def as_list(order: str, code: str, content: bytes) -> list[object]:
    """Make a list of the numbers in some bytes."""
    return list(struct.unpack(f"{order}{len(content) // size_of(code)}{code}", content))


def as_array(
    code: str, content: bytes, *, is_swapped: bool
) -> array.array[int] | array.array[float]:
    """Make an array of the numbers in some bytes."""
    result: array.array[int] | array.array[float] = array.array(code)
    result.frombytes(content)
    if is_swapped:
        result.byteswap()
    return result


def numpy_maker(order: str, code: str) -> Make:
    """Return a function that makes a numpy array from encoded numbers. The array is a copy."""
    import numpy as np  # slower to import than the rest of the package

    stored, native = np.dtype("B" if code == "?" else order + code), np.dtype(code)
    return lambda content: np.frombuffer(content, stored).astype(native)


def locate(cls: type[Message], data: bytes, order: str) -> None:
    """Raise an exception that names the first error in data that a decoder has refused.

    Args:
        cls: The class of the message in the data.
        data: The data, header included.
        order: The byte order of the data, ``<`` or ``>``.

    Raises:
        InvalidMessage: naming the first value that cannot be read.
    """
    try:
        Walk(data, order).message(cls)
    except InvalidMessage as inner:
        raise InvalidMessage(f"message{inner.path}", inner.problem) from None


class Walk:
    """Reads data value by value, to find the error that made a decoder refuse the data.

    Attributes:
        place: The offset of the next value, or of the padding before that value, in bytes from the
            start of the data.
    """

    def __init__(self, data: bytes, order: str) -> None:
        self.data = data
        self.order = order
        self.place = HEADER_SIZE

    def message(self, cls: type[Message]) -> None:
        """Read a message."""
        for field, nested in members(cls):
            try:
                self.field(field.type, nested)
            except InvalidMessage as inner:
                raise InvalidMessage(f".{field.name}{inner.path}", inner.problem) from None
        if not fields(cls):
            self.take(EMPTY)

    def field(self, field_type: FieldType, nested: type[Message] | None) -> None:
        """Read a field."""
        if not field_type.is_sequence:
            self.single(field_type, nested)
            return
        count = field_type.size
        if field_type.form is not ArrayForm.FIXED:
            count = self.count(count or None)
        if field_type.name in FORMATS:
            self.take(FORMATS[field_type.name], count)
            return
        for index in range(count):
            try:
                self.single(field_type, nested)
            except InvalidMessage as inner:
                raise InvalidMessage(f"[{index}]{inner.path}", inner.problem) from None

    def single(self, field_type: FieldType, nested: type[Message] | None) -> None:
        """Read a number, a text or a message."""
        if nested is not None:
            self.message(nested)
        elif field_type.is_string:
            self.text(field_type)
        else:
            self.take(FORMATS[field_type.name])

    def text(self, field_type: FieldType) -> None:
        """Read a text."""
        count = self.count(None)
        if field_type.name == "string":
            text = self.take("B", count).decode("utf-8", "replace").removesuffix("\0")
        else:
            text = self.units(count)
        bound = field_type.string_bound
        if bound is not None and len(text) > bound:
            raise InvalidMessage("", f"at most {bound} characters, got {len(text)}")

    def units(self, count: int) -> str:
        """Read the content of a wstring of ``count`` units, and return it as text."""
        content = self.take("I", count)
        try:
            return narrow(content, self.order)
        except ValueError as error:
            place = self.place - len(content)
            raise InvalidMessage("", f"no characters in the text at byte {place}") from error

    def count(self, bound: int | None) -> int:
        """Read the length of a text or sequence."""
        (count,) = struct.unpack(f"{self.order}{COUNT}", self.take(COUNT))
        if bound is not None and count > bound:
            raise InvalidMessage("", f"at most {bound} elements, got {count}")
        return int(count)

    def take(self, code: str, count: int = 1) -> bytes:
        """Read ``count`` values of fixed size, and return their bytes."""
        if count:
            self.place += padding(self.place, size_of(code))
        begin, size = self.place, size_of(code) * count
        left = max(0, len(self.data) - begin)
        if size > left:
            problem = f"cut off at byte {begin}: {size} more are needed, {left} are there"
            raise InvalidMessage("", problem)
        self.place += size
        return self.data[begin : self.place]
