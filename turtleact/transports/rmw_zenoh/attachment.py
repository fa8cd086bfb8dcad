"""What travels beside each message: who sent it, when, and as which one in a row. Pure.

==  ====  =============================================================================
at  size
==  ====  =============================================================================
0   8     sequence number, a little-endian int64 from 1, counted by publisher or client
8   8     time of sending, a little-endian int64: ns since the Unix epoch
16  1     16, the length of what comes next
17  16    gid of the publisher; of the client, in a request and in its reply
33  …     a note: text in UTF-8, which only peers of our kind write and read
==  ====  =============================================================================

A reply has the sequence number and gid of its request. rmw_zenoh reads the first 33 bytes, field by
field, and never asks whether there are more: the note does no harm there.

Source: rmw_zenoh_cpp ``detail/attachment_helpers.cpp``, Jazzy from 0.2.4 to Rolling.
"""

from __future__ import annotations

import struct

import msgspec

from turtleact.errors import InvalidMessage

__all__ = [
    "GID_SIZE",
    "LAYOUT",
    "Attachment",
    "gid_in",
    "note_in",
    "read_attachment",
    "write_attachment",
]

GID_SIZE = 16

#: An attachment without a note.
LAYOUT = struct.Struct("<qqB16s")

#: How long a note may be (bytes); what is longer is cut.
LONGEST_NOTE = 4096


class Attachment(msgspec.Struct, frozen=True):
    """What is said beside a message.

    Attributes:
        sequence: Which one in a row it is, from 0.
        stamp: When it was sent (ns since the Unix epoch).
        gid: The 16 bytes of its publisher or client.
        note: A text for peers of our kind.
    """

    sequence: int
    stamp: int
    gid: bytes
    note: str = ""


def write_attachment(sequence: int, stamp: int, gid: bytes, note: str = "") -> bytes:
    """The bytes; a note of more than 4,096 bytes is cut."""
    fixed = LAYOUT.pack(sequence, stamp, GID_SIZE, gid)
    if not note:
        return fixed
    tail = note.encode(errors="backslashreplace")  # a note never fails the message that it is with
    if len(tail) > LONGEST_NOTE:
        tail = tail[:LONGEST_NOTE].decode(errors="ignore").encode()
    return fixed + tail


def read_attachment(data: bytes) -> Attachment:
    """What the bytes say; a note is cut as above, and what is no UTF-8 in it is replaced.

    Raises:
        InvalidMessage: if they are not such bytes.
    """
    if len(data) < LAYOUT.size:
        raise _invalid(f"expected {LAYOUT.size} bytes, got {len(data)}")
    sequence, stamp, size, gid = LAYOUT.unpack_from(data)
    if size != GID_SIZE:
        raise _invalid(f"expected a gid of {GID_SIZE} bytes, not of {size}")
    if sequence < 0 or stamp < 0:
        raise _invalid(f"a sequence number and a time are not negative: {sequence}, {stamp}")
    note = note_in(data) if len(data) > LAYOUT.size else ""  # requests have none
    return Attachment(sequence, stamp, gid, note)


def note_in(data: bytes) -> str:
    """The note alone, of bytes that may be anything."""
    if len(data) <= LAYOUT.size:
        return ""
    return data[LAYOUT.size : LAYOUT.size + LONGEST_NOTE].decode(errors="replace")


def gid_in(data: bytes) -> bytes:
    """The gid alone, of bytes that may be anything."""
    return data[LAYOUT.size - GID_SIZE : LAYOUT.size]


def _invalid(problem: str) -> InvalidMessage:
    return InvalidMessage("attachment", problem)
