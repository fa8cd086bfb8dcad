"""Both ends of a service. Calls inside a process pass objects, and calls between processes bytes.

A call to another process is a Zenoh query. Its request carries the client's gid and a sequence
number. The server handles each request in its own task. Every request is answered, either with the
response or with an error, such as the handler's exception, which the call then raises. If there is
no server, or if the server dies, Zenoh ends the query without giving a reason. The client then
looks for the reason in the graph.

Source: rmw_zenoh_cpp ``rmw_client_data.cpp`` and ``rmw_service_data.cpp``.
"""

from __future__ import annotations

import logging
from functools import partial
from time import time_ns
from typing import TYPE_CHECKING

import anyio
import msgspec

from turtleact.errors import (
    InvalidMessage,
    ServerUnavailable,
    ServiceError,
    TurtleactError,
    summary,
)
from turtleact.tasks import GRACE
from turtleact.transports.base import (
    REQUEST_NOTE,
    Caller,
    CallObserver,
    Closeable,
    Closing,
    Endpoint,
    Format,
    Reply,
    ServiceHandler,
    Target,
    why_not_served,
)
from turtleact.transports.rmw_zenoh.context import Context, Crew, Declaration, Named
from turtleact.transports.rmw_zenoh.wire import (
    Attachment,
    Attachments,
    count_in,
    decode_error,
    encode_error,
    note_in,
    read_attachment,
    stamp_in,
    write_attachment,
)

if TYPE_CHECKING:
    from turtleact.tasks import Signal
    from turtleact.transports.rmw_zenoh.session import Declared, Querier, Query

__all__ = ["Calls", "WireCaller", "WireService"]

logger = logging.getLogger("turtleact.services")

#: How long a call continues after its server has gone (s).
LOST = 0.25


class Calls:
    """The calls of all clients of a transport that are under way.

    Args:
        crew: Runs the tasks of the transport.
    """

    def __init__(self, crew: Crew) -> None:
        self.under_way: set[_Call] = set()
        self._crew = crew

    def doubt(self, service: str) -> None:
        """End the calls of a service soon, because one of its servers has left the graph.

        Each call ends after at most `LOST` seconds. Until then, another server may still answer it.
        """
        for call in self.under_way:
            if call.caller.name == service:
                self._crew.run(call.end_soon(), f"a call of {service}")

    def end(self) -> None:
        """End all calls, because the transport is closing."""
        for call in self.under_way:
            call.end()


