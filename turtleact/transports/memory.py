"""Inside one process: hands each message on as it is, in the publisher's own call.

Messages are shared, not copied: a publisher gives away a snapshot. One event loop only.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from functools import partial

from turtleact.clock import Clock, WallClock
from turtleact.tasks import Signal, current_tasks
from turtleact.transports.base import Closeable, Endpoint, Publication

__all__ = ["MemoryTransport"]

logger = logging.getLogger("turtleact.transport")

Deliver = Callable[[object], None]


class MemoryTransport:
    """A graph inside one process and one event loop.

    Nodes that are given the same object see each other.

    Args:
        clock: The time of all nodes on it; wall time if left out.
    """

    def __init__(self, clock: Clock | None = None) -> None:
        self.clock: Clock = WallClock() if clock is None else clock
        self._topics: dict[tuple[str, str], _Topic] = {}
        self._handlers: dict[tuple[str, str], list[object]] = {}
        self._endpoints: dict[int, Endpoint] = {}
        self._opened = 0
        self._changed: Signal | None = None

    def advertise(self, endpoint: Endpoint) -> Publication:
        """Open the sending end of a topic."""
        topic = self._topic(endpoint)
        publication = _Publication(topic, endpoint)
        publication.on_close = self._appear(endpoint, partial(topic.retract, publication))
        return publication

    def subscribe(self, endpoint: Endpoint, deliver: Deliver) -> Closeable:
        """Open the receiving end of a topic; latched messages are delivered before this returns."""
        topic = self._topic(endpoint)
        if endpoint.qos.durability == "transient_local":
            for message in topic.latched():
                topic.hand(message, deliver)
        topic.readers.append(deliver)
        return _Opened(self._appear(endpoint, partial(topic.readers.remove, deliver)))

    def serve(self, endpoint: Endpoint, handler: object) -> Closeable:
        """Offer ``handler`` as a server; of several, the one that came first is found."""
        handlers = self._handlers.setdefault((endpoint.name, endpoint.type_name), [])
        handlers.append(handler)
        return _Opened(self._appear(endpoint, partial(handlers.remove, handler)))

    def join(self, endpoint: Endpoint) -> Closeable:
        """Appear in the graph as a client of a service."""
        return _Opened(self._appear(endpoint, _nothing))

    def local(self, name: str, type_name: str) -> object | None:
        """The handler that serves a service, if there is one."""
        handlers = self._handlers.get((name, type_name))
        return handlers[0] if handlers else None

    def endpoints(self) -> tuple[Endpoint, ...]:
        """All endpoints of the graph, in the order of their opening."""
        return tuple(self._endpoints.values())

    async def wait_for_change(self) -> None:
        """Wait until an endpoint is opened or closed. Cancelling: safe."""
        if self._changed is None:
            self._changed = current_tasks().signal()
        await self._changed.wait()

    def _topic(self, endpoint: Endpoint) -> _Topic:
        return self._topics.setdefault((endpoint.name, endpoint.type_name), _Topic(endpoint.name))

    def _appear(self, endpoint: Endpoint, leave: Callable[[], None]) -> Callable[[], None]:
        self._opened += 1
        key = self._opened
        self._endpoints[key] = endpoint
        self._notify()

        def disappear() -> None:
            if self._endpoints.pop(key, None) is not None:
                leave()
                self._notify()

        return disappear

    def _notify(self) -> None:
        if self._changed is not None:
            self._changed.fire()


class _Topic:
    """The publishers and readers of one topic."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.readers: list[Deliver] = []
        self.publications: list[_Publication] = []

    def latched(self) -> list[object]:
        return [message for each in self.publications for message in each.latch]

    def hand(self, message: object, deliver: Deliver) -> None:
        try:
            deliver(message)
        except Exception:
            logger.exception("a subscription of topic %s failed on a message", self.name)

    def retract(self, publication: _Publication) -> None:
        if publication in self.publications:
            self.publications.remove(publication)


class _Publication:
    """The sending end of a topic."""

    on_close: Callable[[], None]

    def __init__(self, topic: _Topic, endpoint: Endpoint) -> None:
        self._topic = topic
        self._closed = False
        latches = endpoint.qos.durability == "transient_local"
        self.latch: deque[object] = deque(maxlen=endpoint.qos.depth if latches else 0)
        if latches:
            topic.publications.append(self)

    @property
    def has_readers(self) -> bool:
        return bool(self._topic.readers) or self.latch.maxlen != 0

    def publish(self, message: object) -> None:
        if self._closed:
            return
        self.latch.append(message)
        for deliver in tuple(self._topic.readers):
            self._topic.hand(message, deliver)

    def close(self) -> None:
        self._closed = True
        self.on_close()


class _Opened:
    """Anything else that was opened."""

    def __init__(self, on_close: Callable[[], None]) -> None:
        self.close = on_close


def _nothing() -> None:
    """There is nothing else to undo."""
