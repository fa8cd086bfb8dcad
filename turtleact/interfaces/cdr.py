"""Converts messages to CDR, the bytes in which ROS 2 sends them, and back.

The encoding is plain CDR, version 1. Data begins with a header of four bytes. Each value begins at
a multiple of the value's size, counted from the end of the header. Data is written in little endian
with zeros for padding, and read in either byte order.

Each class gets one encoder and one decoder, generated as source code on first use. Consecutive
values of fixed size form a *run*, which ``struct`` reads or writes in one call. The padding in a
run depends on the place where the run starts, so each run has eight ``Struct`` objects: one for
each remainder of the place modulo 8.

An encoder or decoder does not say which value is wrong. A decoder never creates more elements than
the data has bytes, whatever length the data claims: each element takes at least one byte, and the
decoder stops at the end of the data.

Source: OMG, Data-Distribution Service Interoperability 2.2 (RTPS), chapter 10; ROS 2 implements it
in ``rosidl_typesupport_fastrtps``.
"""

from __future__ import annotations

import array
import functools
import struct
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

from turtleact.errors import InvalidMessage, InvalidOption
from turtleact.interfaces.conversion import Source, name_of, snapshot
from turtleact.interfaces.definition import BYTE_TYPES, ArrayForm
from turtleact.interfaces.types import Message, constructor, fields, nested_classes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from turtleact.interfaces.definition import Field, FieldType

    #: Appends the encoded form of a value to a bytearray.
    Append = Callable[[Any, bytearray], None]
    #: Makes a sequence from the bytes of its elements.
    Make = Callable[[bytes], object]
    #: Reads a value at a place, and returns the value with the place after it.
    Read = Callable[[bytes, int], tuple[Any, int]]
    #: Reads a text or sequence of a given length at a place.
    ReadMany = Callable[[bytes, int, int], tuple[Any, int]]

__all__ = ["BYTE_ORDERS", "HEADER", "MISREAD", "UNFIT", "decode", "decoder", "encode", "encoder"]

M = TypeVar("M", bound=Message)

#: The header of written data: plain CDR, little endian, no options.
HEADER = b"\x00\x01\x00\x00"

#: The first two bytes of a header, and the byte order's name in ``struct``.
BYTE_ORDERS = {b"\x00\x01": "<", b"\x00\x00": ">"}

#: The exceptions of an encoder for a value that it cannot write unchanged.
UNFIT = (struct.error, ArithmeticError, AttributeError, TypeError, ValueError)

#: The exceptions of a decoder for bytes that it cannot read.
MISREAD = (struct.error, ValueError)

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

#: The element kinds of arrays, by ``memoryview``'s codes.
KINDS = {
    "?": "bool",
    **dict.fromkeys("bhilq", "signed"),
    **dict.fromkeys("BHILQ", "unsigned"),
    **dict.fromkeys("fd", "float"),
}

ARRAYS = ("list", "array", "numpy")


def encode(message: Message) -> bytes:
    """Encode a message as CDR, with its header.

    Each value is checked as in ``snapshot``, with one exception: in a list of numbers, ``True``
    is accepted as 1. An ``array`` or numpy array with elements of the field's type is copied
    directly, which is much faster than a list.

    Raises:
        InvalidMessage: with the path of the first value that does not fit.

    >>> from turtleact.interfaces.standard import Time
    >>> encode(Time(sec=1, nanosec=2)).hex(" ", 4)
    '00010000 01000000 02000000'
    """
    try:
        return encoder(type(message))(message)
    except UNFIT:
        checked = snapshot(message)
    return encoder(type(checked))(checked)


