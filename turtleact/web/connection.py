"""Serves one client, with a task that reads frames and a task that writes frames.

The reading task never waits for the writing task, because outgoing frames go into a queue. A client
that reads nothing for `PATIENCE` seconds is disconnected. So a slow client does not slow down other
clients.

- A client may subscribe to one topic several times, with different ids. These subscriptions share
  one subscription on the graph, with the smallest ``throttle_rate`` and the newest
  ``compression``.
- ``unsubscribe`` without an id ends all of the client's subscriptions to the topic. ``unadvertise``
  without an id ends all of the client's advertisements of the topic.
- Only clients that have sent ``set_level`` get ``status`` frames, because client libraries fail on
  operations that they do not expect.

Source: ``ROSBRIDGE_PROTOCOL.md`` of rosbridge_suite, version 2, and its ``capabilities/``; ASGI,
"HTTP and WebSocket message format".
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeVar, cast

import anyio
from anyio.abc import TaskGroup
from starlette.websockets import WebSocket, WebSocketDisconnect

from turtleact.errors import TurtleactError
from turtleact.interfaces import Message
from turtleact.names import resolve_name
from turtleact.node.topics import Publisher
from turtleact.transports import QoS
from turtleact.web import operations
from turtleact.web.message_conversion import (
    COMPRESSIONS,
    Compression,
    Frame,
    Rendering,
    read_message,
    reply,
)
from turtleact.web.operations import CallService, Id, Malformed, Operation, parse
from turtleact.web.serving import Serving
from turtleact.web.shared import BridgeState, Feed

__all__ = ["PATIENCE", "TRY_AGAIN_LATER", "ClientQueue", "Connection"]

logger = logging.getLogger("turtleact.web")

T = TypeVar("T")

PATIENCE: Final = 2.0
"""A client that reads nothing for this long (s) is disconnected."""

SLOWEST: Final = 2**16
"""The slowest expected rate of a client (bytes/s).

The time that the previous frame takes at this rate is added to `PATIENCE`."""

MOST_DROPPABLE: Final = 256
"""The maximum number of frames of topics and feedback that wait for a client."""

LONGEST_QUEUE: Final = 1000
"""The maximum of ``queue_size``. Larger values are reduced to the maximum."""

LEVELS: Final = {"none": 0, "error": 1, "warning": 2, "info": 3}

GONE: Final = (OSError, WebSocketDisconnect, RuntimeError)
"""The exceptions raised by sending to a disconnected client.

The exception's class depends on the ASGI server."""

GOING_AWAY: Final = 1001
TRY_AGAIN_LATER: Final = 1013


