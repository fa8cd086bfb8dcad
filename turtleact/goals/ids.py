"""Makes goal ids: 16 random bytes each, drawn from the operating system in batches.

Source: RFC 9562, UUID version 4, as in unique_identifier_msgs/msg/UUID.
"""

from __future__ import annotations

import os
import uuid

from turtleact.errors import InvalidGoalId

__all__ = ["goal_id_bytes", "new_goal_id"]

_POOLED = 256

# What becomes of each octet that holds the version or the variant.
_VERSION = bytes(octet & 0x0F | 0x40 for octet in range(256))
_VARIANT = bytes(octet & 0x3F | 0x80 for octet in range(256))


class _Pool:
    """A supply of unused ids.

    A forked child process starts with an empty supply, so that no id is used twice.
    """

    def __init__(self) -> None:
        self._stock: list[bytes] = []
        if hasattr(os, "register_at_fork"):  # Windows does not fork
            os.register_at_fork(after_in_child=self._stock.clear)

    def draw(self) -> bytes:
        if not self._stock:
            noise = bytearray(os.urandom(16 * _POOLED))
            noise[6::16] = noise[6::16].translate(_VERSION)
            noise[8::16] = noise[8::16].translate(_VARIANT)
            self._stock += [bytes(noise[at : at + 16]) for at in range(0, len(noise), 16)]
        return self._stock.pop()


_pool = _Pool()


def new_goal_id() -> bytes:
    """Return a new goal id, a UUID of version 4."""
    return _pool.draw()


def goal_id_bytes(goal_id: bytes | str | uuid.UUID) -> bytes:
    """Convert a goal id in any form to its 16 bytes.

    Raises:
        InvalidGoalId: if the id is neither 16 bytes nor a UUID nor 32 hexadecimal digits, or is all
            zeros.

    >>> goal_id_bytes("0d4fd2a0d2b74b3f9a3f1f7c2f4f8f2e").hex()
    '0d4fd2a0d2b74b3f9a3f1f7c2f4f8f2e'
    """
    if isinstance(goal_id, str):
        try:
            goal_id = uuid.UUID(goal_id).bytes
        except ValueError:
            problem = "a goal id has 32 hexadecimal digits"
            raise InvalidGoalId(str(goal_id), problem, 0) from None
    if isinstance(goal_id, uuid.UUID):
        goal_id = goal_id.bytes
    if not isinstance(goal_id, bytes):
        raise InvalidGoalId(repr(goal_id), "a goal id has 16 bytes, or is a UUID", 0)
    if len(goal_id) != 16:
        raise InvalidGoalId(goal_id.hex(), "a goal id has 16 bytes", 0)
    if not any(goal_id):
        raise InvalidGoalId(goal_id.hex(), "a goal id must not be all zeros", 0)
    return goal_id
