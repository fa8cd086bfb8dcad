"""Serves one client, with a task that reads frames and a task that writes frames.

`turtleact.web.protocol` turns each frame of the client into effects, and this module carries them
out on the node. The reading task never waits for the writing task, because outgoing frames go into
a queue. A client that reads nothing for `PATIENCE` seconds is disconnected. So a slow client does
not slow down other clients.

Source: rosbridge v2; ASGI, "HTTP and WebSocket message format".
"""

from __future__ import annotations

import logging
import math
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import Final, cast

import anyio
from anyio.abc import TaskGroup
from starlette.websockets import WebSocket, WebSocketDisconnect

from turtleact.errors import TurtleactError
from turtleact.interfaces import Message
from turtleact.node.topics import Publisher
from turtleact.tasks.failures import summary
from turtleact.transports import QoS
from turtleact.web import operations
from turtleact.web.client_queue import ClientQueue
from turtleact.web.message_conversion import Frame, Rendering, read_message, reply
from turtleact.web.name_lookup import absolute
from turtleact.web.operations import CallService, Id
from turtleact.web.protocol import (
    Adjust,
    Delivery,
    Do,
    Effect,
    Open,
    Protocol,
    Reader,
    Say,
    Shut,
    Writer,
)
from turtleact.web.serving import Serving
from turtleact.web.shared import BridgeState, Feed

__all__ = ["PATIENCE", "TRY_AGAIN_LATER", "Connection"]

logger = logging.getLogger("turtleact.web")

PATIENCE: Final = 2.0
"""A client that reads nothing for this long (s) is disconnected."""