def decode(
    cls: type[M],
    data: bytes | bytearray | memoryview,
    *,
    arrays: Literal["list", "array", "numpy"] = "list",
) -> M:
    """Decode a message of this class from CDR.

    The contents of padding and anything after the message are ignored, because ROS 2 leaves garbage
    there. Bytes that are not UTF-8 become U+FFFD. The length of the data limits the memory and time
    for decoding, even if a length inside the data is wrong.

    Args:
        cls: The class of the message.
        data: The message in CDR, header included.
        arrays: The type for sequences of numbers: ``"list"``, ``"array"`` for ``array.array``
            (bools stay a list), or ``"numpy"``. A field declared as ``bytes`` is ``bytes`` in any
            case.

    Raises:
        InvalidMessage: if a value is cut off, has an impossible length or breaks its bound.
        InvalidOption: if ``arrays`` is neither ``"list"`` nor ``"array"`` nor ``"numpy"``.

    >>> from turtleact.interfaces.standard import Time
    >>> decode(Time, bytes.fromhex("00010000 01000000 02000000"))
    Time(sec=1, nanosec=2)
    """
    if arrays not in ARRAYS:
        raise InvalidOption("arrays", f"expected one of {', '.join(ARRAYS)}, got {arrays!r}")
    if type(data) is not bytes:
        data = bytes(memoryview(data))
    order = BYTE_ORDERS.get(data[:2])
    if order is None or len(data) < len(HEADER):
        problem = f"its header must be 0000 or 0001 and two more bytes, not '{data[:4].hex()}'"
        raise InvalidMessage("message", f"not plain CDR: {problem}")
    read: Callable[[bytes], M] = decoder(cls, order, arrays)
    try:
        return read(data)
    except MISREAD:
        problem = f"these {len(data)} bytes are not of type {name_of(cls)}"
        raise InvalidMessage("message", problem) from None


@functools.cache
def encoder(cls: type[M]) -> Callable[..., bytes]:
    """Return a function that encodes messages of this class.

    The function takes the message, and optionally the bytes to put before the message, header
    included. For a message that it cannot encode unchanged, the function raises one of `UNFIT`.
    """
    append = appender(cls)

    def encoded(message: M, front: bytes = HEADER) -> bytes:
        out = bytearray(front)
        append(message, out)
        return bytes(out)

    return encoded


@functools.cache
def decoder(
    cls: type[M], order: str = "<", arrays: str = "list", place: int = len(HEADER)
) -> Callable[[bytes], M]:
    """Return a function that decodes messages of this class, whatever the header says.

    The function raises one of `MISREAD` for bytes that it cannot read. ``order`` is the byte order,
    ``arrays`` is as in `decode`, and the message begins at ``place`` in the data.
    """
    read = reader(cls, order, arrays)

    def decoded(data: bytes) -> M:
        message: M = read(data, place)[0]
        return message

    return decoded


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


def padding(place: int, size: int) -> int:
    """Return how many bytes of padding come at this place before a value of this size."""
    return (len(HEADER) - place) % size


def run(order: str, items: Sequence[Item], place: int) -> struct.Struct:
    """Return the ``Struct`` for adjacent values that start at the offset ``place``."""
    text, at = order, place
    for code, _ in items:
        pad = 0 if code[-1] == "s" else padding(at, size_of(code))  # bytes are not aligned
        text += f"{pad}x{code}"
        at += pad + size_of(code)
    return struct.Struct(text)


def runs(order: str, items: Sequence[Item]) -> list[struct.Struct]:
    """Return eight ``Struct`` objects for adjacent values: one for each start offset modulo 8."""
    return [run(order, items, place) for place in range(WIDEST)]


def members(cls: type[Message]) -> Iterator[tuple[Field, type[Message] | None]]:
    """Return pairs of a field and its message class. The class is None for a primitive field."""
    return zip(fields(cls), nested_classes(cls), strict=True)


def is_in_run(field_type: FieldType) -> bool:
    """Whether a field can be part of a run: a number, a bool or a fixed array of bytes."""
    if field_type.form is ArrayForm.FIXED:
        return field_type.name in BYTE_TYPES
    return not field_type.is_sequence and field_type.name in FORMATS


def code_in_run(field_type: FieldType) -> str:
    """Return the ``struct`` format of a field that is part of a run."""
    return f"{field_type.size}s" if field_type.is_sequence else FORMATS[field_type.name]


@functools.cache
def appender(cls: type[Message]) -> Append:
    """Return a function that encodes a message and appends it to a bytearray.

    The function accepts values of the expected Python type, and other values that ``struct`` can
    pack, such as an int for a float.
    """
    writer = Writer()
    writer.message(cls, "m")
    return writer.function()


