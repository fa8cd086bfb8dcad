"""Converts messages to CDR, the bytes in which ROS 2 sends them, and back.

Each endpoint comes with a `WireFormat`, so a transport to other processes needs no message classes.

The encoding is plain CDR, version 1. Data begins with a header of four bytes. Each value begins at
a multiple of the value's size, counted from the end of the header. Data is written in little endian
with zeros for padding, and read in either byte order.

Each class gets one `Codec`, which is compiled on first use.

An encoder or decoder does not say which value is wrong. A decoder never creates more elements than
the data has bytes, whatever length the data claims: each element takes at least one byte, and the
decoder stops at the end of the data.

Source: OMG, Data-Distribution Service Interoperability 2.2 (RTPS), chapter 10; ROS 2 implements it
in ``rosidl_typesupport_fastrtps``.
"""

from __future__ import annotations

import array
import functools
import itertools
import struct
import sys
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeVar, cast

from turtleact.errors import InvalidMessage, InvalidOption
from turtleact.interfaces.classes import implied
from turtleact.interfaces.conversion import Layout, Leaf, name_of, snapshot
from turtleact.interfaces.definition import BYTE_TYPES, ArrayForm, FieldType
from turtleact.interfaces.standard.unique_identifier_msgs.msg import UUID
from turtleact.interfaces.type_hash import type_hash
from turtleact.interfaces.types import Action, Message, Service

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from turtleact.interfaces.types import Interface

    #: Makes a sequence from the bytes of its elements.
    Make = Callable[[bytes], object]

__all__ = [
    "BYTE_ORDERS",
    "FORMATS",
    "GOAL_ID",
    "HEADER",
    "MISREAD",
    "UNFIT",
    "FeedbackFormat",
    "WireFormat",
    "decode",
    "decoder",
    "encode",
    "encoder",
]

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
#: The largest alignment.
WIDEST = 8

#: The element kinds of arrays, by ``memoryview``'s codes.
KINDS = {
    "?": "bool",
    **dict.fromkeys("bhilq", "signed"),
    **dict.fromkeys("BHILQ", "unsigned"),
    **dict.fromkeys("fd", "float"),
}

GOAL_ID: Final = slice(4, 20)
"""The bytes of a feedback message that hold the goal id, in either byte order."""

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


class WireFormat:
    """Encodes and decodes the messages of one endpoint.

    Creating a WireFormat is cheap, because the codec is built on first use.

    Args:
        interface: The message or service class, or a function that returns the class when needed.
        asks: Whether the endpoint is the client of a service, and therefore sends requests.

    >>> from turtleact.interfaces.standard import Time
    >>> time = WireFormat(Time)
    >>> time.decode(time.encode(Time(sec=1)))
    Time(sec=1, nanosec=0)
    """

    def __init__(self, interface: Interface | Callable[[], object], *, asks: bool = False) -> None:
        self._interface = interface
        self._asks = asks

    @cached_property
    def type_hash(self) -> str:
        """The type hash of the message or of the whole service.

        Raises:
            InvalidInterface: if the class has no type name.
        """
        return type_hash(self._found)

    def encode(self, message: object) -> bytes:
        """Encode a message.

        Raises:
            InvalidMessage: if the message is of another class, or a value does not fit its type.
        """
        if type(message) is not self._classes[0]:
            given = type(message)
            got = name_of(given) if issubclass(given, Message) else given.__name__
            problem = f"expected {self._classes[0].type_name}, not {got}"
            raise InvalidMessage("message", problem)
        try:
            return encoder(self._classes[0])(message)
        except UNFIT:
            return encode(message)  # converts the value, or raises a clear error

    def decode(self, data: bytes) -> Message:
        """Decode a message.

        Raises:
            InvalidMessage: if the bytes are not a message of the expected class.
        """
        return decode(self._classes[1], data)

    @cached_property
    def _found(self) -> Interface:
        given = self._interface
        return given if isinstance(given, type) else cast("Interface", given())

    @cached_property
    def _classes(self) -> tuple[type[Message], type[Message]]:
        """The class of messages to send, and the class of messages to receive."""
        found = self._found
        if not issubclass(found, Service):
            message = cast("type[Message]", found)
            return message, message
        if self._asks:
            return found.Request, found.Response
        return found.Response, found.Request


