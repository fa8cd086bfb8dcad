"""Converts messages and replies to frames of JSON or CBOR, and clients' values to messages.

In JSON, some values are written and read as in rosbridge:

- ``uint8[]`` and ``char[]`` are written as base64 text. A list of numbers is also accepted.
- NaN and infinity are written as null. In place of a floating-point number, null is read as NaN.
- A time has the members ``sec`` and ``nanosec``. The names ``secs`` and ``nsecs`` are also
  accepted.
- A whole number is accepted in place of a floating-point number, because JavaScript writes ``1``
  for ``1.0``.
- A list is accepted in place of the outermost object. The list holds the values of the fields in
  their order.

In CBOR, ``uint8[]`` and ``char[]`` are byte strings, and other lists of numbers are typed arrays. A
client's large values are checked in a thread, because a million numbers take seconds, and other
clients would have to wait.

Source: rosbridge_library ``message_conversion.py`` and ``cbor_conversion.py``; RFC 8746, section 2;
``ROSBRIDGE_PROTOCOL.md`` of rosbridge_suite, version 2; PNG 1.2.
"""

from __future__ import annotations

import base64
import binascii
import functools
import math
import re
import struct
from collections.abc import Callable
from typing import Any, Final, Literal, TypeAlias, TypeVar, cast

import cbor2
import msgspec
from anyio import to_thread

from turtleact.errors import InvalidMessage
from turtleact.interfaces import Message, encode, fields, from_dict
from turtleact.interfaces.definition import Field
from turtleact.interfaces.types import nested_classes
from turtleact.sim.pictures import encode_png
from turtleact.web.operations import Id

__all__ = [
    "COMPRESSIONS",
    "Compression",
    "Frame",
    "Rendering",
    "cbor_values",
    "is_large",
    "json_values",
    "message_from",
    "png",
    "read_message",
    "reply",
    "request",
]

M = TypeVar("M", bound=Message)
Convert = Callable[[Any], object]

BASE64 = frozenset({"uint8", "char"})
FLOATS = frozenset({"float32", "float64"})
TIMES = frozenset({"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"})
# As in ROS 1. Clients that were written for it still send these names.
TIME_SPELLINGS = {"secs": "sec", "nsecs": "nanosec"}

TYPED_ARRAYS = {
    "uint16": (69, "H"),
    "uint32": (70, "I"),
    "uint64": (71, "Q"),
    "byte": (72, "B"),
    "int8": (72, "b"),
    "int16": (77, "h"),
    "int32": (78, "i"),
    "int64": (79, "q"),
    "float32": (85, "f"),
    "float64": (86, "d"),
}
"""For each type of number: the CBOR tag of a little-endian array, and the code of `struct`."""

LARGE: Final = 2000
"""This many values can be checked in a few milliseconds."""

Frame: TypeAlias = str | bytes
Compression = Literal["none", "png", "cbor", "cbor-raw"]

COMPRESSIONS: tuple[Compression, ...] = ("none", "png", "cbor", "cbor-raw")

ENCODER = msgspec.json.Encoder()
beyond_ascii = re.compile(r"[^\x00-\x7f]")


def request(op: str, **members: object) -> str:
    """Return a frame as JSON text, with its members in the given order."""
    return ENCODER.encode({"op": op, **members}).decode()


def reply(op: str, id: Id, **members: object) -> str:
    """Return a frame that answers a request, with the request's id, if the request has one."""
    if id is not None:
        members["id"] = id
    return request(op, **members)


