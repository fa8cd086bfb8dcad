"""The transport inside one process. Publishing a message delivers it to all subscriptions at once.

Messages are shared, not copied, so a publisher must not change a message afterwards. This transport
is never congested, and works in one event loop only.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from typing import TypeAlias, cast

import msgspec

from turtleact.errors import ServerUnavailable, ServiceError, TurtleactError, summary
from turtleact.tasks import Signal, current_tasks
from turtleact.tasks.clock import Clock, WallClock
from turtleact.transports.base import (
    EVERY_SERVER,
    Caller,
    CallObserver,
    Closeable,
    Closing,
    Deliver,
    Endpoint,
    Format,
    Publication,
    QoS,
    RawFormat,
    Reply,
    ServiceHandler,
    Source,
    Target,
    why_not_served,
)

__all__ = ["MemoryTransport"]

logger = logging.getLogger("turtleact.transport")

Key: TypeAlias = tuple[str, str]
Leave: TypeAlias = Callable[[], None]


class MemoryTransport:
    """A graph inside one process and one event loop.

    Nodes that use the same transport object see each other.

    Args:
        clock: The clock of all nodes on the graph. The default is wall time.
    """

    def __init__(self, clock: Clock | None = None) -> None:
        self.clock: Clock = WallClock() if clock is None else clock
        self.round_trip = 0.0
        self.discovery_ends = -math.inf
        self._topics: dict[Key, _Topic] = {}
        self._handlers: dict[Key, list[_Offer]] = {}
        self._servers: dict[tuple[str, str, str], Leave] = {}  # by service and node
        self._endpoints: dict[int, Endpoint] = {}
        self._by_name: dict[str, dict[int, Endpoint]] = {}  # the same endpoints by name
        self._nodes: dict[int, str] = {}
        self._count = count(1)  # numbers nodes and endpoints
        self.changes = 0
        self._changed: Signal | None = None

    def advertise(
        self,
        endpoint: Endpoint,
        format: Format,
        source: Source | None = None,
    ) -> Publication:
        """Open the sending end of a topic.

        If you pass a ``source``, a new reader of a latched topic gets the messages that ``source``
        returns. The reader does not get earlier messages passed to `Publication.publish`.
        """
        topic = self._topic(endpoint)
        publication = _Publication(topic, endpoint.qos, format, source)
        topic.publications.append(publication)
        leave = partial(self._withdraw, topic, publication)
        publication.on_close = self._appear_as(endpoint, leave)
        if source is not None and topic.readers:
            source.readers_changed(has_readers=True)
        return publication

    def subscribe(
        self,
        endpoint: Endpoint,
        format: Format,
        deliver: Deliver,
        *,
        in_any_thread: bool = False,  # noqa: ARG002  # a message comes in its publisher's thread
        on_gap: Callable[[int], None] | None = None,  # noqa: ARG002  # nothing is lost in a process
    ) -> Closeable:
        """Open the receiving end of a topic.

        Latched messages are delivered before this method returns.
        """
        topic = self._topic(endpoint)
        reader = _Reader(topic.key[0], deliver, takes_bytes=isinstance(format, RawFormat))
        if endpoint.qos.durability == "transient_local":
            for message in topic.latched():
                reader.take(message)
        topic.set_readers((*topic.readers, reader))
        leave = partial(self._leave, topic, reader)
        reader.on_close = self._appear_as(endpoint, leave)
        return reader

    def serve(
        self,
        endpoint: Endpoint,
        format: Format,
        handler: ServiceHandler,
    ) -> Closeable:
        """Offer ``handler`` as a server of a service. Requests go to the oldest handler.

        If a node offers several handlers of a service, the graph shows them as one endpoint until
        the last of them is closed.
        """
        key, offer = _key(endpoint), _Offer(handler, endpoint.node, format)
        offers = self._handlers.setdefault(key, [])
        offers.append(offer)
        server = (*key, endpoint.node)
        if server in self._servers:
            self.tell_change()
        else:
            self._servers[server] = self._appear_as(endpoint, _nothing)
        return Closing(partial(self._revoke, key, offer))

    def join(
        self,
        endpoint: Endpoint,
        format: Format,
        target: Target = EVERY_SERVER,  # noqa: ARG002  # a request goes to the first server
    ) -> Caller:
        """Show a client of a service on the graph, and return the object that calls the service."""
        gid = endpoint.gid or next(self._count).to_bytes(16)
        caller = _Caller(self, endpoint, gid, is_raw=isinstance(format, RawFormat))
        leave = partial(self.client_lost, endpoint.name, caller.gid)
        caller.on_close = self._appear_as(endpoint, leave)
        return caller

    def local(self, name: str, type_name: str) -> tuple[ServiceHandler, ...]:
        """All handlers that serve a service, oldest first."""
        return tuple(offer.handler for offer in self.offers(name, type_name))

    def offers(self, name: str, type_name: str) -> list[_Offer]:
        """All offers of a service, oldest first."""
        return self._handlers.get((name, type_name), [])

    def client_lost(self, name: str, gid: bytes) -> None:
        """Tell all servers of the services called ``name`` that a client has gone."""
        for key, offers in self._handlers.items():
            if key[0] == name:
                for offer in offers:
                    offer.handler.caller_lost(gid)

    def enter(self, node: str) -> Closeable:
        """Show a node on the graph."""
        number = next(self._count)
        self._nodes[number] = node
        self.tell_change()
        return Closing(partial(self._depart, number))

    def call_when_sought(
        self,
        name: str,  # noqa: ARG002  # as below
        act: Callable[[], object],  # noqa: ARG002  # there are no other processes
    ) -> Closeable:
        """Never call ``act``, because all endpoints are in this process."""
        return Closing(_nothing)

    def endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """All endpoints on the graph, or only those of the topic or service ``name``.

        The oldest endpoint comes first. Without a ``name``, unlisted endpoints are left out.
        """
        if name:
            return tuple(self._by_name.get(name, {}).values())
        return tuple(each for each in self._endpoints.values() if not each.is_unlisted)

    def local_endpoints(self, name: str = "") -> tuple[Endpoint, ...]:
        """The same endpoints as those of `endpoints`, because all endpoints are in this process."""
        return self.endpoints(name)

    def nodes(self) -> tuple[str, ...]:
        """The names of all nodes, in the order they appeared. A name may occur twice."""
        return tuple(self._nodes.values())

    async def wait_for_change(self) -> None:
        """Wait until a node or endpoint appears or disappears. Cancelling: safe."""
        if self._changed is None:
            self._changed = current_tasks().signal()
        await self._changed.wait()

    def tell_change(self) -> None:
        """Count a change of the graph, and wake the tasks that wait for a change."""
        self.changes += 1
        if self._changed is not None:
            self._changed.fire()

    def _topic(self, endpoint: Endpoint) -> _Topic:
        key = _key(endpoint)
        return self._topics.setdefault(key, _Topic(key))

    def _withdraw(self, topic: _Topic, publication: _Publication) -> None:
        topic.publications.remove(publication)
        if topic.is_deserted:
            del self._topics[topic.key]

    def _leave(self, topic: _Topic, reader: _Reader) -> None:
        topic.set_readers(tuple(each for each in topic.readers if each is not reader))
        if topic.is_deserted:
            del self._topics[topic.key]

    def _revoke(self, key: Key, offer: _Offer) -> None:
        offers = self._handlers.get(key, [])
        if offer not in offers:
            return
        offers.remove(offer)
        if not offers:
            del self._handlers[key]
        if any(each.node == offer.node for each in offers):
            self.tell_change()
        else:
            self._servers.pop((*key, offer.node))()

    def _appear_as(self, endpoint: Endpoint, leave: Callable[[], None]) -> Leave:
        """Show an endpoint on the graph, and return the function that removes it.

        The function is a `partial`, because a closure would create ten objects per endpoint. A
        graph may have thousands of endpoints.
        """
        number = next(self._count)
        self._endpoints[number] = endpoint
        self._by_name.setdefault(endpoint.name, {})[number] = endpoint
        self.tell_change()
        return partial(self._disappear, number, leave)

    def _disappear(self, number: int, leave: Leave) -> None:
        endpoint = self._endpoints.pop(number, None)
        if endpoint is not None:
            namesakes = self._by_name[endpoint.name]
            del namesakes[number]
            if not namesakes:
                del self._by_name[endpoint.name]
            leave()
            self.tell_change()

    def _depart(self, number: int) -> None:
        if self._nodes.pop(number, None) is not None:
            self.tell_change()


class _Topic:
    """The publications and readers of one topic.

    Attributes:
        readers: The open subscriptions. Each change makes a new tuple, because subscriptions may
            open and close while a message is delivered.
    """

    def __init__(self, key: Key) -> None:
        self.key = key
        self.readers: tuple[_Reader, ...] = ()
        self.publications: list[_Publication] = []

    @property
    def is_deserted(self) -> bool:
        return not self.readers and not self.publications

    def latched(self) -> list[object]:
        return [message for each in self.publications for message in each.latched()]

    def set_readers(self, readers: tuple[_Reader, ...]) -> None:
        had_readers, self.readers = bool(self.readers), readers
        for each in self.publications:
            if each.source is not None and bool(readers) != had_readers:
                each.source.readers_changed(has_readers=bool(readers))


class _Publication:
    """The sending end of a topic."""

    on_close: Leave

    def __init__(self, topic: _Topic, qos: QoS, format: Format, source: Source | None) -> None:
        self.source = source
        self._encode = format.encode
        self._topic = topic
        self._is_open = True
        self._is_latched = qos.durability == "transient_local"
        self._keeps = self._is_latched and source is None
        self._latch: deque[object] = deque(maxlen=qos.depth if self._keeps else 0)

    @property
    def has_readers(self) -> bool:
        return self._is_open and (self._keeps or bool(self._topic.readers))

    @property
    def has_object_readers(self) -> bool:
        readers = self._topic.readers
        return self._is_open and (self._keeps or not all(each.takes_bytes for each in readers))

    @property
    def is_congested(self) -> bool:
        return False

    def latched(self) -> Sequence[object]:
        if self.source is None or not self._is_latched:
            return self._latch
        return self.source.current()

    def publish(self, message: object) -> None:
        if self._is_open:
            if self._keeps:
                self._latch.append(message)
            for reader in self._topic.readers:
                reader.take(message)

    def send(self, data: bytes) -> None:
        """Deliver the bytes to the subscriptions that accept bytes."""
        if self._is_open:
            for reader in self._topic.readers:
                if reader.takes_bytes:
                    reader.take(data)

    def expect_readers(self) -> None:
        """Do nothing, because all readers are in this process and the transport knows them."""

    def refresh(self) -> None:
        if self.source is None or not self._topic.readers:
            return
        if self.has_object_readers:
            for message in self.source.current():
                self.publish(message)
        else:  # a source may write bytes faster
            for data in self.source.written(self._encode):
                self.send(data)

    async def drained(self) -> None:
        """Return at once, because this publication is never congested."""

    def close(self) -> None:
        self._is_open = False
        self.on_close()


class _Reader:
    """The receiving end of a topic."""

    on_close: Leave

    def __init__(self, topic: str, deliver: Deliver, *, takes_bytes: bool) -> None:
        self.takes_bytes = takes_bytes
        self._topic = topic
        self._deliver = deliver
        self._is_open = True

    def take(self, message: object) -> None:
        if self._is_open:  # an earlier reader of this message may have closed it
            try:
                self._deliver(message)
            except Exception:
                logger.exception(
                    "a subscription of topic %s failed to handle a message", self._topic
                )

    def close(self) -> None:
        self._is_open = False
        self.on_close()


class _Caller:
    """The client end of a service."""

    on_close: Leave

    def __init__(
        self, transport: MemoryTransport, endpoint: Endpoint, gid: bytes, *, is_raw: bool
    ) -> None:
        self.endpoint = endpoint
        self.gid = gid
        self._is_raw = is_raw
        self.observer: CallObserver | None = None
        self._sequence = 0
        self._calls = 0  # under way
        self._transport = transport
        self._is_open = True

    @property
    def is_served(self) -> bool:
        return bool(self._offers())

    async def call(self, request: object, note: str = "") -> Reply:  # noqa: ARG002
        name, offers = self.endpoint.name, self._offers()
        if not self._is_open:
            raise TurtleactError(f"the client of service '{name}' is closed: open another")
        if not offers:
            raise ServerUnavailable(name, self.why_not_served(), kind="service")
        offer = offers[0]
        self._calls += 1
        self._sequence += 1
        sequence = self._sequence
        observers = [each for each in (self.observer, offer.handler.observer) if each is not None]
        for each in observers:
            each.requested(request, self.gid, sequence)
        try:
            reply = await self._answer(offer, request)
        except TurtleactError:
            raise
        except Exception as error:
            raise ServiceError(name, f"the handler failed: {summary(error)}") from error
        finally:
            self._calls -= 1
            if not self._is_open:
                self._leave_if_idle()
        for each in reversed(observers):  # the server has answered before the client has heard
            each.responded(reply.message, self.gid, sequence)
        return reply

    async def wait_for_route(self) -> None:
        """Do nothing, because every server is in this process and can be reached."""

    def why_not_served(self, suffix: str = "") -> str:
        endpoint = self.endpoint
        return why_not_served(self._transport.endpoints(endpoint.name), endpoint, suffix)

    def close(self) -> None:
        """Remove the client from the graph, once its calls under way are over.

        The client stays on the graph until then, because a server may cancel the requests of a
        client that has left.
        """
        self._is_open = False
        self._leave_if_idle()

    def _leave_if_idle(self) -> None:
        if not self._calls:
            self.on_close()

    def _offers(self) -> list[_Offer]:
        return self._transport.offers(self.endpoint.name, self.endpoint.type_name)

    async def _answer(self, offer: _Offer, request: object) -> Reply:
        """Pass a request to a server. If this client's messages are encoded, encode the reply."""
        if not self._is_raw or isinstance(offer.format, RawFormat):
            return await offer.handler.reply(request, self.gid)
        decoded = offer.format.decode(cast("bytes", request))
        reply = await offer.handler.reply(decoded, self.gid)
        return Reply(offer.format.encode(reply.message), reply.note)


class _Offer(msgspec.Struct, eq=False):
    """A handler that a node offers. Two offers of the same handler are not equal."""

    handler: ServiceHandler
    node: str
    format: Format


def _nothing() -> None:
    """Do nothing."""


def _key(endpoint: Endpoint) -> Key:
    return endpoint.name, endpoint.type_name
