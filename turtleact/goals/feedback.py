"""Stores the feedback of one goal: decides which messages to keep, and when the body must wait.

Once the client that sent the goal has begun to read the feedback, it misses no message: unread
messages are kept, and the goal's body waits if the client is far behind. Until the client begins to
read, only the newest messages are kept. Other readers get the messages that are still kept, and
count the messages that they have missed.

This module never waits. A caller that wants to wait passes a `Signal`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol

import msgspec

__all__ = ["FeedbackLog", "Signal"]


class Signal(Protocol):
    """What this module and `turtleact.goals.state` need of a `turtleact.tasks.Signal`."""

    def fire(self) -> None:
        """Wake every task that is waiting."""

    async def wait(self) -> None:
        """Wait until the signal fires the next time."""


class FeedbackLog:
    """The feedback messages of one goal, numbered from 0.

    Each reader remembers the number of the message that it reads next.

    Args:
        on_feedback: The sender's callback for feedback.
        is_kept: Whether to keep the messages, because a client may read them later.

    Attributes:
        on_feedback: The sender's callback for feedback, as passed to the constructor.
        is_kept: Whether messages are kept from now on.
        last: The newest message, which is always kept; None before the first.
        count: How many messages have been added, dropped ones included.
        history: The goal's states since its acceptance, without the final one. Each state comes
            with the number of feedback messages published before it.
        items: The messages still kept, oldest first.
        read: The number of the message that the goal's sender reads next; None while the sender
            does not read feedback.
        drained: The signal to fire when a waiting body may continue; None if no body waits.
        hurried: How many callers wait for the goal's end. While any caller waits for the end, the
            goal's body does not wait for readers.
    """

    KEPT: Final = 1024
    """How many of the newest messages are kept, even if nobody reads them."""

    BUDGET: Final = 1 << 20
    """How much feedback may be unread before the body waits (bytes, in a compact encoding)."""

    __slots__ = (
        "_weighed",
        "_weight",
        "count",
        "drained",
        "history",
        "hurried",
        "is_kept",
        "items",
        "last",
        "on_feedback",
        "read",
    )

    def __init__(
        self, on_feedback: Callable[[Any], object] | None = None, *, is_kept: bool = False
    ) -> None:
        self.on_feedback = on_feedback
        self.is_kept = is_kept
        self.last: Any = None
        self.count = 0
        self.history: tuple[tuple[Any, int], ...] = ()
        self.items: list[Any] = []
        self.read: int | None = None
        self.drained: Signal | None = None
        self.hurried = 0
        self._weighed = 0
        self._weight = 0

    @property
    def dropped(self) -> int:
        """The number of the message ``items[0]``: how many older messages are not kept."""
        return self.count - len(self.items)

    @property
    def is_full(self) -> bool:
        """Whether the goal's sender has so much unread feedback that the goal's body must wait."""
        if self.read is None or self.hurried:
            return False
        unread = self.count - self.read
        return unread >= self.KEPT or unread * self._weight >= self.BUDGET

    def relieve(self) -> None:
        """Let a waiting body continue, unless the log is full."""
        if self.drained is not None and not self.is_full:
            self.drained.fire()

    def append(self, message: object) -> None:
        """Add the newest message."""
        self.last = message
        self.count += 1
        if self.is_kept:
            self.items.append(message)
            if len(self.items) >= 2 * self.KEPT:
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


_ENCODER = msgspec.msgpack.Encoder()

_NEWEST: Final = 16
"""Successive calls of `weigh` measure different messages among this many newest messages."""

_NEEDLESS: Final = 64
"""`trim` drops messages only if it can drop at least 1/64 of the kept messages."""
