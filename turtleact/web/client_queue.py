"""Keeps the frames that wait for one client.

The frames wait in one queue, in the order of their arrival, so a client never sees a result before
feedback that came earlier. If the queue is full, the oldest frame of a topic or of feedback is
dropped and counted. Responses, results and goals are never dropped: if only those are left, the
client must be disconnected (`ClientQueue.is_overfull`).
"""

from __future__ import annotations

from collections import deque
from typing import Final

from turtleact.web.message_conversion import Frame

__all__ = ["ClientQueue"]

MOST_DROPPABLE: Final = 256
"""The maximum number of frames of topics and feedback that wait."""


class ClientQueue:
    """The frames that wait for one client.

    Args:
        most: The maximum size of all waiting frames (bytes of CBOR, characters of JSON). The newest
            frame may be larger.

    Attributes:
        dropped: How many frames were dropped because the queue was full.
    """

    def __init__(self, most: int) -> None:
        self.dropped = 0
        self._most = most
        self._frames: deque[tuple[str, Frame]] = deque()  # each with its source, if it is droppable
        self._droppable = 0
        self._size = 0

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def is_overfull(self) -> bool:
        """Whether the frames that must arrive exceed the limit."""
        return self._size > self._most and not self._droppable and len(self._frames) > 1

    def keep(self, frame: Frame) -> None:
        """Add a frame that must not be dropped."""
        self._add("", frame)

    def put(self, source: str, frame: Frame) -> None:
        """Add a frame of a topic or goal, ``source``. It may be dropped for newer frames."""
        self._droppable += 1
        self._add(source, frame)
        if self._droppable > MOST_DROPPABLE:
            self._drop_oldest()

    def take(self) -> Frame | None:
        """Remove and return the oldest frame; None if no frame waits."""
        return self._remove(0) if self._frames else None

    def forget(self, source: str) -> None:
        """Remove the frames of an unwanted source. `dropped` does not count them."""
        for at in reversed(range(len(self._frames))):
            if self._frames[at][0] == source:
                self._remove(at)

    def drop_all(self) -> None:
        """Remove all frames that may be dropped, without counting them."""
        for source in {source for source, _ in self._frames if source}:
            self.forget(source)

    def _add(self, source: str, frame: Frame) -> None:
        self._frames.append((source, frame))
        self._size += len(frame)
        while self._size > self._most and self._droppable > bool(source):
            self._drop_oldest()

    def _drop_oldest(self) -> None:
        self._remove(next(at for at, (source, _) in enumerate(self._frames) if source))
        self.dropped += 1

    def _remove(self, at: int) -> Frame:
        source, frame = self._frames[at]
        del self._frames[at]
        self._droppable -= bool(source)
        self._size -= len(frame)
        return frame
