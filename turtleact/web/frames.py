"""What the server says, as frames: text for JSON, bytes for CBOR. Pure.

Never an operation that the client has not asked for: its libraries fail on those they do not know.

Source: ``ROSBRIDGE_PROTOCOL.md`` of rosbridge_suite, version 2; PNG 1.2; what its clients accept.
"""

from __future__ import annotations

import base64
import math
import re
import struct
import zlib
from collections.abc import Callable
from typing import Literal, TypeAlias, cast

import cbor2
import msgspec

from turtleact.interfaces import Message, encode
from turtleact.web.operations import Id
from turtleact.web.values import cbor_values, json_values

__all__ = ["COMPRESSIONS", "Compression", "Frame", "Rendering", "png", "reply", "request"]

Frame: TypeAlias = str | bytes
Compression = Literal["none", "png", "cbor", "cbor-raw"]

COMPRESSIONS: tuple[Compression, ...] = ("none", "png", "cbor", "cbor-raw")

ENCODER = msgspec.json.Encoder()
beyond_ascii = re.compile(r"[^\x00-\x7f]")


def request(op: str, **members: object) -> str:
    """A frame as JSON text, its members in this order."""
    return ENCODER.encode({"op": op, **members}).decode()


def reply(op: str, id: Id, **members: object) -> str:
    """The same, with the id of what it answers; without, if that had none."""
    if id is not None:
        members["id"] = id
    return request(op, **members)


def png(text: str) -> str:
    """A frame inside a picture: the bytes of its pixels are the text, padded with line breaks.

    Clients decode it byte by byte as Latin-1, so the text inside is ASCII.
    """
    data = beyond_ascii.sub(_escaped, text).encode()
    width = max(1, math.isqrt(len(data) // 3))
    row = width * 3
    height = max(1, -(-len(data) // row))
    data = data.ljust(row * height, b"\n")
    rows = b"".join(b"\x00" + data[at : at + row] for at in range(0, len(data), row))
    picture = (
        b"\x89PNG\r\n\x1a\n"
        + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
        + _chunk(b"IDAT", zlib.compress(rows))
        + _chunk(b"IEND", b"")
    )
    return request("png", data=base64.b64encode(picture).decode())


class Rendering:
    """A topic's message, and the frames made of it; each is made once, for all who want it.

    Args:
        message: The message.
        now: The time (ns since the epoch), which ``cbor-raw`` tells.
    """

    __slots__ = ("_made", "_message", "_now")

    def __init__(self, message: Message, now: int) -> None:
        self._message = message
        self._now = now
        self._made: dict[tuple[Compression, str], Frame] = {}

    def frame(self, compression: Compression, topic: str) -> Frame:
        """The ``publish`` frame; the topic is spelled as its client has spelled it."""
        key = (compression, topic)
        made = self._made.get(key)
        if made is None:
            made = self._made[key] = MAKERS[compression](self._message, topic, self._now)
        return made


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


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _escaped(found: re.Match[str]) -> str:
    """A character as JSON escapes it, in UTF-16."""
    units = struct.unpack(">2H", found[0].encode("utf-16-be").rjust(4, b"\x00"))
    return "".join(f"\\u{unit:04x}" for unit in cast("tuple[int, ...]", units) if unit)