@functools.cache
def text_appender(field_type: FieldType) -> Append:
    """Return a function that encodes one text of a sequence and appends it to a bytearray."""
    writer = Writer()
    writer.text(field_type, "m")
    return writer.function()


class Writer:
    """Writes the source code of an encoder, which appends a value ``m`` to a bytearray ``out``.

    ``struct`` packs any object as a bool, so the generated code checks bools itself.

    Attributes:
        source: The code so far.
        pending: The pending run: the values for which no code has been added yet.
    """

    def __init__(self) -> None:
        self.source = Source("m, out")
        self.source.names["unfit"] = struct.error
        self.pending: list[Item] = []

    def function(self) -> Append:
        """Compile the code."""
        self.flush()
        self.source.add("return None")
        return self.source.function()  # type: ignore[return-value]  # the text is made to be so

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
            elif nested is not None:
                self.guard(f"type({variable}) is not {self.source.hold(nested)}")
                self.message(nested, variable)
            elif field.type.is_string:
                self.text(field.type, variable)
            else:
                self.number(field.type, variable)
        if not fields(cls):
            self.pending.append(Item(EMPTY))

    def number(self, field_type: FieldType, value: str) -> None:
        """Add code that writes a number or a bool."""
        if field_type.name == "bool":
            self.guard(f"{value} is not True and {value} is not False")
        self.pending.append(Item(code_in_run(field_type), value))

    def text(self, field_type: FieldType, value: str) -> None:
        """Add code that writes a text: its length, then its characters."""
        self.bound(field_type.string_bound, value)
        content = self.source.fresh()
        convert = narrow if field_type.name == "string" else wide
        self.source.add(f"{content} = {self.source.hold(convert)}({value})")
        length = f"len({content})" if field_type.name == "string" else f"len({content}) // 4"
        self.pending.append(Item(COUNT, length))
        self.flush()
        self.source.add(f"out += {content}")

    def sequence(self, field_type: FieldType, nested: type[Message] | None, value: str) -> None:
        """Add code that writes a sequence.

        The code writes the length, unless the length is fixed, and then the elements.
        """
        if field_type.form is ArrayForm.FIXED:
            self.guard(f"len({value}) != {field_type.size}")
        else:
            self.bound(field_type.size or None, value)
            self.pending.append(Item(COUNT, f"len({value})"))
        if is_in_run(field_type):
            content = f"{self.source.hold(content_of)}({field_type.name!r}, {value})"
            self.pending.append(Item(code_in_run(field_type), content))
            return
        self.flush()
        if field_type.name in FORMATS:
            self.source.add(
                f"{self.source.hold(append_numbers)}({field_type.name!r}, {value}, out)"
            )
            return
        self.guard(f"type({value}) is not list")
        append = text_appender(field_type.element) if nested is None else appender(nested)
        self.source.add(f"for x in {value}:")
        self.source.depth += 1
        if nested is not None:
            self.guard(f"type(x) is not {self.source.hold(nested)}")
        self.source.add(f"{self.source.hold(append)}(x, out)")
        self.source.depth -= 1

    def bound(self, size: int | None, value: str) -> None:
        """Add code that refuses a value that is longer than ``size``; add nothing for None."""
        if size is not None:
            self.guard(f"len({value}) > {size}")

    def flush(self) -> None:
        """Add code that writes the pending run."""
        if self.pending:
            items, self.pending = self.pending, []
            table = self.source.hold([each.pack for each in runs("<", items)])
            values = ", ".join(item.text for item in items if item.text)
            self.source.add(f"out += {table}[len(out) & 7]({values})")


def narrow(text: str) -> bytes:
    """Encode the characters of a string, and the NUL that ends it."""
    return str.encode(text) + b"\0"


def wide(text: str) -> bytes:
    """Encode the characters of a wstring: each UTF-16 unit takes four bytes, as in ROS 2."""
    units = str.encode(text, "utf-16-le")
    count = len(units) // 2
    return struct.pack(f"<{count}I", *struct.unpack(f"<{count}H", units))


