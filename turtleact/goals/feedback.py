"""Stores the feedback of one goal: decides which messages to keep, and when the body must wait.

Once the client that sent the goal has begun to read the feedback, it misses no message: unread
messages are kept, and the goal's body waits if the client is far behind. Until the client begins to
read, only the newest messages are kept. Other readers get the messages that are still kept, and
count the messages that they have missed.

This module never waits. A caller that wants to wait passes a `Listener`.
"""

from __future__ import annotations

from typing import Final, Protocol

import msgspec

__all__ = ["FeedbackLog", "Listener"]


class Listener(Protocol):
    """An object whose method `fire` is called after each change."""

    def fire(self) -> None:
        """Called after each change. It must not raise an exception."""


class FeedbackLog:
    """The feedback messages of one goal, numbered from 0.

    Each reader remembers the number of the message that it reads next.

    Attributes:
        items: The messages still kept, oldest first.
        dropped: How many older messages were dropped. Message ``items[i]`` therefore has the number
            ``dropped + i``.
        read: The number of the message that the goal's sender reads next; None while the sender
            does not read feedback.
        drained: The listener to call when a waiting body may continue; None if no body waits.
        hurried: How many callers wait for the goal's end. While any caller waits for the end, the
            goal's body does not wait for readers.
    """

    KEPT: Final = 1024
    """How many of the newest messages are kept, even if nobody reads them."""

    BUDGET: Final = 1 << 20
    """How much feedback may be unread before the body waits (bytes, in a compact encoding)."""

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
        """How many messages have been added, dropped ones included."""
        return self.dropped + len(self.items)

    @property
    def is_full(self) -> bool:
        """Whether the goal's sender has so much unread feedback that the goal's body must wait."""
        if self.read is None or self.hurried:
            return False
        unread = self.dropped + len(self.items) - self.read
        return unread >= self.KEPT or unread * self._weight >= self.BUDGET

    def relieve(self) -> None:
        """Let a waiting body continue, unless the log is full."""
        if self.drained is not None and not self.is_full:
            self.drained.fire()

    def append(self, message: object) -> None:
        """Add the newest message."""
        items = self.items
        items.append(message)
        if len(items) >= 2 * self.KEPT:
            self.trim()

    def weigh(self) -> None:
        """Update the estimated size of a message by measuring one of the newest messages.

        Measuring every message would take too long, so each call measures a different one of the
        newest. After a large message, the estimate falls slowly, because a body may alternate large
        and small messages.
        """
        if self.items:
            self._weighed += 1
            message = self.items[-1 - self._weighed % min(len(self.items), _NEWEST)]
            self._weight = max(len(_ENCODER.encode(message)), self._weight * 15 // 16)

    def trim(self) -> None:
        """Drop messages that need not be kept. If there are few (see `_NEEDLESS`), drop none."""
        needless = len(self.items) - self.KEPT
        if self.read is not None:
            needless = min(needless, self.read - self.dropped)
        if needless * _NEEDLESS >= len(self.items):
            del self.items[:needless]
            self.dropped += needless


_ENCODER = msgspec.msgpack.Encoder()

_NEWEST: Final = 16
"""Successive calls of `weigh` measure different messages among this many newest messages."""

_NEEDLESS: Final = 64
"""`trim` drops messages only if it can drop at least 1/64 of the kept messages."""
