"""Keeps the frames that wait for one client, and limits the memory of all clients.

This module reads no clock: the caller passes the time as ``now``.

- `Mailbox.keep` takes frames that must arrive, such as responses, results and goals. Frames that
  must arrive are never dropped. If too many such frames wait, the client is disconnected
  (`Mailbox.is_overfull`).
- `Mailbox.put` takes frames of topics and feedback. If too many frames of topics and feedback wait,
  the oldest are dropped and counted (`Mailbox.dropped`).
- `Budget` bounds the memory of all clients together. Without the budget, a hundred clients could
  together use a gigabyte, although each client is below its own limit.

Source: rosbridge v2, ``throttle_rate`` and ``queue_length`` of ``subscribe``.
"""

from __future__ import annotations

import itertools
from collections import deque
from typing import Final, Protocol

from turtleact.web.message_conversion import Compression, Frame, Rendering

__all__ = ["Budget", "Holder", "Mailbox", "Throttle"]

MOST_OF_ONE: Final = 32
"""The maximum number of frames that wait for one topic or goal."""

MOST_DROPPABLE: Final = 4 * 2**20
"""The maximum size of a client's queued droppable frames (bytes). The newest frame always stays."""

MOST_KEPT: Final = 1024
"""The maximum number of a client's queued frames that must arrive."""

MOST_KEPT_BYTES: Final = 32 * 2**20
"""The maximum size of a client's queued frames that must arrive (bytes)."""


class Holder(Protocol):
    """An object that holds memory for a client, such as its connection."""

    def shrink(self) -> int:
        """Free memory, or disconnect the client. Return how much the object still holds (bytes)."""


class Budget:
    """Limits the memory that all clients together hold.

    If the limit is exceeded, the client that holds the most must free memory, even if the latest
    data came from another client. Therefore, a few clients cannot use up the budget and shut out
    all others.

    Args:
        most: The limit (bytes).

    Attributes:
        held: How much memory the clients currently hold (bytes).

    Example:
        >>> class Client:
        ...     def shrink(self):
        ...         print("let go")
        ...         return 0
        >>> budget, small, large = Budget(100), Client(), Client()
        >>> budget.hold(large, 80)
        >>> budget.hold(small, 30)
        let go
        >>> budget.held
        30
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self.held = 0
        self._holders: dict[Holder, int] = {}

    def hold(self, holder: Holder, size: int) -> None:
        """Record that a holder now holds ``size`` bytes, and enforce the limit."""
        self._set(holder, size)
        # Shrinking may take a holder several turns: first it drops what may be dropped, then it is
        # let go. It counts as smaller after each, so that this ends.
        while self.held > self.most:
            largest = max(self._holders, key=self._holders.__getitem__)
            self._set(largest, min(largest.shrink(), self._holders[largest] - 1))

    def _set(self, holder: Holder, size: int) -> None:
        self.held += size - self._holders.pop(holder, 0)
        if size:
            self._holders[holder] = size


class Mailbox:
    """The frames that wait for one client.

    Attributes:
        dropped: How many frames were dropped to limit memory use.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._order = itertools.count()
        self._kept: deque[tuple[int, Frame]] = deque()
        self._kept_bytes = 0
        self._droppable: dict[str, deque[tuple[int, Frame]]] = {}
        self._droppable_bytes = 0

    def __len__(self) -> int:
        return len(self._kept) + sum(map(len, self._droppable.values()))

    @property
    def size(self) -> int:
        """The size of all waiting frames (bytes of CBOR, characters of JSON)."""
        return self._kept_bytes + self._droppable_bytes

    @property
    def is_overfull(self) -> bool:
        """Whether the frames that must arrive exceed `MOST_KEPT` or `MOST_KEPT_BYTES`."""
        return len(self._kept) > MOST_KEPT or self._kept_bytes > MOST_KEPT_BYTES

    def keep(self, frame: Frame) -> None:
        """Add a frame that must not be dropped."""
        self._kept.append((next(self._order), frame))
        self._kept_bytes += len(frame)

    def put(self, source: str, frame: Frame) -> None:
        """Add a frame of a topic or goal. It may be dropped to make room for newer frames."""
        line = self._droppable.setdefault(source, deque())
        line.append((next(self._order), frame))
        self._droppable_bytes += len(frame)
        if len(line) > MOST_OF_ONE:
            self._drop(source)
        # The frame just put in stays even if it is larger than the bound: a camera's picture would
        # never arrive otherwise.
        while self._droppable_bytes > MOST_DROPPABLE and self._droppable_bytes > len(frame):
            self._drop(self._oldest())

    def take(self) -> Frame | None:
        """Remove and return the oldest frame; None if no frame waits."""
        # Frames are numbered in the order of their arrival, whichever queue they wait in. So a
        # client never sees a result before feedback that came earlier.
        source = self._oldest() if self._droppable else None
        if source is not None and not (
            self._kept and self._kept[0][0] < self._droppable[source][0][0]
        ):
            return self._pop(source)
        if not self._kept:
            return None
        _, frame = self._kept.popleft()
        self._kept_bytes -= len(frame)
        return frame

    def forget(self, source: str) -> None:
        """Remove the frames of an unwanted source. `dropped` does not count them."""
        for _, frame in self._droppable.pop(source, ()):
            self._droppable_bytes -= len(frame)

    def shed(self) -> bool:
        """Drop and count all frames that may be dropped. Return whether any frame was dropped."""
        dropped = sum(map(len, self._droppable.values()))
        self.dropped += dropped
        self.drop_all()
        return dropped > 0

    def drop_all(self) -> None:
        """Drop all frames that may be dropped, without counting them."""
        for source in list(self._droppable):
            self.forget(source)

    def _oldest(self) -> str:
        return min(self._droppable, key=lambda source: self._droppable[source][0])

    def _drop(self, source: str) -> None:
        self._pop(source)
        self.dropped += 1

    def _pop(self, source: str) -> Frame:
        line = self._droppable[source]
        _, frame = line.popleft()
        self._droppable_bytes -= len(frame)
        if not line:
            del self._droppable[source]
        return frame


