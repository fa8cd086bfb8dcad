"""Where data breaks off or lies: the slow way through it, which knows its path.

Only walked where a decoder has failed. A path grows from the inside out, as in ``values``.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from turtleact.errors import InvalidMessage
from turtleact.interfaces.cdr.decoding import narrow
from turtleact.interfaces.cdr.layout import (
    COUNT,
    EMPTY,
    FORMATS,
    HEADER_SIZE,
    members,
    padding,
    size_of,
)
from turtleact.interfaces.definition import ArrayForm
from turtleact.interfaces.types import fields

if TYPE_CHECKING:
    from turtleact.interfaces.definition import FieldType
    from turtleact.interfaces.types import Message

__all__ = ["locate"]


def locate(cls: type[Message], data: bytes, order: str) -> None:
    """Raises what is wrong with data that a decoder of this class has refused.

    Args:
        cls: The class.
        data: The bytes, header included.
        order: Their byte order, ``<`` or ``>``.

    Raises:
        InvalidMessage: with the path of the first value that cannot be read, and its place.
    """
    try:
        Walk(data, order).message(cls)
    except InvalidMessage as inner:
        raise InvalidMessage(f"message{inner.path}", inner.problem) from None


class Walk:
    """A walk over data.

    Attributes:
        place: Where it stands.
    """

    def __init__(self, data: bytes, order: str) -> None:
        self.data = data
        self.order = order
        self.place = HEADER_SIZE

    def message(self, cls: type[Message]) -> None:
        """Passes a message."""
        for field, nested in members(cls):
            try:
                self.field(field.type, nested)
            except InvalidMessage as inner:
                raise InvalidMessage(f".{field.name}{inner.path}", inner.problem) from None
        if not fields(cls):
            self.take(EMPTY)

    def field(self, field_type: FieldType, nested: type[Message] | None) -> None:
        """Passes a field."""
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
        """Passes a number, a text or a message."""
        if nested is not None:
            self.message(nested)
        elif field_type.is_string:
            self.text(field_type)
        else:
            self.take(FORMATS[field_type.name])

    def text(self, field_type: FieldType) -> None:
        """Passes a text."""
        count = self.count(None)
        if field_type.name == "string":
            text = self.take("B", count).decode("utf-8", "replace").removesuffix("\0")
        else:
            text = self.units(count)
        bound = field_type.string_bound
        if bound is not None and len(text) > bound:
            raise InvalidMessage("", f"at most {bound} characters, got {len(text)}")

    def units(self, count: int) -> str:
        """Passes the content of a wstring, and gives it."""
        content = self.take("I", count)
        try:
            return narrow(content, self.order)
        except ValueError as error:
            place = self.place - len(content)
            raise InvalidMessage("", f"no characters in the text at byte {place}") from error

    def count(self, bound: int | None) -> int:
        """Passes a length, and gives it."""
        (count,) = struct.unpack(f"{self.order}{COUNT}", self.take(COUNT))
        if bound is not None and count > bound:
            raise InvalidMessage("", f"at most {bound} elements, got {count}")
        return int(count)

    def take(self, code: str, count: int = 1) -> bytes:
        """Passes so many values of fixed size, and gives their bytes."""
        if count:
            self.place += padding(self.place, size_of(code))
        begin, size = self.place, size_of(code) * count
        left = max(0, len(self.data) - begin)
        if size > left:
            problem = f"cut off at byte {begin}: {size} more are needed, {left} are there"
            raise InvalidMessage("", problem)
        self.place += size
        return self.data[begin : self.place]
