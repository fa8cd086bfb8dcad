"""The topics that the clients of a bridge read.

However many clients read a topic, it is subscribed to once, and each frame is made once. A latched
topic is subscribed to for each client anew: only so a late one gets what the publishers keep.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from turtleact.interfaces import Message
from turtleact.node import Node
from turtleact.tasks import Background
from turtleact.topics import Subscription
from turtleact.transports import QoS
from turtleact.web.directory import Directory
from turtleact.web.frames import Rendering

__all__ = ["Deliver", "Feed", "Feeds"]

Deliver: TypeAlias = Callable[[Rendering], None]

DEPTH = 32
"""So many messages are kept for the one task that hands them to all clients."""


class Feed:
    """A topic, and those who read it.

    Args:
        subscription: Its messages.
        reader: The first of them; what has come already is delivered to it at once.
        now: The time (ns since the epoch).

    Attributes:
        readers: All of them.
    """

    def __init__(
        self, subscription: Subscription[Message], reader: Deliver, now: Callable[[], int]
    ) -> None:
        self.readers: list[Deliver] = [reader]
        self._subscription = subscription
        self._now = now
        self._reading = Background(self._read(), f"a reader of {subscription.topic}")

    async def aclose(self) -> None:
        """Leave the topic."""
        await self._subscription.aclose()
        await self._reading.aclose()

    async def _read(self) -> None:
        async for message in self._subscription:
            rendering = Rendering(message, self._now())
            for deliver in tuple(self.readers):
                deliver(rendering)


class Feeds:
    """The topics that are read.

    Args:
        node: Where they are subscribed to.
        directory: Says which of them are latched.
    """

    def __init__(self, node: Node, directory: Directory) -> None:
        self._node = node
        self._directory = directory
        self._shared: dict[tuple[str, type[Message]], Feed] = {}

    def join(self, topic: str, message_type: type[Message], deliver: Deliver) -> Feed:
        """Have a topic's messages delivered; what the publishers keep of a latched one, too.

        Raises:
            TurtleactError: if the node is closed.
        """
        key = (topic, message_type)
        is_latched = self._directory.is_latched(topic)
        feed = None if is_latched else self._shared.get(key)
        if feed is not None:
            feed.readers.append(deliver)
            return feed
        qos = QoS(depth=DEPTH, durability="transient_local" if is_latched else "volatile")
        subscription = self._node.subscription(message_type, topic, qos)
        feed = Feed(subscription, deliver, self._node.clock.now)
        if not is_latched:
            self._shared[key] = feed
        return feed

    async def leave(self, feed: Feed, deliver: Deliver) -> None:
        """Deliver no more; the last one closes the feed."""
        feed.readers.remove(deliver)
        if not feed.readers:
            self._shared = {key: each for key, each in self._shared.items() if each is not feed}
            await feed.aclose()
