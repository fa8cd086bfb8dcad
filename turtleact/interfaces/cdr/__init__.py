"""Converts messages to CDR, the bytes in which ROS 2 sends them, and back.

The encoding is plain CDR, version 1. Data begins with a header of four bytes. Each value begins at
a multiple of the value's size, counted from the end of the header. Data is written in little endian
with zeros for padding, and read in either byte order. Each class gets one encoder and one decoder,
compiled on first use. An encoder or decoder does not say which value is wrong. If a decoder refuses
data, ``locate`` reads the data again to find the wrong value. This package does not depend on
topics and services.

Source: OMG, Data-Distribution Service Interoperability 2.2 (RTPS), chapter 10; ROS 2 implements it
in ``rosidl_typesupport_fastrtps``.
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

#: The exceptions of an encoder for a value that it cannot write unchanged.
UNFIT = (struct.error, ArithmeticError, AttributeError, TypeError, ValueError)

#: The exceptions of a decoder for bytes that it cannot read.
MISREAD = (struct.error, ValueError)


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
        InvalidMessage: if a value is cut off, has an impossible length or breaks its bound. The
            error names the first such value.
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
    if order is None or len(data) < 4:
        problem = f"its header must be 0000 or 0001 and two more bytes, not '{data[:4].hex()}'"
        raise InvalidMessage("message", f"not plain CDR: {problem}")
    read: Callable[[bytes], M] = decoder(cls, order, arrays)
    try:
        return read(data)
    except MISREAD:
        locate(cls, data, order)
        raise


def writer_behind(cls: type[M], place: int) -> Callable[[object, bytes], bytes]:
    """Return a function that encodes a message of this class and appends it to other bytes.

    The function takes the message and the bytes to append the message to. These bytes begin with
    the header. The function returns all these bytes with the encoded message at the end. If the
    function cannot encode the message unchanged, it raises one of `UNFIT`.

    Args:
        cls: The class of the message.
        place: Where the message begins, in bytes from the start of the header.
    """
    return encoder(cls, place)


def reader_behind(cls: type[M], place: int) -> Callable[[bytes], M]:
    """Return a function that decodes a message that follows other bytes; see `writer_behind`.

    The function raises one of `MISREAD` for bytes that it cannot read. It reads the bytes as little
    endian, whatever the header says.
    """
    return decoder(cls, BYTE_ORDERS[HEADER[:2]], "list", place)
