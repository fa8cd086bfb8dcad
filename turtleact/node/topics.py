"""The publishers and subscriptions of a node.

A publisher checks each message that it sends. With ``async for``, you read the messages of a
subscription. This module checks and queues messages; `turtleact.transports` carries them.

Source: rclpy ``publisher.py`` and ``subscription.py`` for names and behaviour.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, Self, TypeVar, cast

from turtleact.errors import TurtleactError
from turtleact.interfaces import Message, WireFormat, snapshotter
from turtleact.tasks import Signal
from turtleact.transports.base import Deliver, Endpoint, Owner, Publication, Source, Transport

__all__ = ["Matching", "Publisher", "Subscription", "publish_unchecked"]

M = TypeVar("M", bound=Message)


class Publisher(Generic[M]):
    """Sends messages to a topic. Open a publisher with `turtleact.Node.publisher`.

    Attributes:
        topic: The fully qualified name of the topic.
        is_open: Whether the publisher can still publish.
    """

    def __init__(
        self, topic: str, message_type: type[M], publication: Publication, owner: Owner
    ) -> None:
        self.topic = topic
        self.is_open = True
        self._check = snapshotter(message_type)
        self._publication = publication
        self._membership = owner.add(self, publication.close)
        self._home = owner.home.of(f"the publisher of topic '{topic}'")

    @property
    def has_subscriptions(self) -> bool:
        """Whether a message published now reaches a subscription.

        On a latched topic, this is True until the publisher is closed, because later subscriptions
        also get the message.
        """
        return self._publication.has_readers

    def publish(self, message: M) -> None:
        """Send a copy of a message to every subscription.

        Raises:
            InvalidMessage: if the message is not of the topic's type, or a value does not fit its
                type.
            TurtleactError: if the publisher is closed, or belongs to another event loop or thread.
        """
        self._home.check()
        snapshot = self._check(message)
        if not self.is_open:
            raise TurtleactError(f"the publisher of topic '{self.topic}' is closed: open another")
        if self._publication.has_readers:
            self._publication.publish(snapshot)

    async def aclose(self) -> None:
        """Close the publisher. A second call does nothing."""
        self.is_open = False
        self._membership.close()


def publish_unchecked(publisher: Publisher[M], message: M) -> None:
    """Send a message without checking or copying it. If the publisher is closed, do nothing.

    The message must be valid, and the caller must not change it afterwards.
    """
    publication = publisher._publication
    if publisher.is_open and publication.has_readers:
        publication.publish(message)


class Matching(Source):
    """Calls a function when a topic gets its first reader or loses its last one."""

    def __init__(self, on_matched: Callable[[], object]) -> None:
        self._on_matched = on_matched

    def readers_changed(self, *, has_readers: bool) -> None:  # noqa: ARG002  # the callback asks
        """Call the function ``on_matched``."""
        self._on_matched()


class Subscription(Generic[M]):
    """Receives messages from a topic. Open a subscription with `turtleact.Node.subscription`.

    ``async for message in subscription`` gives the messages in order. If a reader lags behind, only
    the newest messages are kept, as many as the QoS depth, and `missed` counts the dropped ones. If
    several tasks read the same subscription, each message goes to only one of them. Do not change
    the messages, because other subscriptions get the same message objects. Cancelling: safe, no
    message is lost.

    Attributes:
        topic: The fully qualified name of the topic.
        latest: The newest message, even if it has been read; None if no message has arrived.
        missed: How many messages were dropped before they were read.
        notify: A function that is called without arguments each time a message has been queued.
        taker: A function that is called with each message before the message is queued. If the
            function returns True, the message is not queued, no reader wakes, and ``notify`` is not
            called.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        message_type: type[M],
        transport: Transport,
        owner: Owner,
        signal: Signal,
    ) -> None:
        self.topic = endpoint.name
        self.latest: M | None = None
        self.missed = 0
        self.notify: Callable[[], object] | None = None
        self.taker: Callable[[M], bool] | None = None
        self._kept: deque[M] = deque(maxlen=endpoint.qos.depth)
        self._signal = signal
        self._is_open = True
        self._home = owner.home.of(f"the subscription of topic '{self.topic}'")
        # Latched messages may come before this returns.
        deliver = cast("Deliver", self._deliver)
        subscribed = transport.subscribe(endpoint, WireFormat(message_type), deliver)
        self._membership = owner.add(self, subscribed.close)

    def _deliver(self, message: M) -> None:
        """Queue a message. The transport calls this for each message."""
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
        """Return all unread messages without waiting."""
        self._home.check()
        drained = list(self._kept)
        self._kept.clear()
        return drained

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> M:
        self._home.check()
        while not self._kept:
            if not self._is_open:
                raise StopAsyncIteration
            await self._signal.wait()
        return self._kept.popleft()

    def close(self) -> None:
        """Close the subscription. A second call does nothing.

        Readers still get the messages that have already arrived. After that, their ``async for``
        loops end.
        """
        self._is_open = False
        self._membership.close()
        self._signal.fire()

    async def aclose(self) -> None:
        """Close the subscription, as `close` does."""
        self.close()
