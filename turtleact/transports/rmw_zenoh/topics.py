"""Both ends of a topic: objects within the process, bytes to and from the others.

A publication encodes a message only where somebody elsewhere reads the topic, or may later, as it
is latched. What it sends waits in its lane for the thread that sends; what a subscription gets
waits in another for the event loop. A lane of a best-effort topic is as long as its depth says; one
of a reliable topic is bounded in bytes alone, and `is_congested` tells who would lose nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import anyio

from turtleact.errors import InvalidMessage
from turtleact.transports.base import Format, Publication, QoS, Source
from turtleact.transports.rmw_zenoh.attachment import gid_in
from turtleact.transports.rmw_zenoh.boxes import Lane
from turtleact.transports.rmw_zenoh.link import Counter, Link, Named, Opened, Presence

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.session import Declared, Publisher

__all__ = ["WirePublication", "WireSubscription"]

logger = logging.getLogger("turtleact.transport")

Deliver: TypeAlias = Callable[[object], None]

#: From so many bytes on that wait to be sent, a publication is congested.
CONGESTED = 1024 * 1024

#: From so many on, it is so no more.
RELIEVED = CONGESTED // 2

#: So much of a state is sent to who may come later (bytes/s); reading as much status takes Python a
#: tenth of its time.
STATE_RATE = 1e6


class WirePublication:
    """The sending end of a topic.

    Args:
        link: What carries the messages.
        named: The endpoint.
        format: How messages are written.
        source: What makes the messages, if they are not given.
    """

    def __init__(self, link: Link, named: Named, format: Format, source: Source | None) -> None:
        endpoint = named.endpoint
        self._link = link
        self._key = named.key
        self._topic = endpoint.name
        self._qos = endpoint.qos
        self._format = format
        self._source = source
        self._gid = endpoint.gid
        self._counter = Counter(endpoint.gid)
        self._is_open = True
        self._is_read = self._is_latched = endpoint.qos.durability == "transient_local"
        self._is_expected = False  # that somebody reads
        self._is_stale = False
        self._is_watched = False  # by the courier below
        self._is_awaited = False  # that it is relieved
        self._publisher: Publisher | None = None
        self._unsent: Lane[tuple[bytes, bytes]] = _lane(endpoint.qos)
        self._sent = link.tasks.signal()
        self._told_readers = False
        self._has_near_readers = False
        # What a latched topic has told is kept by what is declared, so that is done at once.
        wakes = "" if self._is_latched and source is None else named.on_demand
        self._presence = Presence(
            link,
            named.token,
            self._declare,
            self._undeclare,
            on_demand=wakes,
            on_wake=self.refresh,
        )
        link.opened.add(self)
        relay = None if source is None else _Relay(source, self._near_readers_changed)
        self._near: Publication = link.near.advertise(endpoint, format, relay)
        if source is not None and self._is_latched:
            self._tell_source()
            self.refresh()

    @property
    def has_readers(self) -> bool:
        """Whether anybody would get a message published now, or may later, as it is latched."""
        return self._is_open and (self._is_read or self._near.has_readers)

    @property
    def has_near_readers(self) -> bool:
        """Whether somebody in this process would get a message."""
        return self._near.has_readers if self._source is None else self._has_near_readers

    @property
    def is_congested(self) -> bool:
        """Whether more waits to be sent than goes out."""
        return self._unsent.weight > CONGESTED

    def publish(self, message: object) -> None:
        """Send a message to every subscription."""
        if not self._is_open:
            return
        if self._is_read and not (self._is_latched and self._source is not None):
            self.send(self._format.encode(message))
        self._near.publish(message)
        if self._is_latched and self._source is not None:
            self._grow_stale()

    def expect_readers(self) -> None:
        """Send from now on, be a reader known here or not: news of one come by another way."""
        self._is_expected = self._is_read = True
        self._tell_source()

    def refresh(self) -> None:
        """Publish what the source makes now: at once here, once for many calls elsewhere."""
        if self._is_open and self._source is not None:
            self._near.refresh()
            if self._is_latched:
                self._grow_stale()
            elif self._is_read:
                self._send_current()

    async def drained(self) -> None:
        """Wait until it is not congested. Cancelling: safe."""
        if self.is_congested:
            while self._is_open:
                self._is_awaited = True  # before the look, or nobody would tell of what is sent
                if self._unsent.weight <= RELIEVED:
                    return
                await self._sent.wait()

    def close(self) -> None:
        """Leave the topic, with the last state sent; a second time does nothing."""
        if not self._is_open:
            return
        if self._is_stale:
            self._send_current()
        self._is_open = False
        self._near.close()
        self._sent.fire()
        self._presence.close()
        self._link.opened.discard(self)

    # readers

    def _matching(self, is_matching: bool) -> None:
        """Called in a thread of the session."""
        self._link.inbox.push(lambda: self._far_readers_changed(is_matching))

    def _far_readers_changed(self, has_readers: bool) -> None:
        self._is_read = has_readers or self._is_expected
        self._tell_source()
        self._link.near.tell_change()  # its token told of the reader, not that it is reached

    def _near_readers_changed(self, has_readers: bool) -> None:
        self._has_near_readers = has_readers
        self._tell_source()

    def _tell_source(self) -> None:
        has_readers = self._is_read or self._has_near_readers
        if self._source is not None and has_readers != self._told_readers:
            self._told_readers = has_readers
            self._source.readers_changed(has_readers=has_readers)

    # sending

    def send(self, data: bytes) -> None:
        """Send what is written already to the subscriptions in other processes."""
        link = self._link
        if not self._is_open or not link.is_open or self._presence.is_asleep:
            return
        if self._unsent.put((data, self._counter.next()), len(data)):
            link.outbox.post(self._put)  # one for each: what others send keeps its place
        else:
            _note_loss(self._topic, self._qos, self._unsent, "published than can be sent")

    def _send_current(self) -> int:
        """Send the source's state, and answer how much that is (bytes)."""
        self._is_stale = False
        payloads = () if self._source is None else self._source.written(self._format.encode)
        for payload in payloads:
            self.send(payload)
        return sum(map(len, payloads))

    def _grow_stale(self) -> None:
        """Have the source's state sent, once for all changes until the loop's next turn."""
        if self._presence.is_asleep:  # it is refreshed once it wakes
            return
        self._is_stale = True
        if not self._is_watched:
            self._is_watched = True
            self._link.crew.run(self._carry(), f"the source of topic {self._topic}")

    async def _carry(self) -> None:
        try:
            while self._is_stale and self._is_open:
                await self._link.tasks.checkpoint()
                if not self._is_stale or not self._is_open:  # closed meanwhile
                    return
                await anyio.sleep(self._send_current() / STATE_RATE)
                await self.drained()
        finally:
            self._is_watched = False

    # in the outbox

    def _declare(self) -> None:
        session, is_reliable = self._link.session, self._qos.reliability == "reliable"
        if self._is_latched:
            self._link.latched.add(self._gid)
            self._publisher = session.declare_latched_publisher(
                self._key, is_reliable=is_reliable, depth=self._qos.depth
            )
        else:
            self._publisher = session.declare_publisher(
                self._key, is_reliable=is_reliable, matching=self._matching
            )

    def _put(self) -> None:
        try:
            entry = self._unsent.take()
            if entry is not None and self._publisher is not None:
                self._publisher.put(*entry)
        finally:
            if self._is_awaited and self._unsent.weight <= RELIEVED:
                self._is_awaited = False
                self._link.tasks.from_anywhere(self._sent.fire)

    def _undeclare(self) -> None:
        if self._publisher is not None:
            self._publisher.undeclare()
        self._link.latched.discard(self._gid)


