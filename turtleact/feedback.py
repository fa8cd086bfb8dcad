"""The feedback of one goal: which messages are kept, and when the body must wait for a reader.

The sender's stream loses nothing once it has begun to read: unread messages are kept, and a body
that is far ahead waits. Otherwise only the newest messages are kept. Other readers take what is
there and count what they have missed.

Pure: a caller that wants to wait passes a `Listener`.
"""

from __future__ import annotations

from typing import Final, Protocol

import msgspec

__all__ = ["FeedbackLog", "Listener"]


class Listener(Protocol):
    """Something that wants to know about changes."""

    def fire(self) -> None:
        """Called after each change; must not raise."""


class FeedbackLog:
    """The feedback of one goal, numbered from 0. Each reader keeps the number of its next message.

    Attributes:
        items: The messages still kept, oldest first.
        dropped: How many older ones were dropped: ``items[i]`` is number ``dropped + i``.
        read: The next number that the sender's stream reads; None while nobody reads the stream.
        drained: Told as soon as a waiting body may go on; None if no body waits.
        hurried: How many callers wait for the goal's end. While there are any, the body never
            waits for a reader.
    """

    KEPT: Final = 1024
    """How many messages are kept for readers that the body does not wait for."""

    BUDGET: Final = 1 << 20
    """How much may lie unread before the body waits (bytes, in a compact encoding)."""

    __slots__ = ("_weighed", "_weight", "drained", "dropped", "hurried", "items", "read")

    def __init__(self) -> None:
        self.items: list[object] = []
        self.dropped = 0
        self.read: int | None = None
        self.drained: Listener | None = None
        self.hurried = 0
        self._weighed = 0
        self._weight = 0

    @property
    def count(self) -> int:
        """How many messages there have been, dropped ones included."""
        return self.dropped + len(self.items)

    @property
    def is_full(self) -> bool:
        """Whether the sender's stream is so far behind that the body should wait."""
        if self.read is None or self.hurried:
            return False
        unread = self.dropped + len(self.items) - self.read
        return unread >= self.KEPT or unread * self._weight >= self.BUDGET

    def relieve(self) -> None:
        """Let a waiting body go on if it may."""
        if self.drained is not None and not self.is_full:
            self.drained.fire()

    def append(self, message: object) -> None:
        """Add the newest message."""
        items = self.items
        items.append(message)
        if len(items) >= 2 * self.KEPT:
            self.trim()

    def weigh(self) -> None:
        """Estimate the size of a message by measuring one of the newest.

        Measuring every message would take too long. Each call measures another one, and the
        estimate falls slowly after a large one, since a body may alternate large and small ones.
        """
        if self.items:
            self._weighed += 1
            message = self.items[-1 - self._weighed % min(len(self.items), _NEWEST)]
            self._weight = max(len(_ENCODER.encode(message)), self._weight * 15 // 16)

    def trim(self) -> None:
        """Drop messages that need not be kept, if they are many enough to be worth the move."""
        needless = len(self.items) - self.KEPT
        if self.read is not None:
            needless = min(needless, self.read - self.dropped)
        if needless * _NEEDLESS >= len(self.items):
            del self.items[:needless]
            self.dropped += needless


_ENCODER = msgspec.msgpack.Encoder()

_NEWEST: Final = 16
"""How many of the newest messages `weigh` goes through in turn."""

_NEEDLESS: Final = 64
"""`trim` waits until one message in this many need not be kept."""