def png(text: str) -> str:
    """Return a ``png`` frame, which contains another frame as a picture.

    The pixels of the picture are the bytes of ``text``, padded with line breaks. Clients decode
    each byte as Latin-1, so characters beyond ASCII are escaped.
    """
    data = beyond_ascii.sub(_escaped, text).encode()
    width = max(1, math.isqrt(len(data) // 3))
    row = width * 3
    height = max(1, -(-len(data) // row))
    picture = encode_png(data.ljust(row * height, b"\n"), channels=3, width=width)
    return request("png", data=base64.b64encode(picture).decode())


class Rendering:
    """A message of a topic, and the frames made from it. Each frame is made once for all clients.

    Args:
        message: The message.
        now: When the message was received (ns since the epoch). ``cbor-raw`` frames contain this
            time.
    """

    __slots__ = ("_made", "_message", "_now")

    def __init__(self, message: Message, now: int) -> None:
        self._message = message
        self._now = now
        self._made: dict[tuple[Compression, str], Frame] = {}

    def frame(self, compression: Compression, topic: str) -> Frame:
        """Return the ``publish`` frame for clients that spell the topic's name like ``topic``."""
        key = (compression, topic)
        made = self._made.get(key)
        if made is None:
            made = self._made[key] = MAKERS[compression](self._message, topic, self._now)
        return made


def json_values(message: Message) -> object:
    """Return the value, often the message itself, that msgspec writes as a message's JSON."""
    convert = _writer(type(message), is_json=True)
    return message if convert is None else convert(message)


def cbor_values(message: Message) -> dict[str, object]:
    """Return a value that cbor2 encodes as a message's CBOR."""
    convert = cast("Convert", _writer(type(message), is_json=False))
    return cast("dict[str, object]", convert(message))


def message_from(cls: type[M], values: object, *, root: str) -> M:
    """Make a message from a client's values. Fields without a value keep their defaults.

    Args:
        cls: The class of the message.
        values: A dict of values by field name, or a list of values in the order of the fields. With
            None, all fields keep their defaults.
        root: The name of the whole message. Paths in errors begin with this name.

    Raises:
        InvalidMessage: if a value or a name does not fit. The error contains the path of the first
            value or name that does not fit.

    >>> from turtleact.interfaces.standard import Point, Time
    >>> message_from(Point, [1, 2], root="args")
    Point(x=1.0, y=2.0, z=0.0)
    >>> message_from(Time, {"secs": 1, "nsecs": 2}, root="args")
    Time(sec=1, nanosec=2)
    """
    if values is None:
        values = {}
    if isinstance(values, list):
        known = fields(cls)
        if len(values) > len(known):
            raise InvalidMessage(root, f"{len(values)} values for {len(known)} fields")
        values = {field.name: value for field, value in zip(known, values, strict=False)}
    convert = _reader(cls)
    return from_dict(cls, values if convert is None else convert(values), root=root)  # type: ignore[arg-type]  # it checks that


async def read_message(cls: type[M], values: object, *, root: str) -> M:
    """Make a message as `message_from` does. Use a thread if the values are large.

    Raises:
        InvalidMessage: if a value or a name does not fit. The error contains the path of the first
            value or name that does not fit.
    """
    # A large message takes seconds to check. Counting its values first takes little, and most
    # messages are small: a thread for each would cost more than the check.
    if is_large(values):
        return await to_thread.run_sync(functools.partial(message_from, cls, values, root=root))
    return message_from(cls, values, root=root)


def is_large(values: object) -> bool:
    """Whether the objects and lists in a value hold more than `LARGE` values together.

    >>> is_large({"x": [1] * 100}), is_large({"x": {"y": [1] * 3000}})
    (False, True)
    """
    count, waiting = 0, [values]
    while waiting:
        each: Any = waiting.pop()
        inner = each.values() if isinstance(each, dict) else each if isinstance(each, list) else ()
        count += len(inner)
        if count > LARGE:
            return True
        waiting.extend(inner)
    return False


def _json(message: Message, topic: str, _now: int) -> Frame:
    return request("publish", topic=topic, msg=json_values(message))


def _png(message: Message, topic: str, _now: int) -> Frame:
    return png(request("publish", topic=topic, msg=json_values(message)))


def _cbor(message: Message, topic: str, _now: int) -> Frame:
    return cbor2.dumps({"op": "publish", "topic": topic, "msg": cbor_values(message)})


def _cbor_raw(message: Message, topic: str, now: int) -> Frame:
    seconds, nanoseconds = divmod(now, 1_000_000_000)
    content = {"secs": seconds, "nsecs": nanoseconds, "bytes": encode(message)}
    return cbor2.dumps({"op": "publish", "topic": topic, "msg": content})


MAKERS: dict[Compression, Callable[[Message, str, int], Frame]] = {
    "none": _json,
    "png": _png,
    "cbor": _cbor,
    "cbor-raw": _cbor_raw,
}


def _escaped(found: re.Match[str]) -> str:
    """Return a character's escape sequence in JSON, with one or two UTF-16 units."""
    units = struct.unpack(">2H", found[0].encode("utf-16-be").rjust(4, b"\x00"))
    return "".join(f"\\u{unit:04x}" for unit in cast("tuple[int, ...]", units) if unit)


# out


@functools.cache
def _writer(cls: type[Message], *, is_json: bool) -> Convert | None:
    """Return a function that turns messages into plain values; None if they need no change."""
    converters = [
        (field, _field_writer(field, nested, is_json=is_json))
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
    ]
    # The usual case: msgspec then writes the message itself, without a dict for each level.
    if is_json and all(c is None and f.name == f.attribute for f, c in converters):
        return None

    def convert(message: Message) -> dict[str, object]:
        return {
            field.name: getattr(message, field.attribute)
            if change is None
            else change(getattr(message, field.attribute))
            for field, change in converters
        }

    return convert


def _field_writer(field: Field, nested: type[Message] | None, *, is_json: bool) -> Convert | None:
    kind = field.type
    if nested is not None:
        element = _writer(nested, is_json=is_json)
        if not kind.is_sequence or element is None:
            return element
        return lambda items: [element(item) for item in items]
    if not kind.is_sequence:
        return None
    if kind.name in BASE64:
        return bytes  # msgspec writes them as base64
    if not is_json and kind.name in TYPED_ARRAYS:
        return functools.partial(_typed_array, *TYPED_ARRAYS[kind.name])
    return list if kind.name == "byte" else None


def _typed_array(tag: int, code: str, numbers: list[float]) -> cbor2.CBORTag:
    return cbor2.CBORTag(tag, struct.pack(f"<{len(numbers)}{code}", *numbers))


# in


@functools.cache
def _reader(cls: type[Message]) -> Convert | None:
    """Return a function that prepares values for `from_dict`; None if they need no change."""
    converters = {
        field.name: change
        for field, nested in zip(fields(cls), nested_classes(cls), strict=True)
        if (change := _field_reader(field, nested)) is not None
    }
    spellings = TIME_SPELLINGS if cls.type_name in TIMES else {}
    if not converters and not spellings:
        return None

    def convert(values: object) -> object:
        if not isinstance(values, dict):
            return values
        return {
            spellings.get(name, name): converters[name](value) if name in converters else value
            for name, value in values.items()
        }

    return convert


def _field_reader(field: Field, nested: type[Message] | None) -> Convert | None:
    kind = field.type
    if kind.is_sequence and kind.name in BASE64:
        return functools.partial(_from_base64, field.name)
    element = _reader(nested) if nested is not None else None
    if kind.name in FLOATS:
        element = _number
    if element is None or not kind.is_sequence:
        return element
    return functools.partial(_each, element)


def _each(element: Convert, values: object) -> object:
    return [element(value) for value in values] if isinstance(values, list) else values


def _number(value: object) -> object:
    # JSON has no NaN. As in rosbridge, it is written as null, so null means NaN on the way back.
    return math.nan if value is None else value


def _from_base64(name: str, value: object) -> object:
    if not isinstance(value, str):
        return value
    try:
        return binascii.a2b_base64(value, strict_mode=True)
    except ValueError as error:
        raise InvalidMessage(name, f"expected base64 text or a list of numbers: {error}") from None