class WireSubscription:
    """The receiving end of a topic.

    Args:
        link: What carries the messages.
        named: The endpoint.
        format: How messages are read.
        deliver: Gets each message.
    """

    def __init__(self, link: Link, named: Named, format: Format, deliver: Deliver) -> None:
        endpoint = named.endpoint
        self._link = link
        self._key = named.key
        self._topic = endpoint.name
        self._qos = endpoint.qos
        self._format = format
        self._deliver = deliver
        self._unread: Lane[bytes] = _lane(endpoint.qos)
        self._declared: Declared | None = None
        near = link.near.subscribe(endpoint, format, deliver)
        presence = Presence(
            link, named.token, self._declare, self._undeclare, on_demand=named.on_demand
        )
        self._opened = Opened(link, near, presence)

    def close(self) -> None:
        """Leave the topic; a second time does nothing."""
        self._opened.close()

    def _take_latched(self, payload: bytes, attachment: bytes) -> None:
        """Called in a thread of the session."""
        if gid_in(attachment) not in self._link.latched:  # else it came as an object
            self._take(payload)

    def _take(self, payload: bytes) -> None:
        """Called in a thread of the session."""
        if self._unread.put(payload, len(payload)):
            self._link.inbox.push(self._read)
        else:
            _note_loss(self._topic, self._qos, self._unread, "sent than is read")

    def _read(self) -> None:
        payload = self._unread.take()
        if payload is None or not self._opened.is_open:
            return
        try:
            message = self._format.decode(payload)
        except InvalidMessage as error:
            logger.warning("topic %s: a message cannot be read: %s", self._topic, error)
            return
        try:
            self._deliver(message)
        except Exception:
            logger.exception("a subscription of topic %s failed on a message", self._topic)

    # in the outbox

    def _declare(self) -> None:
        session = self._link.session
        if self._qos.durability == "transient_local":
            self._declared = session.declare_latched_subscriber(
                self._key, self._take_latched, depth=self._qos.depth
            )
        else:
            self._declared = session.declare_subscriber(self._key, self._take)

    def _undeclare(self) -> None:
        if self._declared is not None:
            self._declared.undeclare()


class _Relay:
    """The source that the local half knows: its readers are not all."""

    def __init__(self, source: Source, readers_changed: Callable[[bool], None]) -> None:
        self._source = source
        self._readers_changed = readers_changed

    def current(self) -> Sequence[object]:
        return self._source.current()

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:
        return self._source.written(encode)

    def readers_changed(self, *, has_readers: bool) -> None:
        self._readers_changed(has_readers)


def _note_loss(topic: str, qos: QoS, lane: Lane[Any], what: str) -> None:
    """Say once that a topic which is called reliable is not."""
    if qos.reliability == "reliable" and lane.dropped == 1:
        logger.warning("topic %s: more is %s; the oldest messages are dropped", topic, what)


def _lane(qos: QoS) -> Lane[Any]:
    is_sensor = qos.reliability == "best_effort" and qos.durability == "volatile"
    return Lane(qos.depth if is_sensor else None)