def append_numbers(name: str, value: Sequence[Any], out: bytearray) -> None:
    """Append the elements of a sequence of numbers, behind padding if there are elements."""
    content = content_of(name, value)
    if content:
        out += bytes(padding(len(out), size_of(FORMATS[name])))
        out += content


def content_of(name: str, value: Sequence[Any]) -> bytes:
    """Encode the elements of a sequence of numbers, without its length.

    Args:
        name: The name of the primitive type of the elements.
        value: A list, or an array with elements of this type.
    """
    if type(value) is bytes and name in BYTE_TYPES:
        return value
    if type(value) is not list:
        return copied(FORMATS[name], value)
    # The elements are checked here, because `struct` would accept any object as a bool.
    if name == "bool" and any(item is not True and item is not False for item in value):
        raise TypeError("a sequence of bools")
    return struct.pack(f"<{len(value)}{FORMATS[name]}", *value)


def copied(code: str, value: object) -> bytes:
    """Return the bytes of an array.

    Raises:
        TypeError: if CDR would store the elements of the array differently.
    """
    view = memoryview(value)  # type: ignore[arg-type]  # raises TypeError if it is not an array
    if (KINDS.get(view.format), view.itemsize, view.ndim) != (KINDS[code], size_of(code), 1):
        raise TypeError("an array of other elements")
    return view.tobytes()


@functools.cache
def reader(cls: type[Message], order: str, arrays: str) -> Read:
    """Return a function that decodes the message at a given place in the data."""
    parser = Parser(order, arrays)
    return parser.function(parser.message(cls))


@functools.cache
def text_reader(field_type: FieldType, order: str) -> Read:
    """Return a function that decodes the text at a given place in the data."""
    parser = Parser(order, "list")
    return parser.function(parser.text(field_type))


class Parser:
    """Writes the source code of a decoder, which reads ``data`` from the place ``p`` on.

    The methods for fields add code that reads a value, and return an expression for the value. The
    expression is valid only after the code that `flush` adds; see `Writer`.
    """

    def __init__(self, order: str, arrays: str) -> None:
        self.source = Source("data, p")
        self.source.names["misread"] = struct.error
        self.pending: list[Item] = []
        self.order = order
        self.arrays = arrays

    def function(self, value: str) -> Read:
        """Compile the code. The function returns this value, and the place behind it."""
        self.flush()
        self.source.add(f"return {value}, p")
        return self.source.function()  # type: ignore[return-value]  # the text is made to be so

    def message(self, cls: type[Message]) -> str:
        """Add code that reads a message's fields."""
        values = [self.field(cls, field, nested) for field, nested in members(cls)]
        if not values:
            self.pending.append(Item(EMPTY))
        return f"{self.source.hold(constructor(cls))}({', '.join(values)})"

    def field(self, cls: type[Message], field: Field, nested: type[Message] | None) -> str:
        """Add code that reads one field."""
        if field.type.name in FORMATS:
            is_bytes = field.name in cls._shape.bytes_fields
            return self.numbers(field.type, "bytes" if is_bytes else self.arrays)
        if field.type.is_sequence:
            return self.sequence(field.type, nested)
        return self.text(field.type) if nested is None else self.message(nested)

    def numbers(self, field_type: FieldType, arrays: str) -> str:
        """Add code that reads a number, or a sequence of numbers."""
        if is_in_run(field_type):
            value = self.run(code_in_run(field_type))
            if not field_type.is_sequence:
                return value
            return f"{self.source.hold(maker(arrays, self.order, 'B'))}({value})"
        read = numbers_reader(FORMATS[field_type.name], self.order, arrays)
        return self.many(read, self.count(field_type))

    def text(self, field_type: FieldType) -> str:
        """Add code that reads a text."""
        value = self.many(text_content(field_type, self.order), self.run(COUNT))
        if field_type.string_bound is not None:
            self.guard(f"len({value}) > {field_type.string_bound}")
        return value

    def sequence(self, field_type: FieldType, nested: type[Message] | None) -> str:
        """Add code that reads a sequence of texts or messages."""
        count = self.count(field_type)
        self.flush()
        if nested is None:
            read = text_reader(field_type.element, self.order)
        else:
            read = reader(nested, self.order, self.arrays)
        value = self.source.fresh()
        self.source.add(f"{value} = []")
        self.source.add(f"for _ in range({count}):")
        self.source.add(f" x, p = {self.source.hold(read)}(data, p); {value}.append(x)")
        return value

    def count(self, field_type: FieldType) -> str:
        """Add code that reads a sequence's length, unless the length is fixed."""
        if field_type.form is ArrayForm.FIXED:
            return str(field_type.size)
        count = self.run(COUNT)
        if field_type.form is ArrayForm.BOUNDED:
            self.flush()
            self.guard(f"{count} > {field_type.size}")
        return count

    def many(self, read: ReadMany, count: str) -> str:
        """Add code that reads ``count`` characters or numbers."""
        self.flush()
        value = self.source.fresh()
        self.source.add(f"{value}, p = {self.source.hold(read)}(data, p, {count})")
        return value

    def run(self, code: str) -> str:
        """Add a value to the pending run."""
        value = self.source.fresh()
        self.pending.append(Item(code, value))
        return value

    def guard(self, condition: str) -> None:
        """Add code that refuses the data if this condition is true."""
        self.source.add(f"if {condition}: raise misread")

    def flush(self) -> None:
        """Add code that reads the pending run."""
        if self.pending:
            items, self.pending = self.pending, []
            targets = ", ".join(item.text for item in items if item.text)
            self.source.add(f"run = {self.source.hold(runs(self.order, items))}[p & 7]")
            self.source.add(f"[{targets}] = run.unpack_from(data, p); p += run.size")