class Connection:
    """The connection of one client.

    Args:
        shared: The objects that all connections share.
        websocket: The client's WebSocket, not accepted yet.

    Attributes:
        queue: The frames that wait to be sent to the client.
    """

    def __init__(self, shared: BridgeState, websocket: WebSocket) -> None:
        self.queue = ClientQueue(shared.limits.memory)
        self._shared = shared
        self._websocket = websocket
        self._level = 0
        self._serving = Serving(shared.node, self.keep)
        self._readers: dict[str, _Reader] = {}
        self._writers: dict[str, _Writer] = {}
        self._filled = shared.tasks.signal()
        self._calls: dict[int, CallService] = {}
        self._count = 0
        self._last_size = 0
        self._is_closing = False
        self._group: TaskGroup | None = None

    async def run(self) -> None:
        """Serve the client until the connection ends or the bridge is closed."""
        try:
            async with anyio.create_task_group() as group:
                self._group = group
                if await self._accept():
                    group.start_soon(self._write)
                    await self._read()
                # The client has gone, so nobody takes what the writer still has.
                group.cancel_scope.cancel()
        finally:
            # Goals first: they must not be told to a client that is gone. They go on, and so may
            # outlive the connection by hours.
            self._group = None
            self._shared.goals.lose(self)
            with anyio.CancelScope(shield=True):
                await self._close_all()

    def close(self) -> None:
        """Start to close the connection.

        The client still gets the frames that must arrive, and then a close frame.
        """
        # From here on nothing that may be dropped is taken (`put`), so the writer comes to an end
        # as soon as it has sent what must arrive, and then sends the close frame.
        self._is_closing = True
        for said in self._calls.values():
            # A page that waits for news gets the last news, such as the results of goals that ended
            # a moment ago.
            news = self._shared.watch.last_news(said.service, said.args)
            values = "the server is closing" if news is None else news
            self.keep(_response(said, values, is_result=news is not None))
        self._calls.clear()
        self.queue.drop_all()
        self._filled.fire()

    def keep(self, frame: str) -> None:
        """Queue a frame that must not be dropped."""
        self.queue.keep(frame)
        if self.queue.is_overfull:
            self.let_go("too much data waits for it")
        self._filled.fire()

    def put(self, source: str, frame: Frame) -> None:
        """Queue a frame that may be dropped if the client reads too slowly."""
        if self._is_closing:
            return
        self.queue.put(source, frame)
        self._filled.fire()

    def let_go(self, reason: str) -> None:
        """Disconnect the client at once.

        No close frame is sent, because the client would not read it.
        """
        if self._group is None or self._group.cancel_scope.cancel_called:
            return
        logger.warning(
            "a web client was disconnected: %s (%d frames dropped before)",
            reason,
            self.queue.dropped,
        )
        # Cancelling the writer does not help where its bytes wait in the transport: only the server
        # around the app can cut the connection, if it offers that.
        abort = self._websocket.scope.get("extensions", {}).get("turtleact.abort")
        if abort is not None:
            abort()
        self._group.cancel_scope.cancel()

    async def _accept(self) -> bool:
        """Accept the connection. Return False if the client is already gone."""
        try:
            await self._websocket.accept()
        except GONE:
            return False
        return True

    # writing

    async def _write(self) -> None:
        while True:
            frame = self.queue.take()
            if frame is not None:
                await self._send(frame)
            elif self._is_closing:
                break
            else:
                await self._filled.wait()
        with anyio.move_on_after(PATIENCE), suppress(*GONE):
            await self._websocket.close(GOING_AWAY, "the server is closing")
        self._end()

    async def _send(self, frame: Frame) -> None:
        """Send a frame. If the client is gone or reads nothing for too long, end the connection."""
        # Servers take a frame while the previous one is still being sent. So this mostly waits for
        # the previous frame, whose size tells how long that may take.
        with anyio.move_on_after(PATIENCE + self._last_size / SLOWEST) as scope:
            try:
                if isinstance(frame, str):
                    await self._websocket.send_text(frame)
                else:
                    await self._websocket.send_bytes(frame)
            except GONE:
                self._end()
        self._last_size = len(frame)
        if scope.cancelled_caught:
            self.let_go(f"it read nothing for {PATIENCE:g} s")

    def _end(self) -> None:
        cast("TaskGroup", self._group).cancel_scope.cancel()

    # reading

    async def _read(self) -> None:
        while True:
            said = await self._websocket.receive()
            if said["type"] == "websocket.disconnect":
                return
            text = said.get("text")
            await self._take(said["bytes"] if text is None else text)
            # A client that never stops sending would otherwise keep the event loop to itself.
            await self._shared.tasks.checkpoint()

    async def _take(self, frame: Frame) -> None:
        """Carry out a frame. Report a failure to a client that asked for ``status`` frames."""
        if len(frame) > self._shared.limits.message_size:
            self._complain("too long a message")
            return
        said = parse(frame)
        if isinstance(said, Malformed):
            self._complain(f"not understood: {said.problem}", said.id)
            return
        try:
            await self._perform(said)
        except TurtleactError as error:
            self._complain(str(error), said.id)

    def _complain(self, problem: str, id: Id = None, *, level: str = "error") -> None:
        if self._level >= LEVELS[level]:
            self.keep(reply("status", id, level=level, msg=problem))

    async def _perform(self, said: Operation) -> None:
        match said:
            case operations.Subscribe():
                self._subscribe(said)
            case operations.Unsubscribe():
                await self._unsubscribe(said)
            case operations.Advertise():
                self._advertise(said)
            case operations.Unadvertise():
                await self._unadvertise(said)
            case operations.Publish():
                await self._publish(said)
            case operations.CallService():
                self._call(said)
            case operations.AdvertiseService():
                self._serve("service", said.service, said)
            case operations.AdvertiseAction():
                self._serve("action", said.action, said)
            case operations.UnadvertiseService():
                self._withdraw("service", said.service)
            case operations.UnadvertiseAction():
                self._withdraw("action", said.action)
            case operations.ServiceResponse() | operations.ActionResult():
                if not self._serving.answer(said):
                    problem = f"no request has the id '{said.id}'"
                    self._complain(problem, said.id, level="warning")
            case operations.ActionFeedback():
                await self._serving.take_feedback(said)
            case operations.SendActionGoal():
                self._shared.goals.send(said, self)
            case operations.CancelActionGoal():
                problem = self._shared.goals.cancel(said, self)
                if problem:
                    self._complain(problem, said.id, level="warning")
            case operations.SetLevel():
                self._set_level(said)

    def _set_level(self, said: operations.SetLevel) -> None:
        level = LEVELS.get(said.level or "none")
        if level is None:
            # Otherwise the client would not hear of its mistake: it may not have asked for errors
            # yet.
            self._level = max(self._level, LEVELS["error"])
            raise TurtleactError(f"no level '{said.level}': say {', '.join(LEVELS)}")
        self._level = level

    def _check_room(self) -> None:
        """Check that the client may open one more subscription or advertisement.

        Raises:
            TurtleactError: if it has reached its limit.
        """
        opened = sum(len(each.wishes) for each in self._readers.values())
        opened += sum(len(each.ids) for each in self._writers.values()) + len(self._serving)
        if opened >= self._shared.limits.opened:
            raise TurtleactError(
                f"{opened} subscriptions and advertisements are open: close some first"
            )

    # topics

    def _subscribe(self, said: operations.Subscribe) -> None:
        compression = said.compression or "none"
        if compression not in COMPRESSIONS:
            raise TurtleactError(f"no compression '{compression}': say {', '.join(COMPRESSIONS)}")
        reader = self._readers.get(said.topic)
        if reader is None or said.id not in reader.wishes:
            self._check_room()
        if reader is None:
            topic = resolve_name(said.topic)
            message_type = self._shared.directory.topic_class(topic, said.type or "")
            reader = _Reader(said.topic, self.put)
            reader.feed = self._shared.feeds.join(topic, message_type, reader.deliver)
            self._readers[said.topic] = reader
        reader.wishes.pop(said.id, None)  # the newest stands last
        reader.wishes[said.id] = (max(said.throttle_rate or 0, 0) / 1000, compression)

    async def _unsubscribe(self, said: operations.Unsubscribe) -> None:
        reader = self._readers.get(said.topic)
        if reader is None or not _remove(reader.wishes, said.id):
            self._complain(f"'{said.topic}' has no such subscription", said.id, level="warning")
        elif not reader.wishes:
            await self._close_reader(said.topic)

    async def _close_reader(self, topic: str) -> None:
        reader = self._readers.pop(topic)
        await self._shared.feeds.leave(reader.feed, reader.deliver)
        self.queue.forget(topic)

    def _advertise(self, said: operations.Advertise) -> _Writer:
        writer = self._writers.get(said.topic)
        if writer is None or said.id not in writer.ids:
            self._check_room()
        if writer is None:
            topic = resolve_name(said.topic)
            message_type = self._shared.directory.topic_class(topic, said.type)
            depth = int(min(max(said.queue_size or 1, 1), LONGEST_QUEUE))
            qos = QoS(depth=depth, durability="transient_local" if said.latch else "volatile")
            publisher = self._shared.node.publisher(message_type, topic, qos)
            writer = self._writers[said.topic] = _Writer(message_type, publisher)
        writer.ids[said.id] = None
        return writer

    async def _unadvertise(self, said: operations.Unadvertise) -> None:
        writer = self._writers.get(said.topic)
        if writer is None or not _remove(writer.ids, said.id):
            self._complain(f"'{said.topic}' has no such advertisement", said.id, level="warning")
        elif not writer.ids:
            await self._writers.pop(said.topic).publisher.aclose()

    async def _publish(self, said: operations.Publish) -> None:
        """Publish a message. If the topic is not advertised yet, advertise it without an id."""
        writer = self._writers.get(said.topic)
        if writer is None:
            writer = self._advertise(
                operations.Advertise(topic=said.topic, type=said.type or "", latch=said.latch)
            )
        writer.publisher.publish(await read_message(writer.message_type, said.msg, root="msg"))

    # services and actions

    def _serve(
        self,
        kind: str,
        name: str,
        said: operations.AdvertiseService | operations.AdvertiseAction,
    ) -> None:
        if (kind, name) in self._serving:
            # A client that has reloaded its page advertises again, perhaps with another type.
            self._withdraw(kind, name)
        self._check_room()
        self._serving.serve(said)

    def _withdraw(self, kind: str, name: str) -> None:
        if (kind, name) not in self._serving:
            self._complain(f"{kind} '{name}' is not advertised", level="warning")
        else:
            # Its goals wait for what the client says next, which is read meanwhile.
            server = self._serving.withdraw(kind, name)
            cast("TaskGroup", self._group).start_soon(server.aclose)

    async def _close_all(self) -> None:
        for topic in list(self._readers):
            await self._close_reader(topic)
        for writer in self._writers.values():
            await writer.publisher.aclose()
        await self._serving.aclose()

    def _call(self, said: CallService) -> None:
        if len(self._calls) >= self._shared.limits.calls:
            problem = f"{len(self._calls)} calls are under way: wait for some"
            self.keep(_response(said, problem, is_result=False))
        else:
            self._count += 1
            self._calls[self._count] = said
            cast("TaskGroup", self._group).start_soon(self._answer, self._count, said)

    async def _answer(self, number: int, said: CallService) -> None:
        """Call a service and send its response, unless `close` has already answered the client."""
        try:
            frame = _response(said, await self._shared.call(said), is_result=True)
        except TurtleactError as error:
            frame = _response(said, str(error), is_result=False)
        # `close` has already answered, and emptied the table, if the server is going.
        if self._calls.pop(number, None) is not None:
            self.keep(frame)


