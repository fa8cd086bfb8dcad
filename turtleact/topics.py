"""Topics as a node's user sees them: a publisher that checks, a subscription that is read.

Knows messages and queues; how they travel stands in `turtleact.transports`.

Source: rclpy ``publisher.py`` and ``subscription.py`` for names and meaning.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, Self, TypeVar

from turtleact.errors import TurtleactError
from turtleact.interfaces import Message, snapshotter
from turtleact.tasks import Signal
from turtleact.transports.base import Closeable, Publication, Source

__all__ = ["Matching", "Publisher", "Subscription"]

M = TypeVar("M", bound=Message)


class Publisher(Generic[M]):
    """Sends messages to a topic; made by `turtleact.Node.publisher`.

    Attributes:
        topic: The fully qualified name of the topic.
        is_open: Whether it can publish.
    """

    def __init__(self, topic: str, message_type: type[M], publication: Publication) -> None:
        self.topic = topic
        self.is_open = True
        self._check = snapshotter(message_type)
        self._publication = publication
        self.membership: Closeable = publication

    @property
    def has_subscriptions(self) -> bool:
        """Whether anybody would get a message published now, or may later, as it is latched."""
        return self._publication.has_readers

    def publish(self, message: M) -> None:
        """Send a snapshot of a message to every subscription.

        Raises:
            InvalidMessage: if it is not of the topic's type, or a value does not fit its type.
            TurtleactError: if the publisher is closed.
        """
        snapshot = self._check(message)
        if not self.is_open:
            raise TurtleactError(f"the publisher of topic '{self.topic}' is closed: open another")
        if self._publication.has_readers:
            self._publication.publish(snapshot)

    def give(self, message: M) -> None:
        """Send a message itself, whose maker knows that it is right and lets go of it.

        Nothing is checked or copied, and nothing is sent once the publisher is closed.
        """
        if self.is_open and self._publication.has_readers:
            self._publication.publish(message)

    async def aclose(self) -> None:
        """Leave the topic; a second time does nothing."""
        self.is_open = False
        self.membership.close()


class Matching(Source):
    """Has a function called when a topic gets its first reader, and when the last one has gone."""

    def __init__(self, on_matched: Callable[[], object]) -> None:
        self._on_matched = on_matched

    def readers_changed(self, *, has_readers: bool) -> None:  # noqa: ARG002  # it can be asked for
        """Pass it on."""
        self._on_matched()


class Subscription(Generic[M]):
    """Receives messages from a topic; made by `turtleact.Node.subscription`.

    ``async for message in subscription`` gives the messages in order. The newest ``depth`` are kept
    for a reader that lags; `missed` counts those that it lost. Of several readers each message goes
    to one. The messages are shared with other subscriptions and must not be changed.
    Cancelling: safe, nothing is lost.

    Attributes:
        topic: The fully qualified name of the topic.
        latest: The newest message, read or not; None before the first.
        missed: How many messages were dropped unread.
        notify: Called when a message has come, besides waking those who wait.
        taker: Called with each message before anybody else; what it takes, by answering True, is
            not kept for readers and wakes nobody.
    """

    def __init__(self, topic: str, depth: int, signal: Signal) -> None:
        self.topic = topic
        self.latest: M | None = None
        self.missed = 0
        self.notify: Callable[[], object] | None = None
        self.taker: Callable[[M], bool] | None = None
        self.membership: Closeable | None = None
        self._kept: deque[M] = deque(maxlen=depth)
        self._signal = signal
        self._is_open = True

    def deliver(self, message: M) -> None:
        """Take a message from the transport."""
        if self.taker is not None and self.taker(message):
            self.latest = message
            return
        kept = self._kept
        if len(kept) == kept.maxlen:
            self.missed += 1
        kept.append(message)
        self.latest = message
        self._signal.fire()
        if self.notify is not None:
            self.notify()

    def drain(self) -> list[M]:
        """Take all that has come and was not read yet, without waiting."""
        drained = list(self._kept)
        self._kept.clear()
        return drained

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> M:
        while not self._kept:
            if not self._is_open:
                raise StopAsyncIteration
            await self._signal.wait()
        return self._kept.popleft()

    async def aclose(self) -> None:
        """Leave the topic: readers get what has come already, and are at their end.

        A second time does nothing.
        """
        self._is_open = False
        if self.membership is not None:
            self.membership.close()
        self._signal.fire()