SLOWEST: Final = 2**16
"""The slowest expected rate of a client (bytes/s).

The time that the previous frame takes at this rate is added to `PATIENCE`."""

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
        self._protocol = Protocol(shared.limits.opened)
        self._serving = Serving(shared.node, self.keep)
        self._readers: dict[str, _TopicReader] = {}
        self._writers: dict[str, tuple[type[Message], Publisher[Message]]] = {}
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
            frame = said["bytes"] if text is None else text
            if len(frame) > self._shared.limits.message_size:
                self._say(self._protocol.complain("too long a message"))
            else:
                for effect in self._protocol.receive(frame):
                    await self._perform(effect)
            # A client that never stops sending would otherwise keep the event loop to itself.
            await self._shared.tasks.checkpoint()

    def _say(self, said: list[Effect]) -> None:
        for effect in said:
            self.keep(cast("Say", effect).frame)

    async def _perform(self, effect: Effect) -> None:
        """Carry out an effect. Report a failure to a client that asked for ``status`` frames."""
        match effect:
            case Say(frame):
                self.keep(frame)
            case Open(what):
                await self._attempt(partial(self._open, what), what.id, forget=_place_of(what))
            case Adjust(key, delivery):
                self._readers[key].delivery = delivery
            case Shut(kind, key):
                await self._shut(kind, key)
            case Do(operation):
                await self._attempt(partial(self._do, operation), operation.id)

    async def _attempt(
        self,
        action: Callable[[], Awaitable[None]],
        id: Id,
        *,
        forget: tuple[str, str] | None = None,
    ) -> None:
        try:
            await action()
        except TurtleactError as error:
            # The protocol has noted this as open. A client that tries again must not be told that
            # it is open already.
            if forget is not None:
                self._protocol.forget(*forget)
            self._complain(str(error), id)

    def _complain(self, problem: str, id: Id, *, level: str = "error") -> None:
        self._say(self._protocol.complain(problem, id, level=level))

    # what is opened

    async def _open(
        self, what: Reader | Writer | operations.AdvertiseService | operations.AdvertiseAction
    ) -> None:
        match what:
            case Reader():
                self._subscribe(what)
            case Writer():
                topic = absolute(what.key)
                message_type = self._shared.directory.topic_class(topic, what.type)
                qos = QoS(
                    depth=what.depth,
                    durability="transient_local" if what.is_latched else "volatile",
                )
                publisher = self._shared.node.publisher(message_type, topic, qos)
                self._writers[what.key] = (message_type, publisher)
            case operations.AdvertiseService():
                self._serving.serve_service(what)
            case operations.AdvertiseAction():
                self._serving.serve_action(what)

    def _subscribe(self, what: Reader) -> None:
        topic = absolute(what.key)
        message_type = self._shared.directory.topic_class(topic, what.type)
        reader = _TopicReader(what.key, what.delivery, self.put)
        reader.feed = self._shared.feeds.join(topic, message_type, reader.deliver)
        self._readers[what.key] = reader

    async def _shut(self, kind: str, key: str) -> None:
        if kind == "reader":
            reader = self._readers.pop(key)
            await self._shared.feeds.leave(reader.feed, reader.deliver)
            self.queue.forget(key)
        elif kind == "writer":
            await self._writers.pop(key)[1].aclose()
        else:
            # Its goals wait for what the client says next, which is read meanwhile.
            server = self._serving.withdraw(kind, key)
            cast("TaskGroup", self._group).start_soon(server.aclose)

    async def _close_all(self) -> None:
        for key in list(self._readers):
            await self._shut("reader", key)
        for key in list(self._writers):
            await self._shut("writer", key)
        await self._serving.aclose()

    # what is done

    async def _do(self, operation: object) -> None:
        match operation:
            case operations.Publish():
                writer = self._writers.get(operation.topic)
                if writer is not None:  # else the client was told why not
                    writer[1].publish(await read_message(writer[0], operation.msg, root="msg"))
            case operations.CallService():
                self._call(operation)
            case operations.SendActionGoal():
                self._shared.goals.send(operation, self)
            case operations.CancelActionGoal():
                problem = self._shared.goals.cancel(operation, self)
                if problem:
                    self._complain(problem, operation.id, level="warning")
            case operations.ActionFeedback():
                await self._serving.take_feedback(operation)
            case operations.ServiceResponse() | operations.ActionResult():
                if not self._serving.answer(operation):
                    problem = f"no request has the id '{operation.id}'"
                    self._complain(problem, operation.id, level="warning")

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
        except Exception as error:
            logger.exception("a call of %s for a web client failed", said.service)
            frame = _response(said, summary(error), is_result=False)
        # `close` has already answered, and emptied the table, if the server is going.
        if self._calls.pop(number, None) is not None:
            self.keep(frame)


class _TopicReader:
    """A topic that the client reads. Messages that come too soon after the last one are dropped.

    Args:
        topic: The topic's name as the client spells it.
        delivery: How the client wants to get the messages.
        put: Queues a frame for the client.

    Attributes:
        delivery: How the client wants to get the messages, as passed to the constructor or changed.
        feed: The topic's subscription.
    """

    feed: Feed

    def __init__(self, topic: str, delivery: Delivery, put: Callable[[str, Frame], None]) -> None:
        self.delivery = delivery
        self._topic = topic
        self._put = put
        self._last = -math.inf

    def deliver(self, message: Rendering) -> None:
        """Queue a message for the client, unless it comes too soon."""
        now = anyio.current_time()
        if now >= self._last + self.delivery.interval:
            self._last = now
            self._put(self._topic, message.frame(self.delivery.compression, self._topic))


def _response(said: CallService, values: object, *, is_result: bool) -> str:
    members = {"service": said.service, "values": values, "result": is_result}
    return reply("service_response", said.id, **members)


def _place_of(
    what: Reader | Writer | operations.AdvertiseService | operations.AdvertiseAction,
) -> tuple[str, str]:
    """Return the arguments of `Protocol.forget` for a reader, a writer, a service or an action."""
    match what:
        case Reader():
            return "reader", what.key
        case Writer():
            return "writer", what.key
        case operations.AdvertiseService():
            return "service", what.service
        case operations.AdvertiseAction():
            return "action", what.action