class Throttle:
    """Limits how often a client gets a topic's messages.

    A message that comes too soon after the last one waits or is dropped.

    Args:
        topic: The topic's name as the client spells it.

    Attributes:
        topic: The topic's name as the client spells it.
        interval: The minimum time between two messages (s).
        queue_length: How many messages may wait until the interval has passed. Of more waiting
            messages, only the newest are kept. If 0, messages that would have to wait are dropped.
        compression: How messages are encoded: ``none``, ``png``, ``cbor`` or ``cbor-raw``.
        due: The time when the next waiting message may be sent (s); None if no message waits.
    """

    __slots__ = ("_last", "_waiting", "compression", "due", "interval", "queue_length", "topic")

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.interval = 0.0
        self.queue_length = 0
        self.compression: Compression = "none"
        self.due: float | None = None
        self._last: float | None = None
        self._waiting: deque[Rendering] = deque()

    def adjust(self, interval: float, queue_length: int, compression: Compression) -> None:
        """Change the settings. Of the waiting messages, keep only the newest ``queue_length``."""
        self.interval, self.queue_length, self.compression = interval, queue_length, compression
        while len(self._waiting) > queue_length:
            self._waiting.popleft()
        self._reckon()

    def offer(self, message: Rendering, now: float) -> Rendering | None:
        """Return a new message if it may be sent now.

        Otherwise let the message wait or drop it, and return None.
        """
        if not self._waiting and (self._last is None or now >= self._last + self.interval):
            self._last = now
            return message
        if self.queue_length:
            if len(self._waiting) == self.queue_length:
                self._waiting.popleft()
            self._waiting.append(message)
            self._reckon()
        return None

    def release(self, now: float) -> Rendering | None:
        """Remove and return the waiting message that is due now; None if none is due."""
        if self.due is None or now < self.due:
            return None
        message = self._waiting.popleft()
        self._last = now
        self._reckon()
        return message

    def _reckon(self) -> None:
        self.due = None if not self._waiting or self._last is None else self._last + self.interval