class FeedbackFormat(WireFormat):
    """Encodes and decodes the messages on an action's feedback topic.

    A feedback message consists of a goal id and the feedback. Feedback is frequent, so this class
    saves time: it encodes and decodes the goal id and the feedback without creating an object for
    the whole message.

    Args:
        action: The class of the action.

    >>> from turtleact.interfaces.standard import Fibonacci
    >>> feedback = FeedbackFormat(Fibonacci)
    >>> feedback.read(feedback.write(bytes(16), Fibonacci.Feedback([0, 1])))
    Feedback(partial_sequence=[0, 1])
    """

    def __init__(self, action: type[Action]) -> None:
        super().__init__(lambda: implied(action).feedback_message)
        self._feedback = action.Feedback

    def write(self, goal_id: bytes, feedback: Message) -> bytes:
        """Encode a feedback message for the goal with this id (16 bytes).

        Raises:
            InvalidMessage: if a value does not fit its type.
        """
        try:
            return encoder(self._feedback)(feedback, HEADER + goal_id)
        except UNFIT:
            message: Any = self._classes[0]
            return self.encode(message(UUID(goal_id), feedback))

    def read(self, data: bytes) -> Message:
        """Decode only the feedback in a feedback message. The goal id is ``data[GOAL_ID]``.

        Raises:
            InvalidMessage: if the bytes are not a feedback message of the action.
        """
        if data[:2] == HEADER[:2]:
            try:
                read: Message = decoder(self._feedback, place=GOAL_ID.stop)(data)
                return read
            except MISREAD:
                pass  # the decoding below raises again, with a clear error
        message: Any = WireFormat.decode(self, data)
        return cast("Message", message.feedback)


@functools.cache
def encoder(cls: type[M]) -> Callable[..., bytes]:
    """Return a function that encodes messages of this class.

    The function takes the message, and optionally the bytes to put before the message, header
    included. For a message that it cannot encode unchanged, the function raises one of `UNFIT`.
    """
    write = message_codec(cls).write

    def encoded(message: M, front: bytes = HEADER) -> bytes:
        out = bytearray(front)
        write(message, out)
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
    read = message_codec(cls, order, arrays).read

    def decoded(data: bytes) -> M:
        message: M = read(data, place)[0]
        return message

    return decoded


class Codec(NamedTuple):
    """How to write and read the values of one type.

    Attributes:
        write: Appends a value to a bytearray. It accepts values of the expected Python type, and
            other values that ``struct`` can pack, such as an int for a float.
        read: Reads a value at a place, and returns the value with the place after it.
    """

    write: Callable[[Any, bytearray], None]
    read: Callable[[bytes, int], tuple[Any, int]]


class ManyCodec(NamedTuple):
    """How to write and read the elements of a sequence, without its length."""

    write: Callable[[Any, bytearray], None]
    read: Callable[[bytes, int, int], tuple[Any, int]]


@functools.cache
def message_codec(cls: type[Message], order: str = "<", arrays: str = "list") -> Codec:
    """Compile the codec of a message class. A message without fields takes one byte.

    Consecutive numbers, also those in nested messages, form a run, which ``struct`` packs at once.
    """
    layout = Layout(cls)
    bools = [leaf for leaf in layout.leaves if leaf.kind == FieldType("bool")]
    layout.checks += [f"type({leaf.text}) is bool" for leaf in bools]
    write = [f"if not ({' and '.join(layout.checks)}): raise TypeError('another class')"]
    read: list[str] = []
    values = (f"v{number}" for number in itertools.count())
    targets: list[str] = []
    for is_run, group in itertools.groupby(layout.leaves, is_number):
        leaves = list(group)
        named = [next(values) for leaf in leaves if leaf.text]
        targets += named
        if is_run:
            places = layout.hold(
                runs(order, [FORMATS[leaf.kind.name] if leaf.text else "x" for leaf in leaves])
            )
            texts = ", ".join(leaf.text for leaf in leaves if leaf.text)
            write.append(f"out += {places}[len(out) & 7].pack({texts})")
            read.append(f"run = {places}[p & 7]")
            read.append(f"[{', '.join(named)}] = run.unpack_from(data, p)")
            read.append("p += run.size")
            continue
        for leaf, value in zip(leaves, named, strict=True):
            codec = leaf_codec(leaf, order, arrays)
            write.append(f"{layout.hold(codec.write)}({leaf.text}, out)")
            read.append(f"{value}, p = {layout.hold(codec.read)}(data, p)")
    read.append(f"return {layout.made(targets)}, p")
    return Codec(layout.function("m, out", *write), layout.function("data, p", *read))


def is_number(leaf: Leaf) -> bool:
    """Whether a value is a single number or bool, or the byte of a message without fields."""
    return leaf.kind.name in FORMATS and not leaf.kind.is_sequence


def runs(order: str, codes: Sequence[str]) -> list[struct.Struct]:
    """Return the ``Struct`` of consecutive numbers for each remainder of their place modulo 8.

    The padding before a value depends on its place.
    """
    found = []
    for place in range(WIDEST):
        text, at = order, place
        for code in codes:
            pad = padding(at, size_of(code))
            text += f"{pad}x{code}"
            at += pad + size_of(code)
        found.append(struct.Struct(text))
    return found


def leaf_codec(leaf: Leaf, order: str, arrays: str) -> Codec:
    """Return the codec of a text or a sequence."""
    kind = leaf.kind
    if kind.name in FORMATS:
        many = numbers_codec(kind.name, order, "bytes" if leaf.is_bytes else arrays)
        return sequence_codec(kind, many, order)
    if leaf.nested is None:
        element = text_codec(kind.name, kind.string_bound, order)
    else:
        element = message_codec(leaf.nested, order, arrays)
    return sequence_codec(kind, list_codec(element), order) if kind.is_sequence else element


