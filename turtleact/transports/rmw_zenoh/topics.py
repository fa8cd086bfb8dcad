"""Both ends of a topic. They exchange objects inside a process, and bytes between processes.

A publication encodes a message only if another process reads the topic or the topic is latched.
Outgoing messages wait in a `BoundedQueue` until the sending thread takes them. Received messages
wait in a second one until the event loop takes them. Each limits the number of bytes. If the topic
is best-effort and not latched, the queue also limits the number of messages to the topic's depth.
A publisher that must not lose messages waits while
`WirePublication.is_congested` is true.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import anyio

from turtleact.errors import InvalidMessage
from turtleact.transports.base import Deliver, Endpoint, Format, Publication, Source
from turtleact.transports.rmw_zenoh.context import Context, Declaration, Named, Opened
from turtleact.transports.rmw_zenoh.wire import Attachments, count_in, gid_in

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.session import Declared, Publisher

__all__ = ["BoundedQueue", "WirePublication", "WireSubscription"]

logger = logging.getLogger("turtleact.transport")

T = TypeVar("T")


#: How many bytes a queue holds before it drops the oldest message.
CAPACITY = 32 * 1024 * 1024

#: The overhead of an entry, added to its bytes.
ENTRY = 256

#: A publication is congested once this many bytes wait to be sent.
CONGESTED = 1024 * 1024

#: It is no longer congested when only this many are left.
RELIEVED = CONGESTED // 2

#: How fast a state is sent for late readers (bytes/s). Reading that much status costs Python a
#: tenth of its time.
STATE_RATE = 1e6


class BoundedQueue(Generic[T]):
    """A queue that one thread fills and another empties.

    Args:
        longest: The maximum number of entries; None for no limit.
        loss: The warning to log when the first entry is dropped; empty if that is no surprise.

    Attributes:
        weight: How many bytes wait in the queue, including `ENTRY` bytes for each entry.
        dropped: How many entries were dropped because the queue was full.
    """

    def __init__(self, longest: int | None = None, loss: str = "") -> None:
        self.weight = 0
        self.dropped = 0
        self._longest = longest
        self._loss = loss
        self._entries: deque[tuple[T, int]] = deque()
        self._lock = threading.Lock()

    def put(self, entry: T, size: int) -> bool:
        """Add an entry of ``size`` bytes. Return False if the full queue dropped an entry."""
        with self._lock:
            self._entries.append((entry, size + ENTRY))
            self.weight += size + ENTRY
            is_full = self.weight > CAPACITY or len(self._entries) - 1 == self._longest
            if not is_full or len(self._entries) == 1:
                return True
            self._remove()
            self.dropped += 1
        if self._loss and self.dropped == 1:
            logger.warning("%s", self._loss)
        return False

    def take(self) -> T | None:
        """Remove and return the oldest entry; None if the queue is empty."""
        with self._lock:
            return self._remove() if self._entries else None

    def _remove(self) -> T:
        entry, weight = self._entries.popleft()
        self.weight -= weight
        return entry


class WirePublication(Source):
    """The sending end of a topic, and its source in the local transport.

    The local transport knows only the readers in this process. The publication also knows those in
    other processes, and tells the source of the messages whether the topic has any reader.

    Args:
        context: The transport's context.
        named: The publisher's endpoint.
        format: Encodes messages.
        source: Makes messages from the state of an object; None if all messages are passed to
            `publish`.

    Attributes:
        is_read: Whether messages are sent to other processes. This is True if another process reads
            the topic, if another process is expected to read it, or if the topic is latched.
        is_latched: Whether the topic's last messages are kept for later readers.
        is_stale: Whether the source has a new state that has not been sent yet.
        declaration: Declares the publisher to other processes.
        publisher: The publisher on Zenoh; None before it is declared.
    """

    def __init__(
        self, context: Context, named: Named, format: Format, source: Source | None
    ) -> None:
        endpoint = named.endpoint
        self._context = context
        self._key = named.key
        self._topic = endpoint.name
        self._qos = endpoint.qos
        self._format = format
        self._source = Source() if source is None else source  # the first one makes no messages
        self._gid = endpoint.gid
        self._attachments = Attachments(endpoint.gid)
        self._is_open = True
        self.is_read = self.is_latched = endpoint.qos.durability == "transient_local"
        self._is_state = self.is_latched and source is not None
        self._is_expected = False  # a reader that is not discovered yet
        self.is_stale = False
        self._is_watched = False  # whether the task below watches for changes
        self._is_awaited = False  # whether somebody waits in `drained`
        self.publisher: Publisher | None = None
        self._unsent: BoundedQueue[tuple[bytes, bytes]] = _queue_for(
            endpoint, "published than can be sent"
        )
        self._sent = context.tasks.signal()
        self._told_readers = False
        self._has_local_readers = False
        # Zenoh keeps the messages of a latched topic once it is declared, so declare it at once.
        wakes = "" if self.is_latched and source is None else named.on_demand
        self.declaration = Declaration(
            context,
            named.token,
            self._declare,
            on_demand=wakes,
            on_wake=self.refresh,
        )
        context.opened.add(self)
        inner = None if source is None else self
        self._near: Publication = context.near.advertise(endpoint, format, inner)
        if self._is_state:
            self._tell_source()
            self.refresh()

    @property
    def has_readers(self) -> bool:
        """Whether a new message has a reader, or (if the topic is latched) may get one later."""
        return self._is_open and (self.is_read or self._near.has_readers)

    @property
    def has_object_readers(self) -> bool:
        """Whether a subscription in this process needs, or may later need, message objects."""
        return self._near.has_object_readers

    @property
    def is_congested(self) -> bool:
        """Whether more than `CONGESTED` bytes wait to be sent."""
        return self._unsent.weight > CONGESTED

    def publish(self, message: object) -> None:
        """Send a message to every subscription."""
        if not self._is_open:
            return
        if self.is_read and not self._is_state:
            self._send_far(self._format.encode(message))
        self._near.publish(message)
        if self._is_state:
            self._grow_stale()

    def expect_readers(self) -> None:
        """From now on, send messages to other processes even before a reader is known."""
        self._is_expected = self.is_read = True
        self._tell_source()

    def refresh(self) -> None:
        """Publish the source's state.

        On a latched topic, several calls in a row send only the last state to other processes.
        """
        if self._is_open:
            if self._near.has_readers:
                self._near.refresh()
            if self._is_state:
                self._grow_stale()
            elif self.is_read:
                self._send_current()

    async def drained(self) -> None:
        """Wait until the publication is no longer congested. Cancelling: safe."""
        if self.is_congested:
            while self._is_open:
                self._is_awaited = True  # set before looking, or the wake-up could be missed
                if self._unsent.weight <= RELIEVED:
                    return
                await self._sent.wait()

    def close(self) -> None:
        """Send the source's unsent messages, then leave the graph. A second call does nothing."""
        if not self._is_open:
            return
        if self.is_stale:
            self._send_current()
        self._is_open = False
        self._near.close()
        self._sent.fire()
        self.declaration.close()
        # Only once the publisher is undeclared, no message of it can come back from Zenoh.
        self._context.send_queue.post(lambda: self._context.latched.discard(self._gid))
        self._context.opened.discard(self)

    # readers

    def _matching(self, is_matching: bool) -> None:
        """Record whether other processes have readers; called when that changes.

        A thread of the session calls this.
        """
        self._context.receive_queue.push(lambda: self._remote_readers_changed(is_matching))

    def _remote_readers_changed(self, has_readers: bool) -> None:
        self.is_read = has_readers or self._is_expected
        self._tell_source()
        self._context.near.tell_change()  # its token announced the reader; now it can be reached

    def current(self) -> Sequence[object]:
        """Return the source's messages for a new reader in this process."""
        return self._source.current()

    def written(self, encode: Callable[[object], bytes]) -> Sequence[bytes]:
        """Return the source's messages as bytes."""
        return self._source.written(encode)

    def readers_changed(self, *, has_readers: bool) -> None:
        """Called when the topic gets its first reader in this process or loses its last one."""
        self._has_local_readers = has_readers
        self._tell_source()

    def _tell_source(self) -> None:
        has_readers = self.is_read or self._has_local_readers
        if has_readers != self._told_readers:
            self._told_readers = has_readers
            self._source.readers_changed(has_readers=has_readers)

    # sending

    def send(self, data: bytes) -> None:
        """Send an encoded message to other processes and to subscriptions with a `RawFormat`."""
        if self._near.has_readers:
            self._near.send(data)
        self._send_far(data)

    def _send_far(self, data: bytes) -> None:
        context = self._context
        if not self._is_open or not context.is_open or self.declaration.is_pending:
            return
        if self._unsent.put((data, self._attachments.next()), len(data)):
            # One job per message keeps the order among publishers.
            context.send_queue.post(self._put)
        else:
            self._source.message_lost()

    def _send_current(self) -> int:
        """Send the source's current messages to other processes, and return their size (bytes)."""
        self.is_stale = False
        payloads = self._source.written(self._format.encode)
        for payload in payloads:
            self._send_far(payload)
        return sum(map(len, payloads))

    def _grow_stale(self) -> None:
        """Start a task that sends the source's current messages, unless the task already runs.

        Several calls in a row send only the latest messages of the source.
        """
        if self.declaration.is_pending:  # it is refreshed when it wakes
            return
        self.is_stale = True
        if not self._is_watched:
            self._is_watched = True
            self._context.crew.run(self._carry(), f"the source of topic {self._topic}")

    async def _carry(self) -> None:
        try:
            while self.is_stale and self._is_open:
                await self._context.tasks.checkpoint()
                if not self.is_stale or not self._is_open:  # closed meanwhile
                    return
                await anyio.sleep(self._send_current() / STATE_RATE)
                await self.drained()
        finally:
            self._is_watched = False

    # called in the thread of the send queue

    def _declare(self) -> Publisher:
        session, is_reliable = self._context.session, self._qos.reliability == "reliable"
        if self.is_latched:
            self._context.latched.add(self._gid)
            self.publisher = session.declare_latched_publisher(
                self._key, is_reliable=is_reliable, depth=self._qos.depth
            )
        else:
            self.publisher = session.declare_publisher(
                self._key, is_reliable=is_reliable, matching=self._matching
            )
        return self.publisher

    def _put(self) -> None:
        try:
            entry = self._unsent.take()
            if entry is not None and self.publisher is not None:
                self.publisher.put(*entry)
        finally:
            if self._is_awaited and self._unsent.weight <= RELIEVED:
                self._is_awaited = False
                self._context.tasks.from_anywhere(self._sent.fire)