class ClientQueue:
    """The frames that wait for one client.

    The frames wait in one queue, in the order of their arrival, so a client never sees a result
    before feedback that came earlier. If the queue is full, the oldest frame of a topic or of
    feedback is dropped and counted. Responses, results and goals are never dropped: if only those
    are left, the client must be disconnected (`is_overfull`).

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


class _Writer:
    """A topic that the client publishes to, with the ids under which it has advertised it."""

    def __init__(self, message_type: type[Message], publisher: Publisher[Message]) -> None:
        self.message_type = message_type
        self.publisher = publisher
        self.ids: dict[Id, None] = {}


class _Reader:
    """A topic that the client reads. Messages that come too soon after the last one are dropped.

    Args:
        topic: The topic's name as the client spells it.
        put: Queues a frame for the client.

    Attributes:
        wishes: The minimum time between two messages (s) and the compression, by the id of each of
            the client's subscriptions, from old to new.
        feed: The topic's subscription.
    """

    feed: Feed

    def __init__(self, topic: str, put: Callable[[str, Frame], None]) -> None:
        self.wishes: dict[Id, tuple[float, Compression]] = {}
        self._topic = topic
        self._put = put
        self._last = -math.inf

    def deliver(self, message: Rendering) -> None:
        """Queue a message for the client, unless it comes too soon."""
        now = anyio.current_time()
        wishes = list(self.wishes.values())
        if now >= self._last + min(interval for interval, _ in wishes):
            self._last = now
            _, compression = wishes[-1]
            self._put(self._topic, message.frame(compression, self._topic))


def _remove(ids: dict[Id, T], id: Id) -> bool:
    """Remove an id, or all ids if it is None. Return whether there was any."""
    is_there = id is None or id in ids
    for each in [id] if id is not None else list(ids):
        ids.pop(each, None)
    return is_there


def _response(said: CallService, values: object, *, is_result: bool) -> str:
    members = {"service": said.service, "values": values, "result": is_result}
    return reply("service_response", said.id, **members)