def text_codec(name: str, bound: int | None, order: str) -> Codec:
    """Return the codec of a string or wstring: its length, then its characters."""
    places, longest = runs(order, [COUNT]), sys.maxsize if bound is None else bound
    code, read_text = (narrow, read_narrow) if name == "string" else (wide, READ_WIDE[order])
    width = 1 if name == "string" else 4

    def write(text: str, out: bytearray) -> None:
        if len(text) > longest:
            raise ValueError("a text beyond its bound")
        content = code(text)
        out += places[len(out) & 7].pack(len(content) // width) + content

    def read(data: bytes, place: int) -> tuple[str, int]:
        length = places[place & 7]
        [count] = length.unpack_from(data, place)
        content, end = slice_of(data, place + length.size, count * width)
        text = read_text(content)
        if len(text) > longest:
            raise ValueError("a text beyond its bound")
        return text, end

    return Codec(write, read)


def sequence_codec(kind: FieldType, many: ManyCodec, order: str) -> Codec:
    """Return the codec of a sequence: its length, unless that is fixed, then its elements."""
    places = runs(order, [COUNT])
    is_fixed, is_bounded = kind.form is ArrayForm.FIXED, kind.form is ArrayForm.BOUNDED

    def check(count: int) -> None:
        if (is_fixed and count != kind.size) or (is_bounded and count > kind.size):
            raise ValueError("a sequence of another length")

    def write(value: Sequence[Any], out: bytearray) -> None:
        check(len(value))
        if not is_fixed:
            out += places[len(out) & 7].pack(len(value))
        many.write(value, out)

    def read(data: bytes, place: int) -> tuple[Any, int]:
        if is_fixed:
            return many.read(data, place, kind.size)
        length = places[place & 7]
        [count] = length.unpack_from(data, place)
        check(count)
        return many.read(data, place + length.size, count)

    return Codec(write, read)


def list_codec(element: Codec) -> ManyCodec:
    """Return the codec of the texts or messages in a list."""
    write_one, read_one = element

    def write(values: object, out: bytearray) -> None:
        if type(values) is not list:
            raise TypeError("not a list")
        for value in values:
            write_one(value, out)

    def read(data: bytes, place: int, count: int) -> tuple[list[Any], int]:
        values = []
        for _ in range(count):
            value, place = read_one(data, place)
            values.append(value)
        return values, place

    return ManyCodec(write, read)


@functools.cache
def numbers_codec(name: str, order: str, arrays: str) -> ManyCodec:
    """Return the codec of the numbers in a sequence. There is padding only if there are numbers."""
    size, make = size_of(FORMATS[name]), maker(arrays, order, FORMATS[name])

    def write(values: Sequence[Any], out: bytearray) -> None:
        content = content_of(name, values)
        if content:
            out += bytes(padding(len(out), size)) + content

    def read(data: bytes, place: int, count: int) -> tuple[Any, int]:
        begin = place + padding(place, size) if count else place
        content, end = slice_of(data, begin, size * count)
        return make(content), end

    return ManyCodec(write, read)


def size_of(code: str) -> int:
    """Return the size of a value with this format of ``struct``, in bytes."""
    return struct.calcsize(f"<{code}")


def padding(place: int, size: int) -> int:
    """Return how many bytes of padding come at this place before a value of this size."""
    return (len(HEADER) - place) % size


def slice_of(data: bytes, place: int, size: int) -> tuple[bytes, int]:
    """Return ``size`` bytes, and the place after them. Raise an error if the data ends before."""
    if place + size > len(data):
        raise ValueError("the data ends before")
    return data[place : place + size], place + size


def narrow(text: str) -> bytes:
    """Encode the characters of a string, and the NUL that ends it."""
    return str.encode(text) + b"\0"


def wide(text: str) -> bytes:
    """Encode the characters of a wstring: each UTF-16 unit takes four bytes, as in ROS 2."""
    units = str.encode(text, "utf-16-le")
    count = len(units) // 2
    return struct.pack(f"<{count}I", *struct.unpack(f"<{count}H", units))


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


def read_narrow(content: bytes) -> str:
    """Decode the characters of a string."""
    return content.decode("utf-8", "replace").removesuffix("\0")


def read_wide(codec: str, content: bytes) -> str:
    """Decode the characters of a wstring. ROS 2 writes no NUL at the end.

    Raises:
        ValueError: if four bytes hold neither a character nor half of a surrogate pair.
    """
    units = content.decode(codec, "surrogatepass")
    return units.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")


READ_WIDE = {
    "<": functools.partial(read_wide, "utf-32-le"),
    ">": functools.partial(read_wide, "utf-32-be"),
}


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