def slice_of(data: bytes, place: int, size: int) -> bytes:
    """Return ``size`` bytes. Raises ``ValueError`` if the data ends before."""
    if place + size > len(data):
        raise ValueError("the data ends before")
    return data[place : place + size]


def text_content(field_type: FieldType, order: str) -> ReadMany:
    """Return the function that reads the content of a string or wstring."""
    return read_text if field_type.name == "string" else functools.partial(read_wide, order)


def read_text(data: bytes, place: int, count: int) -> tuple[str, int]:
    """Read the content of a string."""
    content = slice_of(data, place, count)
    return content.decode("utf-8", "replace").removesuffix("\0"), place + count


def read_wide(order: str, data: bytes, place: int, count: int) -> tuple[str, int]:
    """Read the content of a wstring. Every four bytes hold a character or half a surrogate pair.

    ROS 2 writes no NUL at the end.

    Raises:
        ValueError: if four bytes hold neither a character nor half of a surrogate pair.
    """
    codec = "utf-32-le" if order == "<" else "utf-32-be"
    units = slice_of(data, place, 4 * count).decode(codec, "surrogatepass")
    text = units.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
    return text, place + 4 * count


@functools.cache
def numbers_reader(code: str, order: str, arrays: str) -> ReadMany:
    """Return a function that reads the elements of a sequence of numbers."""
    size, make = size_of(code), maker(arrays, order, code)

    def read(data: bytes, place: int, count: int) -> tuple[object, int]:
        begin = place + padding(place, size) if count else place
        content = slice_of(data, begin, size * count)
        return make(content), begin + len(content)

    return read


def maker(arrays: str, order: str, code: str) -> Make:
    """Return a function that makes a sequence of numbers from bytes."""
    if arrays == "bytes":
        return bytes
    if arrays == "numpy":
        return numpy_maker(order, code)
    if arrays == "array" and code != "?":
        return functools.partial(as_array, order, code)
    return functools.partial(as_list, order, code)


def as_list(order: str, code: str, content: bytes) -> list[object]:
    return list(struct.unpack(f"{order}{len(content) // size_of(code)}{code}", content))


def as_array(order: str, code: str, content: bytes) -> array.array[int] | array.array[float]:
    result: array.array[int] | array.array[float] = array.array(code)
    result.frombytes(content)
    if order == ">":
        result.byteswap()
    return result


def numpy_maker(order: str, code: str) -> Make:
    """Return a function that makes a numpy array from encoded numbers. The array is a copy."""
    import numpy as np  # slower to import than the rest of the package

    stored, native = np.dtype("B" if code == "?" else order + code), np.dtype(code)
    return lambda content: np.frombuffer(content, stored).astype(native)
