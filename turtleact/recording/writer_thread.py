"""Takes messages from any thread, and writes them to a bag in a thread of its own.

Messages wait in a list. The writing thread removes all of them from the list at once. If the thread
falls behind and more than ``capacity`` bytes wait, further messages are dropped and counted. In
virtual time, no message is dropped, because `put` waits until there is room, and time stands still
meanwhile.

A message is either bytes or an object. The writing thread encodes objects, which is safe because
nobody changes a message after publishing it.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, TypeAlias

from turtleact.errors import InvalidMessage
from turtleact.recording.bag_writer import BagWriter
from turtleact.recording.metadata import BagError
from turtleact.recording.storage import Channel

__all__ = ["CAPACITY", "Encode", "WriterThread"]

logger = logging.getLogger("turtleact.recording")

CAPACITY: Final = 100 * 1024 * 1024
"""The default for the number of bytes that may wait to be written, as in rosbag2."""

PAUSE: Final = 0.05
"""How long the thread waits for messages to gather (s)."""

FLUSH: Final = 0.5
"""Messages are on disk after at most this time (s), unless the thread falls behind."""

OVERHEAD: Final = 200
"""The bytes that an entry takes besides its data."""

YIELD: Final = 64
"""The writing thread lets other threads run after this many messages.

Otherwise, Python would switch to another thread only every 5 ms.
"""

Entry: TypeAlias = tuple[int, int, object]
Encode: TypeAlias = Callable[[object], bytes]


class WriterThread:
    """Writes messages to a bag.

    Args:
        writer: Writes the bag. The thread closes the writer when writing ends.
        capacity: How many bytes may wait to be written.
        is_patient: Whether `put` waits until there is room, instead of dropping the message.

    Attributes:
        error: Why writing has ended early, or None.
    """

    def __init__(
        self,
        writer: BagWriter,
        *,
        capacity: int = CAPACITY,
        is_patient: bool = False,
    ) -> None:
        self.error: Exception | None = None
        self._writer = writer
        self._capacity = capacity
        self._is_patient = is_patient
        self._channels: list[Channel] = []
        self._encoders: list[Encode | None] = []
        self._sizes: list[int] = []  # of the last message of each topic, for those not yet encoded
        self._lost: Counter[str] = Counter()
        self._count = 0
        self._entries: list[Entry] = []
        self._taken_out: list[Entry] = []  # by the thread, which writes them
        self._weight = 0
        self._listed: list[int] = []  # topics to add to the bag
        self._added: set[int] = set()  # topics that the bag has
        self._is_closing = False
        self._is_over = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name=f"bag {writer.path}", daemon=True)

    def start(self, on_end: Callable[[], object]) -> None:
        """Start the writing thread.

        Args:
            on_end: Called in the writing thread when the bag has been closed. The bag is closed
                after `close`, or earlier if writing fails, for example because the disk is full.
        """
        self._on_end = on_end
        self._thread.start()

    def add(self, channel: Channel, encode: Encode | None, *, is_there: bool) -> int:
        """Add a topic and return its number.

        Args:
            channel: The topic.
            encode: A function that encodes messages; None if all messages are bytes already.
            is_there: Whether the bag lists the topic even if no message of the topic arrives.
        """
        with self._changed:
            self._channels.append(channel)
            if is_there:
                self._listed.append(len(self._channels) - 1)
            self._encoders.append(encode)
            self._sizes.append(OVERHEAD)
            return len(self._channels) - 1

    def list_topic(self, number: int, channel: Channel) -> None:
        """List a topic in the bag, now that its publishers are known.

        Args:
            number: The number of the topic, from `add`.
            channel: The topic, with what its publishers offer.
        """
        with self._changed:
            self._channels[number] = channel
            self._listed.append(number)

    def put(self, number: int, stamp: int, message: object) -> None:
        """Queue a message to be written. Any thread may call this.

        After writing has ended or `close` was called, messages are ignored and not counted. A
        transport may deliver messages even after a subscription is closed.

        Args:
            number: The number of the message's topic, from `add`.
            stamp: When the message was received (ns since 1970).
            message: The message as an object, or its encoded bytes.
        """
        if self._is_closing or self._is_over:
            return
        size = len(message) if isinstance(message, bytes) else self._sizes[number]
        with self._changed:
            while self._weight > self._capacity and self._is_patient and not self._is_over:
                self._changed.notify_all()
                self._changed.wait()
            if self._is_over:
                return
            if self._weight > self._capacity:
                self._lose(number)
                return
            self._count += 1
            self._entries.append((number, stamp, message))
            self._weight += size + OVERHEAD

    def close(self) -> None:
        """Write the remaining messages and close the bag.

        This call blocks until the writing thread has ended.
        """
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        self._thread.join()

    @property
    def count(self) -> int:
        """How many messages are in the bag or wait to be written."""
        return self._count - (self.waiting if self._is_over else 0)

    @property
    def waiting(self) -> int:
        """How many messages are not on disk yet, or were not when the disk failed.

        Reading this needs no lock, so a signal handler may do it.
        """
        return len(self._entries) + len(self._taken_out) + self._writer.waiting

    @property
    def lost(self) -> dict[str, int]:
        """How many messages of each topic were dropped."""
        with self._changed:
            return dict(self._lost)

    def _lose(self, number: int) -> None:
        topic = self._channels[number].topic
        self._lost[topic] += 1
        if self._lost[topic] == 1:
            logger.warning("topic %s: the disk is too slow; messages are lost", topic)

    # the thread

    def _work(self) -> None:
        try:
            flushed = time.monotonic()
            while not self._is_closing or self._entries:
                entries = self._taken_out = self._take()
                while self._listed:
                    self._add(self._listed.pop(0))
                self._write(entries)
                if time.monotonic() - flushed >= FLUSH:
                    self._writer.flush()
                    flushed = time.monotonic()
        except Exception as error:
            self._fail(error)
        finally:
            self._end()

    def _take(self) -> list[Entry]:
        """Wait briefly for more entries, then empty the list and return its entries."""
        with self._changed:
            if not self._is_closing and self._weight <= self._capacity:
                self._changed.wait(PAUSE)
            entries, self._entries = self._entries, []
            self._weight = 0
            self._changed.notify_all()
        return entries

    def _add(self, number: int) -> None:
        if number not in self._added:
            self._writer.add(number, self._channels[number])
            self._added.add(number)

    def _write(self, entries: list[Entry]) -> None:
        """Write the entries, and remove each entry from ``entries`` before writing it.

        If an entry cannot be written, ``entries`` still has the later entries.
        """
        entries.reverse()
        write, turn = self._writer.write, 0
        while entries:
            number, stamp, message = entries.pop()
            data = message if isinstance(message, bytes) else self._encoded(number, message)
            if number not in self._added:
                self._add(number)
            if data is not None:
                write(number, stamp, stamp, data)
            turn += 1
            if not turn % YIELD:
                time.sleep(0)

    def _encoded(self, number: int, message: object) -> bytes | None:
        encode = self._encoders[number]
        try:
            data = None if encode is None else encode(message)
        except InvalidMessage as error:
            logger.error("topic %s: a message is lost: %s", self._channels[number].topic, error)
            data = None
        with self._changed:
            if data is None:
                self._lost[self._channels[number].topic] += 1
                self._count -= 1
            else:
                self._sizes[number] = len(data)
        return data

    def _end(self) -> None:
        """Close the bag, even after an error."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        try:
            self._writer.close(self.lost)
        except Exception as error:
            self._fail(error)
        finally:
            self._on_end()

    def _fail(self, error: Exception) -> None:
        """Store the error that ended writing, and log it if a full disk cannot be the cause."""
        self.error = self.error or error
        if not isinstance(error, OSError | BagError):
            logger.error("a bag cannot be written any more", exc_info=error)
