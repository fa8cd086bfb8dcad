"""Encodes and decodes what travels beside the messages: attachments, and errors of services.

An attachment holds a message's sender, time and sequence number.

==  ====  =============================================================================
at  size
==  ====  =============================================================================
0   8     sequence number, a little-endian int64 from 1, counted by publisher or client
8   8     time of sending, a little-endian int64: ns since the Unix epoch
16  1     16, the size of the gid
17  16    gid of the publisher; in requests and replies, of the client
33  …     a note: text in UTF-8, written and read only by turtleact
==  ====  =============================================================================

A reply carries the sequence number and gid of its request. rmw_zenoh reads only the first 33 bytes
of an attachment, so it ignores the note that turtleact appends.

The error of a service is a text and a kind, which names the exception's class. Servers encode
errors and clients decode them. Zenoh itself sends an error if a call takes too long.

Source: rmw_zenoh_cpp ``detail/attachment_helpers.cpp``, Jazzy from 0.2.4 to Rolling.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from time import time_ns

import msgspec

from turtleact.errors import (
    InvalidMessage,
    ServerUnavailable,
    ServiceError,
    ServiceTimeout,
    TurtleactError,
)
from turtleact.tasks.failures import shortened, summary
from turtleact.transports.rmw_zenoh.config import PATIENCE

__all__ = [
    "Attachment",
    "Attachments",
    "count_in",
    "decode_error",
    "encode_error",
    "gid_in",
    "note_in",
    "read_attachment",
    "write_attachment",
]

GID_SIZE = 16

#: An attachment without a note.
LAYOUT = struct.Struct("<qqB16s")

#: The size of an attachment without a note.
SIZE = LAYOUT.size

#: The longest note (bytes); longer ones are cut.
LONGEST_NOTE = 4096

#: Where the note is in an attachment.
NOTE = slice(SIZE, SIZE + LONGEST_NOTE)


class Attachment(msgspec.Struct, frozen=True):
    """The data attached to a message.

    Attributes:
        sequence: The sequence number, at least 0.
        stamp: When the message was sent (ns since the Unix epoch).
        gid: The 16 bytes that identify the publisher or client.
        note: A text that only turtleact writes and reads; empty if there is none.
    """

    sequence: int
    stamp: int
    gid: bytes
    note: str = ""


class Attachments:
    """Makes the attachments of one endpoint's messages, with sequence numbers and times.

    Args:
        gid: The gid of the endpoint.
    """

    def __init__(self, gid: bytes) -> None:
        self._gid = gid
        self._sequence = 0

    def next(self, note: str = "") -> bytes:
        """Return the attachment of the next message."""
        self._sequence += 1
        return write_attachment(self._sequence, time_ns(), self._gid, note)


def write_attachment(sequence: int, stamp: int, gid: bytes, note: str = "") -> bytes:
    """Encode an attachment. A note longer than 4,096 bytes is cut to that size."""
    data = LAYOUT.pack(sequence, stamp, GID_SIZE, gid)
    return data + _note_tail(note) if note else data


@lru_cache(maxsize=4)  # almost all replies of a server have the same note
def _note_tail(note: str) -> bytes:
    tail = note.encode(errors="backslashreplace")  # a note must never make its message fail
    if len(tail) > LONGEST_NOTE:
        tail = tail[:LONGEST_NOTE].decode(errors="ignore").encode()
    return tail


def read_attachment(data: bytes) -> Attachment:
    """Decode an attachment.

    A note longer than 4,096 bytes is cut. Bytes of a note that are not UTF-8 are replaced.

    Raises:
        InvalidMessage: if the bytes are not an attachment.
    """
    if len(data) < SIZE:
        raise _invalid(f"expected {SIZE} bytes, got {len(data)}")
    sequence, stamp, size, gid = LAYOUT.unpack_from(data)
    if size != GID_SIZE:
        raise _invalid(f"expected a gid of {GID_SIZE} bytes, not of {size}")
    if sequence < 0 or stamp < 0:
        raise _invalid(f"sequence number and time must not be negative: {sequence}, {stamp}")
    note = note_in(data) if len(data) > SIZE else ""  # most requests carry none
    return Attachment(sequence, stamp, gid, note)


def note_in(data: bytes) -> str:
    """Return the note in an attachment. Unlike `read_attachment`, this accepts any bytes."""
    return data[NOTE].decode(errors="replace")


def gid_in(data: bytes) -> bytes:
    """Return the gid in an attachment. Unlike `read_attachment`, this accepts any bytes."""
    return data[SIZE - GID_SIZE : SIZE]


def count_in(data: bytes) -> int:
    """Return the sequence number in an attachment. Like `gid_in`, this accepts any bytes."""
    return int.from_bytes(data[:8], "little")


def _invalid(problem: str) -> InvalidMessage:
    return InvalidMessage("attachment", problem)


def encode_error(error: TurtleactError) -> tuple[str, str]:
    """Encode an error as the text and the kind from which `decode_error` restores the error."""
    if isinstance(error, InvalidMessage):
        return shortened(str(error)), "InvalidMessage"
    if isinstance(error, ServerUnavailable):
        return shortened(error.problem), "ServerUnavailable"
    if isinstance(error, ServiceError):
        return shortened(error.reason), "ServiceError"
    return summary(error), "ServiceError"


def decode_error(name: str, text: str, kind: str) -> TurtleactError:
    """Restore an error of the service ``name`` from the text and the kind.

    An error from a program other than turtleact becomes a `ServiceError` with the same text.

    >>> text, kind = encode_error(ServiceError("/add", "too many: at most 3"))
    >>> decode_error("/add", text, kind)
    ServiceError('/add', 'too many: at most 3')
    """
    if kind == "InvalidMessage":
        path, _, problem = text.partition(": ")
        return InvalidMessage(path, problem)
    if kind == "Timeout":
        return ServiceTimeout(name, PATIENCE)
    if kind == "ServerUnavailable":
        return ServerUnavailable(name, text, kind="service")
    return ServiceError(name, text)