class WireCaller:
    """The client end of a service.

    Args:
        context: The transport's context.
        named: The client's endpoint.
        format: Encodes requests and decodes responses.
        target: Selects the servers that get each request, and the reply that the client uses.
        calls: The calls of all clients that are under way.

    Attributes:
        name: The name of the service.
        counts: See `turtleact.transports.base.Target`.
        is_matching: Whether Zenoh knows of a server in another process.
        querier: The declared querier; None before it is declared.
        declaration: Declares the client to other processes.
    """

    _observer: CallObserver | None = None

    def __init__(
        self,
        context: Context,
        named: Named,
        format: Format,
        target: Target,
        calls: Calls,
    ) -> None:
        self._context = context
        self._key = named.key
        self._endpoint = endpoint = named.endpoint
        self.name = endpoint.name
        self._format = format
        self._target = target
        self.counts = target.counts
        self._calls = calls
        self._attachments = Attachments(endpoint.gid)
        self._is_open = True
        self._under_way = 0  # its own calls
        self.is_matching = False
        self.querier: Querier | None = None
        self._near: Caller = context.near.join(endpoint, format)
        self.declaration = Declaration(context, named.token, self._declare)
        context.opened.add(self)

    @property
    def observer(self) -> CallObserver | None:
        """Watches the calls to servers in this process and in other processes."""
        return self._observer

    @observer.setter
    def observer(self, observer: CallObserver | None) -> None:
        self._observer = self._near.observer = observer

    @property
    def is_served(self) -> bool:
        """Whether a call would reach a server now."""
        return (self.is_matching and self._context.is_open) or self._near.is_served

    async def call(self, request: object, note: str = "") -> Reply:
        """Send a request, and wait for the reply; see `turtleact.transports.base.Caller`."""
        # A server in this process gets the request as an object, and no other server gets it.
        is_here = self._context.near.local(self.name, self._endpoint.type_name)
        if is_here or not self._is_open:
            return await self._near.call(request, note)
        payload = self._format.encode(request)
        if not self.is_matching:
            await self.wait_for_route()
        if not self.is_matching or not self._context.is_open:
            raise ServerUnavailable(self.name, self.why_not_served(), kind="service")
        attachment = self._attachments.next(note)
        call = _Call(self, self._context, payload, attachment, self._context.tasks.signal())
        if self._observer is not None:  # before it is sent, so that no response is told of first
            self._observer.requested(payload, self._endpoint.gid, count_in(attachment))
        self._calls.under_way.add(call)
        self._under_way += 1
        self._context.send_queue.post(call.send)
        try:
            await call.wait()
        finally:
            self._calls.under_way.discard(call)
            self._under_way -= 1
            if not self._is_open:
                self._leave_if_idle()
        return self._reply_of(call)

    def close(self) -> None:
        """Send no more requests, and leave the graph once the calls under way are over.

        The client stays on the graph until then, because a server may cancel the requests of a
        client that has left. Closing the client again does nothing.
        """
        if self._is_open:
            self._is_open = False
            self._near.close()
            self._context.opened.discard(self)
            self._leave_if_idle()

    async def wait_for_route(self) -> None:
        """Wait at most `GRACE` seconds until a server that is on the graph can be reached."""
        with anyio.move_on_after(GRACE):
            while not self.is_matching and any(map(self._fits, self._servers())):
                await self._context.near.wait_for_change()

    def _leave_if_idle(self) -> None:
        if not self._under_way:
            self.declaration.close()

    def _reply_of(self, call: _Call) -> Reply:
        """Return the reply of a call that is over, or raise the error with which the call ended."""
        if call.error is not None:
            raise decode_error(self.name, *call.error)
        if call.answer is None:
            raise self._lost()
        payload, attachment = call.answer
        try:
            message = self._format.decode(payload)
        except InvalidMessage as error:
            problem = f"its response cannot be read: {error}"
            raise ServiceError(self.name, problem) from error
        if self._observer is not None:
            self._observer.responded(payload, self._endpoint.gid, count_in(call.attachment))
        return Reply(message, note_in(attachment), stamp_in(attachment))

    # finding servers

    def _servers(self) -> list[Endpoint]:
        found = self._context.graph.endpoints(self.name)
        return [each for each in found if each.kind == "service"]

    def _fits(self, server: Endpoint) -> bool:
        ours = self._endpoint
        return (server.type_name, server.type_hash) == (ours.type_name, ours.type_hash)

    def why_not_served(self, suffix: str = "") -> str:
        """Explain why a call would reach no server; see `turtleact.transports.base.Caller`."""
        ours, servers = self._endpoint, self._servers()
        if not self._context.is_open:
            return "the Zenoh transport is closed"
        if reachable := [each.node for each in servers if self._fits(each)]:
            return f"node {reachable[0]} serves it, but cannot be reached"
        if not servers:
            return why_not_served(self._context.near.endpoints(ours.name), ours, suffix)
        return why_not_served(servers, ours, suffix)

    def _lost(self) -> ServerUnavailable:
        """Return the error for a request that ended without a reply."""
        problem, otherwise = "the server went away", ""
        if not self._context.is_open:
            problem = "the Zenoh transport was closed"
        elif any(map(self._fits, self._servers())):
            otherwise = "dropped the request: ROS 2 keeps 10 that wait"
        return ServerUnavailable(
            self.name,
            problem,
            kind="service",
            when="before there was an answer",
            otherwise=otherwise,
        )

    def _matching(self, is_matching: bool) -> None:
        """Handle the arrival of the first server in another process, or the loss of the last one.

        A thread of the session calls this.
        """
        self._context.receive_queue.push(lambda: self._servers_changed(is_matching))

    def _servers_changed(self, is_matching: bool) -> None:
        self.is_matching = is_matching
        if not is_matching:
            self._calls.doubt(self.name)
        self._context.near.tell_change()

    # called in the thread of the send queue

    def _declare(self) -> Querier:
        is_for_all = self._target.servers == "all"
        session = self._context.session
        self.querier = session.declare_querier(self._key, self._matching, is_for_all=is_for_all)
        return self.querier


class _Call(msgspec.Struct, eq=False):
    """A request to a server in another process, and the outcome of the request.

    Attributes:
        caller: The client that makes the call.
        context: The transport's context.
        payload: The encoded request.
        attachment: The request's attachment.
        changed: Fires when the call is over.
        answer: The payload and attachment of the reply.
        error: The text and the kind of the server's error; see `decode_error`.
        is_decided: Whether the reply or error that counts has arrived. Zenoh's threads set this.
        is_over: Whether the event loop knows that no further reply is expected.
    """

    caller: WireCaller
    context: Context
    payload: bytes
    attachment: bytes
    changed: Signal
    answer: tuple[bytes, bytes] | None = None
    error: tuple[str, str] | None = None
    is_decided: bool = False
    is_over: bool = False

    async def wait(self) -> None:
        """Wait until the call is over. Cancelling: safe, but Zenoh's query goes on."""
        while not self.is_over:
            await self.changed.wait()

    async def end_soon(self) -> None:
        """Wait at most `LOST` seconds for the reply, then end the call.

        The server may have died during the call, and Zenoh does not always report that.
        """
        with anyio.move_on_after(LOST):
            await self.wait()
        self.end()

    def end(self) -> None:
        """End the call, because no further reply is expected."""
        self.is_decided = self.is_over = True
        self.changed.fire()

    # called in the thread of the send queue

    def send(self) -> None:
        """Send the request."""
        querier = self.caller.querier
        if querier is None:
            self._ended()
            return
        try:
            querier.get(
                self.payload,
                self.attachment,
                replied=self._replied,
                failed=self._failed,
                ended=self._ended,
            )
        except TurtleactError:
            self._ended()
            raise

    # called in a thread of the session
    #
    # Replies of two servers may arrive at the same moment, each in a thread of its own. Then either
    # of them is used, and `end` runs twice, which does no harm. So no lock is needed.

    def _replied(self, payload: bytes, attachment: bytes) -> None:
        if self.is_decided:  # the first reply of several servers wins
            return
        self.answer = payload, attachment
        # If it does not count, another server may send a better one; otherwise `_ended` comes next.
        if self.caller.counts is None or self.caller.counts(payload):
            self._ended()

    def _failed(self, text: str, kind: str) -> None:
        if not self.is_decided:
            self.error = text, kind
            self._ended()

    def _ended(self) -> None:
        if not self.is_decided:  # otherwise the event loop is told already
            self.is_decided = True
            self.context.receive_queue.push(self.end)


