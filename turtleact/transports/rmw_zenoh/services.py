"""Both ends of a service. Calls inside a process pass objects, and calls between processes bytes.

A call to another process is a Zenoh query. Its request carries the client's gid and a sequence
number. The server handles each request in its own task, unless the handler can answer it without a
task. Every request is answered, either with the response or with an error, such as the handler's
exception, which the call then raises. If there is no server, or if the server dies, Zenoh ends the
query without giving a reason. The client then looks for the reason in the graph.

Source: rmw_zenoh_cpp ``rmw_client_data.cpp`` and ``rmw_service_data.cpp``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextvars import copy_context
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
    Endpoint,
    Format,
    PendingCall,
    Reply,
    ServiceHandler,
    Target,
    why_not_served,
)
from turtleact.transports.rmw_zenoh.context import Context, Declaration, Named
from turtleact.transports.rmw_zenoh.wire import (
    Attachments,
    decode_error,
    encode_error,
    note_in,
    read_attachment,
    write_attachment,
)

if TYPE_CHECKING:
    from turtleact.tasks import Signal
    from turtleact.transports.rmw_zenoh.session import Declared, Querier, Query

__all__ = ["WireCall", "WireCaller", "WireService"]

logger = logging.getLogger("turtleact.services")

#: How long a call continues after its server has gone (s).
LOST = 0.25


class WireCaller:
    """The client end of a service.

    Args:
        context: The transport's context.
        named: The client's endpoint.
        format: Encodes requests and decodes responses.
        target: Selects the servers that get each request, and the reply that the client uses.
        find: Returns the servers of a service in other processes, given the service's name.

    Attributes:
        is_matching: Whether Zenoh knows of a server in another process.
        querier: The declared querier; None before it is declared and after it is undeclared.
        declaration: Declares the client to other processes.
    """

    _observer: CallObserver | None = None

    def __init__(
        self,
        context: Context,
        named: Named,
        format: Format,
        target: Target,
        find: Callable[[str], list[Endpoint]],
    ) -> None:
        self._context = context
        self._key = named.key
        self._endpoint = endpoint = named.endpoint
        self._format = format
        self._target = target
        self.counts = target.counts
        self._find = find
        self._attachments = Attachments(endpoint.gid)
        self._is_open = True
        self._has_left = False
        self.is_matching = False
        self.querier: Querier | None = None
        self._calls: set[WireCall] = set()
        self._near: Caller = context.near.join(endpoint, format)
        self.declaration = Declaration(context, named.token, self._declare, self._undeclare)
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
        if self._near.is_served or not self._is_open:
            return await self._near.call(request, note)
        payload = self._format.encode(request)
        await self.wait_for_route()
        if not self.is_matching or not self._context.is_open:
            name, problem = self._endpoint.name, self.why_not_served()
            raise ServerUnavailable(name, problem, kind="service")
        return await self._send(payload, note).reply()

    def ask(
        self,
        request: object,
        on_end: Callable[[PendingCall], object] | None = None,
        note: str = "",
    ) -> PendingCall | None:
        """Send a request without waiting; see `turtleact.transports.base.Caller`."""
        can_send = self.is_matching and self._context.is_open and self._is_open
        if not can_send or self._near.is_served:
            return None
        payload = self._format.encode(request)
        return self._send(payload, note, None if on_end is None else [on_end])

    def close(self) -> None:
        """Send no more requests, and leave the graph once the calls under way are over.

        The client stays on the graph until then, because a server may cancel the requests of a
        client that has left. Closing the client again does nothing.
        """
        if self._is_open:
            self._is_open = False
            self._near.close()
            self._leave_if_idle()

    def give_up(self) -> None:
        """End all calls under way, because the transport is closing."""
        calls, self._calls = self._calls, set()
        for call in calls:
            call.end()

    def doubt(self, server: str) -> None:
        """If this client calls the service ``server``, end the client's open calls soon.

        The transport calls this method when a server of the service ``server`` has left the graph.
        Each call under way ends after at most `LOST` seconds. Until then, another server may still
        answer the call.
        """
        if server != self._endpoint.name:
            return
        for call in self._calls.copy():  # since finished calls remove themselves
            self._context.crew.run(call.end_soon(), f"a call of {self._endpoint.name}")

    async def wait_for_route(self) -> None:
        """Wait at most `GRACE` seconds until a server that is on the graph can be reached."""
        if self.is_matching:
            return
        with anyio.move_on_after(GRACE):
            while not self.is_matching and any(map(self._fits, self._servers())):
                await self._context.near.wait_for_change()

    def _send(
        self,
        payload: bytes,
        note: str,
        on_end: list[Callable[[PendingCall], object]] | None = None,
    ) -> WireCall:
        attachment = self._attachments.next(note)
        call = WireCall(self._context, payload, attachment, self, on_end)
        self._calls.add(call)
        if self._observer is not None:  # before sending: another thread may tell of the response
            self._observer.requested(payload, self._endpoint.gid, call.sequence)
        self._context.send_queue.post(call.send)
        return call

    def forget(self, call: WireCall) -> None:
        """Forget a call that nobody waits for any more."""
        self._calls.discard(call)
        self._leave_if_idle()

    def _leave_if_idle(self) -> None:
        if not self._is_open and not self._calls and not self._has_left:
            self._has_left = True
            self._context.opened.discard(self)  # until now, its calls must hear of lost servers
            self.declaration.close()

    def finish(self, call: WireCall) -> Reply:
        """Return the reply of a call that is over, or raise the error with which the call ended."""
        self._calls.discard(call)
        if not self._is_open:
            self._leave_if_idle()
        if call.error is not None:
            raise decode_error(self._endpoint.name, *call.error)
        if call.answer is None:
            raise self._lost()
        payload, attachment = call.answer
        try:
            message = self._format.decode(payload)
        except InvalidMessage as error:
            problem = f"its response cannot be read: {error}"
            raise ServiceError(self._endpoint.name, problem) from error
        if self._observer is not None and not call.is_observed:
            call.is_observed = True  # a reply may be taken twice
            self._observer.responded(payload, self._endpoint.gid, call.sequence)
        return Reply(message, note_in(attachment))

    # finding servers

    def _servers(self) -> list[Endpoint]:
        return self._find(self._endpoint.name)

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
        problem = (
            "the server went away" if self._context.is_open else "the Zenoh transport was closed"
        )
        return ServerUnavailable(
            self._endpoint.name,
            problem,
            kind="service",
            when="before there was an answer",
            otherwise=self._why_otherwise(),
        )

    def _why_otherwise(self) -> str:
        """Explain a missing reply if the transport is open and a server exists; else return ""."""
        if self._context.is_open and any(map(self._fits, self._servers())):
            return "dropped the request: ROS 2 keeps 10 that wait"
        return ""

    def _matching(self, is_matching: bool) -> None:
        """Handle the arrival of the first server in another process, or the loss of the last one.

        A thread of the session calls this.
        """
        self._context.receive_queue.push(lambda: self._servers_changed(is_matching))

    def _servers_changed(self, is_matching: bool) -> None:
        self.is_matching = is_matching
        if not is_matching:
            self.doubt(self._endpoint.name)
        self._context.near.tell_change()

    # called in the thread of the send queue

    def _declare(self) -> None:
        is_for_all = self._target.servers == "all"
        session = self._context.session
        self.querier = session.declare_querier(self._key, self._matching, is_for_all=is_for_all)

    def _undeclare(self) -> None:
        if self.querier is not None:
            self.querier.undeclare()
            self.querier = None


class WireCall(msgspec.Struct, eq=False):
    """A request to a server in another process, and the outcome of the request.

    Attributes:
        context: The transport's context.
        payload: The encoded request.
        attachment: The request's attachment.
        caller: The client that makes the call.
        on_end: A list with one function, which is called in any thread when the call is over; None
            if there is no function to call. The function is removed from the list before it is
            called, because two threads may notice the end of the call at the same moment.
        answer: The payload and attachment of the reply.
        error: The text and the kind of the server's error; see `decode_error`.
        is_over: Whether a reply or error has arrived, or none will ever arrive.
        is_observed: Whether the observer has been told of the response.
    """

    context: Context
    payload: bytes
    attachment: bytes
    caller: WireCaller
    on_end: list[Callable[[PendingCall], object]] | None = None
    answer: tuple[bytes, bytes] | None = None
    error: tuple[str, str] | None = None
    is_over: bool = False
    is_observed: bool = False
    _is_wanted: bool = True
    _changed: Signal | None = None  # created when somebody waits

    @property
    def sequence(self) -> int:
        """The sequence number of the request."""
        return read_attachment(self.attachment).sequence

    @property
    def stamp(self) -> int | None:
        """When the reply was sent (ns since the epoch); None without a reply or if not known."""
        try:
            return None if self.answer is None else read_attachment(self.answer[1]).stamp
        except InvalidMessage:
            return None

    def take(self) -> Reply:
        """Return the reply of a call that is over; see `turtleact.transports.base.PendingCall`."""
        self._is_wanted = False
        return self.caller.finish(self)

    async def reply(self) -> Reply:
        """Wait for the reply; see `turtleact.transports.base.PendingCall`."""
        try:
            await self._wait()
        finally:
            self.drop()
        return self.caller.finish(self)

    def drop(self) -> None:
        """Stop waiting for the reply; see `turtleact.transports.base.PendingCall`.

        Zenoh's query goes on until it is answered or times out, or until the client is closed.
        """
        if self._is_wanted:
            self._is_wanted = False
            self.caller.forget(self)

    async def end_soon(self) -> None:
        """Wait at most `LOST` seconds for the reply, then end the call.

        The server may have died during the call, and Zenoh does not always report that.
        """
        with anyio.move_on_after(LOST):
            await self._wait()
        self.end()

    def end(self) -> None:
        """End the call, because no further reply is expected."""
        self.is_over = True
        self._tell()

    def _tell(self) -> None:
        if self._changed is not None:
            self._changed.fire()
        if self.on_end is not None:
            self._end_here(self.on_end)

    def _end_here(self, on_end: list[Callable[[PendingCall], object]]) -> bool:
        """Remove the function from the list ``on_end`` and call the function.

        Return False if the list is empty.
        """
        try:
            end = on_end.pop()
        except IndexError:
            return False
        end(self)
        return True

    async def _wait(self) -> None:
        while not self.is_over:
            if self._changed is None:
                self._changed = self.context.tasks.signal()
            await self._changed.wait()

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
                replied=self.replied,
                failed=self._failed,
                ended=self._ended,
            )
        except TurtleactError:
            self._ended()
            raise

    # called in a thread of the session

    def replied(self, payload: bytes, attachment: bytes) -> None:
        """Handle a reply of a server."""
        if not self.is_over:  # the first reply of several servers wins
            self.answer = payload, attachment
            counts = self.caller.counts
            if counts is not None and not counts(payload):
                return  # another server may send a better reply; otherwise `_ended` comes next
            self.is_over = True
            if self.on_end is None or not self._end_here(self.on_end):
                self.context.receive_queue.push(self._tell)

    def _failed(self, text: str, kind: str) -> None:
        if not self.is_over:
            self.error = text, kind
            self.is_over = True
            if self.on_end is None or not self._end_here(self.on_end):
                self.context.receive_queue.push(self._tell)

    def _ended(self) -> None:
        if not self.is_over:  # otherwise the loop already knows
            self.context.receive_queue.push(self.end)


class WireService:
    """The server end of a service.

    Args:
        context: The transport's context.
        named: The server's endpoint.
        format: Decodes requests and encodes responses.

    Attributes:
        context: The transport's context.
        name: The name of the service.
        format: Decodes requests and encodes responses.
        under_way: The requests that have not been answered, by the client's gid and the sequence
            number.
        is_open: Whether the server is open for requests and for further handlers.
    """

    def __init__(self, context: Context, named: Named, format: Format) -> None:
        self.context = context
        self.name = named.endpoint.name
        self.format = format
        self.under_way: dict[tuple[bytes, int], _Request] = {}
        self._named = named
        self._offers: tuple[_Offer, ...] = ()  # replaced, since threads of the session read it
        self._is_threaded = False  # whether the first of them is
        self._declared: Declared | None = None
        self.is_open = True
        self.declaration = Declaration(
            context, named.token, self._declare, self._undeclare, on_demand=named.on_demand
        )
        context.opened.add(self)

    def add(self, handler: ServiceHandler) -> Closeable:
        """Add a handler. Requests from other processes go to the oldest handler.

        Returns:
            The method returns an object whose ``close`` removes the handler. Removing the last
            handler closes the server.
        """
        near = self.context.near.serve(self._named.endpoint, self.format, handler)
        offer = _Offer(self, near, handler)
        self._set_offers((*self._offers, offer))
        return offer

    def remove(self, offer: _Offer) -> None:
        """Remove a handler. Removing it again does nothing."""
        if offer in self._offers:
            self._set_offers(tuple(each for each in self._offers if each is not offer))
            if not self._offers:
                self.close()

    def _set_offers(self, offers: tuple[_Offer, ...]) -> None:
        self._offers = offers
        self._is_threaded = bool(offers) and offers[0].handler.is_threaded

    def close(self) -> None:
        """Accept no more requests. Requests under way continue. A second call does nothing."""
        if not self.is_open:
            return
        self.is_open = False
        for offer in self._offers:
            offer.close()
        self.declaration.close()
        self.leave_if_idle()

    def leave_if_idle(self) -> None:
        """Remove the server from `Context.opened` if it is closed and no request is under way."""
        if not (self.is_open or self.under_way):
            self.context.opened.discard(self)

    def give_up(self) -> None:
        """Answer the requests under way with an error, because the transport is closing."""
        for request in tuple(self.under_way.values()):
            request.refuse(self.closed())

    def closed(self) -> ServerUnavailable:
        """Return the error with which a closed server answers requests."""
        return ServerUnavailable(self.name, "the server was closed", kind="service")

    def fail(self, query: Query, error: TurtleactError) -> None:
        """Answer a query with an error."""
        text, kind = encode_error(error)
        self.context.send_queue.post(lambda: query.fail(text, kind))

    def _take(self, query: Query) -> None:
        """Handle a query. A thread of the session calls this."""
        if self._is_threaded and self.context.is_open:
            self._begin(query)
        else:
            self.context.receive_queue.push(partial(self._begin, query))

    def _begin(self, query: Query) -> None:
        try:
            beside = read_attachment(query.attachment)
            key = beside.gid, beside.sequence
            if key in self.under_way:
                raise InvalidMessage("attachment", f"request {beside.sequence} is under way")
            message = self.format.decode(query.payload)
        except InvalidMessage as error:
            about = f"service {self.name}: a request cannot be read"
            self.context.log.warn(about, error)
            self.fail(query, error)
            return
        offers = self._offers
        if not offers or not self.context.is_open:
            self.fail(query, self.closed())
            return
        offer = offers[0]
        request = self.under_way[key] = _Request(self, offer, query, key)
        if offer.handler.observer is not None:
            offer.handler.observer.requested(query.payload, *key)
        if beside.note:  # the handler's task inherits it from this context
            context = copy_context()
            context.run(REQUEST_NOTE.set, beside.note)
            context.run(request.handle, message)
        else:
            request.handle(message)

    # called in the thread of the send queue

    def _declare(self) -> None:
        self._declared = self.context.session.declare_queryable(self._named.key, self._take)

    def _undeclare(self) -> None:
        if self._declared is not None:
            self._declared.undeclare()


class _Request(msgspec.Struct, eq=False):
    """A request from another process. It is answered only once."""

    service: WireService
    offer: _Offer
    query: Query
    key: tuple[bytes, int]  # its client's gid and its sequence number

    def handle(self, message: object) -> None:
        """Answer the request, in a new task unless the handler can answer it without one."""
        if not self._answer_nowait(message):
            service = self.service
            service.context.crew.run(self._answer(message), f"a request to {service.name}")

    def respond(self, reply: Reply | TurtleactError) -> None:
        """Answer the request, unless it has already been answered. Never raises.

        When the transport closes, it may answer the request with an error before the handler does.
        A threaded handler may call this method in any thread.
        """
        if isinstance(reply, TurtleactError):
            self.refuse(reply)
            return
        service = self.service
        try:
            payload = service.format.encode(reply.message)
        except Exception as error:
            self.refuse(self._failure(error))
            return
        # Whoever removes the key answers: the handler, its failure or the closing transport, each
        # perhaps in another thread.
        if service.under_way.pop(self.key, None) is None:
            return
        gid, sequence = self.key
        attachment = write_attachment(sequence, time_ns(), gid, reply.note)
        service.context.send_queue.post(partial(self.query.reply, payload, attachment))
        observer = self.offer.handler.observer
        if observer is not None:
            observer.responded(payload, gid, sequence)
        if not service.is_open:
            service.leave_if_idle()

    def refuse(self, error: TurtleactError) -> None:
        """Answer the request with an error, unless it has already been answered."""
        service = self.service
        if service.under_way.pop(self.key, None) is not None:
            service.fail(self.query, error)
            service.leave_if_idle()

    def _answer_nowait(self, message: object) -> bool:
        """Run the handler without a task, and answer. Return False if the handler needs a task."""
        try:
            return self.offer.handler.reply_nowait(message, self.key[0], self.respond)
        except Exception as error:
            self.refuse(self._failure(error))
            return True

    async def _answer(self, message: object) -> None:
        """Let the handler answer the request in this task.

        If the handler raises an exception, the client gets an error. If the task is cancelled, the
        client gets an answer before the cancellation is raised again.
        """
        service, handler = self.service, self.offer.handler
        try:
            self.respond(await handler.reply(message, self.key[0]))
        except Exception as error:
            self.refuse(self._failure(error))
        finally:
            self.refuse(service.closed())  # does nothing if the request was answered

    def _failure(self, error: Exception) -> TurtleactError:
        """Turn a handler's exception into the error that the client gets."""
        name = self.service.name
        if isinstance(error, TurtleactError):
            return error
        logger.error("the handler of service %s failed", name, exc_info=error)
        return ServiceError(name, f"the handler failed: {summary(error)}")


class _Offer:
    """A handler of a service, together with the handler's registration in the local transport."""

    __slots__ = ("_near", "_service", "handler")

    def __init__(self, service: WireService, near: Closeable, handler: ServiceHandler) -> None:
        self.handler = handler
        self._service = service
        self._near = near

    def close(self) -> None:
        self._near.close()
        self._service.remove(self)
