"""The feedback of one goal: what is kept of it, and when its body should wait for a reader.

The sender's own stream loses nothing: what it has not read yet is kept once it has begun to read,
and a body that runs far ahead of it waits. Before that, and behind it, only the newest messages are
kept; other readers go by what is there, and count what they missed.

Pure: whoever wants to wait brings a `Listener`.
"""

from __future__ import annotations

from typing import Final, Protocol

import msgspec

__all__ = ["FeedbackLog", "Listener"]


class Listener(Protocol):
    """What wants to know that something has changed."""

    def fire(self) -> None:
        """Called after each change; must not raise."""


class FeedbackLog:
    """The feedback of one goal, numbered from 0; any number of readers go by the number.

    Attributes:
        items: The messages still kept, oldest first.
        dropped: How many older ones are gone: ``items[i]`` is number ``dropped + i``.
        read: The number that the sender's stream reads next; None while it does not read.
        drained: Whom to tell once the body need not wait any more, if somebody wants to know.
        hurried: How many times the sender waits for the end now; the body is not held up then.
    """

    KEPT: Final = 1024
    """So many messages are kept for those who are not waited for."""

    BUDGET: Final = 1 << 20
    """So much may lie unread before the body waits (bytes, in a compact encoding)."""

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
        """How many messages there have been."""
        return self.dropped + len(self.items)

    @property
    def is_full(self) -> bool:
        """Whether the sender reads, and is behind by so much that the body should wait."""
        if self.read is None or self.hurried:
            return False
        unread = self.dropped + len(self.items) - self.read
        return unread >= self.KEPT or unread * self._weight >= self.BUDGET

    def relieve(self) -> None:
        """Let the body go on, if it was held up and need not be any more."""
        if self.drained is not None and not self.is_full:
            self.drained.fire()

    def append(self, message: object) -> None:
        """Add the newest message."""
        items = self.items
        items.append(message)
        if len(items) >= 2 * self.KEPT:
            self.trim()

    def weigh(self) -> None:
        """Take one message's size for that of all; not done for each, as it takes time.

        Each time another of the newest is taken, and a large one is only forgotten bit by bit: a
        body may give large and small ones by turns.
        """
        if self.items:
            self._weighed += 1
            message = self.items[-1 - self._weighed % min(len(self.items), _NEWEST)]
            self._weight = max(len(_ENCODER.encode(message)), self._weight * 15 // 16)

    def trim(self) -> None:
        """Forget what need not be kept, unless it is little, as it moves all the others."""
        needless = len(self.items) - self.KEPT
        if self.read is not None:
            needless = min(needless, self.read - self.dropped)
        if needless * _NEEDLESS >= len(self.items):
            del self.items[:needless]
            self.dropped += needless


_ENCODER = msgspec.msgpack.Encoder()

_NEWEST: Final = 16
"""So many of the newest messages take turns at being weighed."""

_NEEDLESS: Final = 64
"""What need not be kept is at most the 64th part of what is kept."""
