"""Messages as CDR, the bytes in which ROS 2 sends them, and back.

Plain CDR, version 1: a header of four bytes, then each value at a multiple of its own size, counted
from the end of the header. Written in little endian with zeros for padding, read in either. One
encoder and one decoder a class, compiled when it is first used; they know no path, so ``locate``
looks again at data that they refuse. Knows no endpoint.

Source: OMG, Data-Distribution Service Interoperability 2.2 (RTPS), chapter 10; what ROS 2 makes of
it is in ``rosidl_typesupport_fastrtps``.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Literal, TypeVar

from turtleact.errors import InvalidMessage, InvalidOption
from turtleact.interfaces.cdr.decoding import decoder, locate
from turtleact.interfaces.cdr.encoding import encoder
from turtleact.interfaces.cdr.layout import BYTE_ORDERS, HEADER
from turtleact.interfaces.conversion import snapshot
from turtleact.interfaces.types import Message

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["HEADER", "MISREAD", "UNFIT", "decode", "encode", "reader_behind", "writer_behind"]

M = TypeVar("M", bound=Message)

ARRAYS = ("list", "array", "numpy")

#: What an encoder raises for a value that it does not take as it is.
UNFIT = (struct.error, ArithmeticError, AttributeError, TypeError, ValueError)

#: What a decoder raises for bytes that it cannot read.
MISREAD = (struct.error, ValueError)


def encode(message: Message) -> bytes:
    """A message as CDR, its header included.

    Each value is checked, as in ``snapshot``; but a number in a field of numbers is written as the
    number that it is, so that ``True`` goes for 1. Arrays of ``array`` and numpy whose elements are
    of the field's type are copied as they are, which is much quicker than a list.

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
    """The message of this class that CDR holds.

    What padding holds and what follows the message is ignored, as ROS 2 leaves garbage in both.
    Bytes that are no UTF-8 become U+FFFD. Memory and time are bounded by the length of the data,
    whatever lengths it claims.

    Args:
        cls: The class.
        data: The bytes, header included.
        arrays: What the message holds for a sequence of numbers: a ``list``; an ``array.array``
            (bools stay a list); or a numpy array of its own. ``bytes`` stay ``bytes``.

    Raises:
        InvalidMessage: with the path of the first value that is cut off, says an impossible length
            or breaks its bound, and its place in the data.
        InvalidOption: if ``arrays`` is none of the three.

    >>> from turtleact.interfaces.standard import Time
    >>> decode(Time, bytes.fromhex("00010000 01000000 02000000"))
    Time(sec=1, nanosec=2)
    """
    if arrays not in ARRAYS:
        raise InvalidOption("arrays", f"expected one of {', '.join(ARRAYS)}, got {arrays!r}")
    if type(data) is not bytes:
        data = bytes(memoryview(data))
    order = BYTE_ORDERS.get(data[:2])
    if order is None or len(data) < 4:
        problem = f"its header is 0001 or 0000 and two more bytes, not '{data[:4].hex()}'"
        raise InvalidMessage("message", f"no plain CDR: {problem}")
    read: Callable[[bytes], M] = decoder(cls, order, arrays)
    try:
        return read(data)
    except MISREAD:
        locate(cls, data, order)
        raise


def writer_behind(
    cls: type[M], place: int, *, is_strict: bool = False
) -> Callable[[object, bytes], bytes]:
    """The function that writes messages of this class behind something else.

    It is given a message and what stands before it, and raises one of `UNFIT` for a message that it
    does not take as it is.

    Args:
        cls: The class.
        place: Where the message begins: behind the header, at once or by a multiple of eight bytes.
        is_strict: Whether it is to take only what ``snapshot`` would copy as it is.
    """
    return encoder(cls, place, is_strict=is_strict)


def reader_behind(cls: type[M], place: int) -> Callable[[bytes], M]:
    """The function that reads what `writer_behind` writes.

    It raises one of `MISREAD` for what it cannot read, and takes any data for little endian.
    """
    return decoder(cls, BYTE_ORDERS[HEADER[:2]], "list", place)