class WireService:
    """The server end of a service.

    Args:
        context: The transport's context.
        named: The server's endpoint.
        format: Decodes requests and encodes responses.

    Attributes:
        is_open: Whether the server is open for requests and for further handlers.
        declaration: Declares the server to other processes.
    """

    def __init__(self, context: Context, named: Named, format: Format) -> None:
        self._context = context
        self._name = named.endpoint.name
        self._format = format
        self._named = named
        self._offers: list[tuple[ServiceHandler, Closeable]] = []
        self.is_open = True
        self.declaration = Declaration(
            context, named.token, self._declare, on_demand=named.on_demand
        )
        context.opened.add(self)

    def add(self, handler: ServiceHandler) -> Closeable:
        """Add a handler. Requests from other processes go to the oldest handler.

        Returns:
            The method returns an object whose ``close`` removes the handler. Removing the last
            handler closes the server.
        """
        near = self._context.near.serve(self._named.endpoint, self._format, handler)
        offer = handler, near
        self._offers.append(offer)
        return Closing(partial(self._remove, offer))

    def _remove(self, offer: tuple[ServiceHandler, Closeable]) -> None:
        if offer in self._offers:
            self._offers.remove(offer)
            offer[1].close()
            if not self._offers:
                self.close()

    def close(self) -> None:
        """Accept no more requests. Requests under way continue. A second call does nothing."""
        if not self.is_open:
            return
        self.is_open = False
        for offer in self._offers.copy():
            self._remove(offer)
        self.declaration.close()
        self._context.opened.discard(self)

    def _begin(self, query: Query) -> None:
        try:
            beside = read_attachment(query.attachment)
            message = self._format.decode(query.payload)
        except InvalidMessage as error:
            about = f"service {self._name}: a request cannot be read"
            self._context.log.warn(about, error)
            self._fail(query, error)
            return
        if not self._offers or not self._context.is_open:
            self._fail(query, self._closed())
            return
        handler, _ = self._offers[0]
        if handler.observer is not None:
            handler.observer.requested(query.payload, beside.gid, beside.sequence)
        answering = self._answer(handler, message, query, beside)
        self._context.crew.run(answering, f"a request to {self._name}")

    async def _answer(
        self, handler: ServiceHandler, message: object, query: Query, beside: Attachment
    ) -> None:
        """Let a handler answer a request in this task.

        If the handler raises an exception, the client gets an error. If the task is cancelled, the
        client gets an answer before the cancellation is raised again.
        """
        REQUEST_NOTE.set(beside.note)
        try:
            reply = await handler.reply(message, beside.gid)
            payload = self._format.encode(reply.message)
        except TurtleactError as error:
            self._fail(query, error)
        except Exception as error:
            logger.exception("the handler of service %s failed", self._name)
            self._fail(query, ServiceError(self._name, f"the handler failed: {summary(error)}"))
        except BaseException:  # the transport closes: the client must not wait for an answer
            self._fail(query, self._closed())
            raise
        else:
            attachment = write_attachment(beside.sequence, time_ns(), beside.gid, reply.note)
            self._context.send_queue.post(partial(query.reply, payload, attachment))
            if handler.observer is not None:
                handler.observer.responded(payload, beside.gid, beside.sequence)

    def _fail(self, query: Query, error: TurtleactError) -> None:
        """Answer a query with an error."""
        text, kind = encode_error(error)
        self._context.send_queue.post(lambda: query.fail(text, kind))

    def _closed(self) -> ServerUnavailable:
        return ServerUnavailable(self._name, "the server was closed", kind="service")

    # called in the thread of the send queue

    def _declare(self) -> Declared:
        push = self._context.receive_queue.push
        return self._context.session.declare_queryable(
            self._named.key, lambda query: push(partial(self._begin, query))
        )