class WireSubscription:
    """The receiving end of a topic.

    Args:
        context: The transport's context.
        named: The subscription's endpoint.
        format: Decodes messages.
        deliver: Called with each message.
        on_gap: Called with the number of messages that did not arrive.
        in_any_thread: Whether the thread of the session that receives a message delivers it. It may
            then still deliver a message while the subscription is being closed.
    """

    def __init__(
        self,
        context: Context,
        named: Named,
        format: Format,
        deliver: Deliver,
        on_gap: Callable[[int], None] | None,
        *,
        in_any_thread: bool,
    ) -> None:
        endpoint = named.endpoint
        self._context = context
        self._key = named.key
        self._topic = endpoint.name
        self._qos = endpoint.qos
        self._format = format
        self._deliver = deliver
        self._unread: BoundedQueue[bytes] = _queue_for(endpoint, "sent than is read")
        self._take = self._hand_over if in_any_thread else self._put_by
        self._on_gap = on_gap
        self._is_latched = endpoint.qos.durability == "transient_local"
        self._counts: dict[bytes, int] = {}  # the newest sequence number of each publisher
        near = context.near.subscribe(endpoint, format, deliver)
        declaration = Declaration(context, named.token, self._declare, on_demand=named.on_demand)
        self._opened = Opened(context, near, declaration)

    def close(self) -> None:
        """Close the subscription. A second call does nothing."""
        self._opened.close()

    def _receive(self, payload: bytes, attachment: bytes) -> None:
        """Receive a message and look for a gap before it. A thread of the session calls this."""
        if self._is_latched:
            if gid_in(attachment) not in self._context.latched:  # otherwise it came as an object
                self._take(payload)
            return
        if self._on_gap is not None:
            self._look_for_gap(attachment, self._on_gap)
        self._take(payload)

    def _look_for_gap(self, attachment: bytes, on_gap: Callable[[int], None]) -> None:
        gid, count = gid_in(attachment), count_in(attachment)
        missing = count - self._counts.get(gid, count - 1) - 1
        self._counts[gid] = count
        if missing > 0:
            self._context.receive_queue.push(partial(on_gap, missing))

    def _put_by(self, payload: bytes) -> None:
        """Let the event loop read a message. A thread of the session calls this."""
        if self._unread.put(payload, len(payload)):
            self._context.receive_queue.push(self._read)

    def _read(self) -> None:
        payload = self._unread.take()
        if payload is not None and self._opened.is_open:
            self._hand_over(payload)

    def _hand_over(self, payload: bytes) -> None:
        try:
            message = self._format.decode(payload)
        except InvalidMessage as error:
            about = f"topic {self._topic}: a message cannot be read"
            self._context.log.warn(about, error)
            return
        try:
            self._deliver(message)
        except Exception:
            logger.exception("a subscription of topic %s failed to handle a message", self._topic)

    # called in the thread of the send queue

    def _declare(self) -> Declared:
        session = self._context.session
        if self._is_latched:
            return session.declare_latched_subscriber(
                self._key, self._receive, depth=self._qos.depth
            )
        return session.declare_subscriber(self._key, self._receive)


def _queue_for(endpoint: Endpoint, what: str) -> BoundedQueue[Any]:
    """Make the queue of a topic's end. A full one warns if more is ``what``, unless it may lose."""
    qos, loss = endpoint.qos, ""
    if qos.reliability == "reliable":
        loss = f"topic {endpoint.name}: more is {what}; the oldest messages are dropped"
    is_sensor = not loss and qos.durability == "volatile"
    return BoundedQueue(qos.depth if is_sensor else None, loss)
