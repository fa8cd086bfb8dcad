"""Both ends of a service, with objects inside the process and Zenoh queries between processes.

A request carries its client's gid and a sequence number. It is handled in its own task, unless the
handler can answer without one. Every request is answered, either with the response or with the
handler's exception. turtleact's clients raise that exception again. If nobody serves a key or the
server dies, Zenoh ends the query without a reason. The client then finds the reason in the graph.

Source: rmw_zenoh_cpp ``rmw_service_data.cpp``, ``rmw_client_data.cpp``.
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
    ServiceTimeout,
    TurtleactError,
)
from turtleact.summaries import loggable, shortened, summary
from turtleact.tasks import GRACE
from turtleact.transports.base import (
    REQUEST_NOTE,
    AsyncHandler,
    Caller,
    CallObserver,
    Closeable,
    Endpoint,
    Format,
    PendingCall,
    Reply,
    SyncHandler,
    Target,
    ThreadedHandler,
    observer_of,
    why_not_served,
)
from turtleact.transports.rmw_zenoh.attachment import (
    GID_SIZE,
    LAYOUT,
    gid_in,
    note_in,
    note_tail,
    read_attachment,
)
from turtleact.transports.rmw_zenoh.config import PATIENCE
from turtleact.transports.rmw_zenoh.context import Context, Counter, Named, Presence

if TYPE_CHECKING:
    from turtleact.tasks import Signal
    from turtleact.transports.rmw_zenoh.session import Declared, Querier, Query

__all__ = ["WireCall", "WireCaller", "WireService", "error_said", "said"]

logger = logging.getLogger("turtleact.services")

#: How long a call continues after its server has gone (s).
LOST = 0.25


class WireService:
    """The server end of a service.

    Args:
        context: The transport's context.
        named: The endpoint.
        format: Decodes requests and encodes responses.
        is_for_others: Whether the handlers also answer other processes.

    Attributes:
        context: The argument ``context``.
        name: The name of the service.
        format: The argument ``format``.
        under_way: The requests that have not been answered, by gid and sequence number.
        is_open: Whether it accepts requests and more handlers.
    """

    def __init__(
        self, context: Context, named: Named, format: Format, *, is_for_others: bool
    ) -> None:
        self.context = context
        self.name = named.endpoint.name
        self.format = format
        self.under_way: dict[tuple[bytes, int], _Request] = {}
        self._named = named
        self._offers: tuple[_Offer, ...] = ()  # replaced, since threads of the session read it
        self._is_threaded = False  # whether the first of them is
        self._declared: Declared | None = None
        self.is_open = True
        declare = self._declare if is_for_others else None
        self.presence = Presence(
            context, named.token, declare, self._undeclare, on_demand=named.on_demand
        )
        context.opened.add(self)

    def add(self, handler: object) -> Closeable:
        """Add a handler. Requests from other processes go to the first handler.

        Returns:
            The object that removes the handler. The service exists until its last handler is
            removed.
        """
        near = self.context.near.serve(self._named.endpoint, self.format, handler)
        offer = _Offer(self, near, handler)
        self._set_offers((*self._offers, offer))
        return offer

    def remove(self, offer: _Offer) -> None:
        """Remove a handler. A second call does nothing."""
        if offer in self._offers:
            self._set_offers(tuple(each for each in self._offers if each is not offer))
            if not self._offers:
                self.close()

    def _set_offers(self, offers: tuple[_Offer, ...]) -> None:
        self._offers = offers
        self._is_threaded = bool(offers) and offers[0].is_threaded

    def close(self) -> None:
        """Accept no more requests. Requests under way continue. A second call does nothing."""
        if not self.is_open:
            return
        self.is_open = False
        for offer in self._offers:
            offer.close()
        self.presence.close()
        self.leave_if_idle()

    def leave_if_idle(self) -> None:
        """If the service is closed and no request is under way, leave the list of open services."""
        if not (self.is_open or self.under_way):
            self.context.opened.discard(self)

    def give_up(self) -> None:
        """Answer the requests under way with an error, because the transport is closing."""
        for request in tuple(self.under_way.values()):
            request.refuse(self.closed())

    def closed(self) -> ServerUnavailable:
        """The error for requests that the server does not answer because it was closed."""
        return ServerUnavailable(self.name, "the server was closed", kind="service")

    def fail(self, query: Query, error: TurtleactError) -> None:
        """Send an error."""
        kind, text = said(error)
        self.context.outbox.post(lambda: query.fail(text, kind))

    def _take(self, query: Query) -> None:
        """Receive a query; a thread of the session calls this."""
        if self._is_threaded and self.context.is_open:
            self._begin(query)
        else:
            self.context.inbox.push(partial(self._begin, query))

    def _begin(self, query: Query) -> None:
        try:
            beside = read_attachment(query.attachment)
            key = beside.gid, beside.sequence
            if key in self.under_way:
                raise InvalidMessage("attachment", f"request {beside.sequence} is under way")
            message = self.format.decode(query.payload)
        except InvalidMessage as error:
            about = f"service {self.name}: a request cannot be read"
            complain = partial(self.context.complaints.warn, about, gid_in(query.attachment), error)
            self.context.inbox.push(complain)  # this may be another thread
            self.fail(query, error)
            return
        offers = self._offers
        if not offers or not self.context.is_open:
            self.fail(query, self.closed())
            return
        offer = offers[0]
        request = self.under_way[key] = _Request(self, offer, query, key)
        if offer.observer is not None:
            offer.observer.requested(query.payload, *key)
        if beside.note:  # the handler's task inherits it from this context
            context = copy_context()
            context.run(REQUEST_NOTE.set, beside.note)
            context.run(request.handle, message)
        else:
            request.handle(message)

    # called in the outbox

    def _declare(self) -> None:
        self._declared = self.context.session.declare_queryable(self._named.key, self._take)

    def _undeclare(self) -> None:
        if self._declared is not None:
            self._declared.undeclare()


class _Request(msgspec.Struct, eq=False):
    """A request from another process that is under way; answered once."""

    service: WireService
    offer: _Offer
    query: Query
    key: tuple[bytes, int]  # its client's gid and its sequence number

    def handle(self, message: object) -> None:
        """Have the request answered: without a task, now or later, if the handler can do that."""
        if not self._answer_nowait(message):
            service = self.service
            service.context.crew.run(self._answer(message), f"a request to {service.name}")

    def respond(self, reply: Reply | TurtleactError) -> None:
        """Answer the request, unless it was answered, as when the transport closes; never raises.

        A threaded handler may call this in any thread.
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
        # The same as `write_attachment`, inlined because this runs for each reply.
        attachment = LAYOUT.pack(sequence, time_ns(), GID_SIZE, gid) + note_tail(reply.note)
        service.context.outbox.post(partial(self.query.reply, payload, attachment))
        if self.offer.observer is not None:
            self.offer.observer.responded(payload, gid, sequence)
        if not service.is_open:
            service.leave_if_idle()

    def refuse(self, error: TurtleactError) -> None:
        """Answer the request with an error, unless it was answered."""
        service = self.service
        if service.under_way.pop(self.key, None) is not None:
            service.fail(self.query, error)
            service.leave_if_idle()

    def _answer_nowait(self, message: object) -> bool:
        """Let the handler answer without a task, now or later; return False if it needs one."""
        sync = self.offer.sync
        try:
            return sync is not None and sync.reply_nowait(message, self.key[0], self.respond)
        except Exception as error:
            self.refuse(self._failure(error))
            return True

    async def _answer(self, message: object) -> None:
        """Answer the request. This raises only cancellations."""
        service, handler = self.service, self.offer.handler
        try:
            assert handler is not None  # noqa: S101  # otherwise it would not be chosen
            self.respond(await handler.reply(message, self.key[0]))
        except Exception as error:
            self.refuse(self._failure(error))
        finally:
            # The user's code may cancel this task, as it may cancel any task of the loop. Some
            # requests can still be answered without it, such as that for the result of a goal.
            is_cut_off = service.context.is_open and self.key in service.under_way
            if not (is_cut_off and self._answer_nowait(message)):
                self.refuse(service.closed())  # does nothing if the request was answered

    def _failure(self, error: Exception) -> TurtleactError:
        """Turn a handler's exception into the error that its client gets."""
        name = self.service.name
        if isinstance(error, TurtleactError):
            return error
        logger.error("the handler of service %s failed", name, exc_info=loggable(error))
        return ServiceError(name, f"the handler failed: {summary(error)}")


class _Offer:
    """A handler of a service, and its registration inside the process."""

    __slots__ = ("_near", "_service", "handler", "is_threaded", "observer", "sync")

    def __init__(self, service: WireService, near: Closeable, handler: object) -> None:
        self.handler = handler if isinstance(handler, AsyncHandler) else None
        self.sync = handler if isinstance(handler, SyncHandler) else None
        self.is_threaded = isinstance(handler, ThreadedHandler)
        self.observer = observer_of(handler)
        self._service = service
        self._near = near

    def close(self) -> None:
        self._near.close()
        self._service.remove(self)


class WireCaller:
    """The client end of a service.

    Args:
        context: The transport's context.
        named: The endpoint.
        format: Encodes requests and decodes responses.
        target: Which servers to ask, and which of their replies count.
        find: Returns the servers with the same name in other processes.

    Attributes:
        is_matching: Whether Zenoh knows of a server in another process.
        querier: The declared querier; None before it is declared and after it was undeclared.
        presence: The client as other processes see it.
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
        self._counter = Counter(endpoint.gid)
        self._is_open = True
        self._has_left = False
        self.is_matching = False
        self.querier: Querier | None = None
        self._calls: set[WireCall] = set()
        self._near: Caller = context.near.join(endpoint, format)
        self.presence = Presence(context, named.token, self._declare, self._undeclare)
        context.opened.add(self)

    @property
    def observer(self) -> CallObserver | None:
        """The observer of the calls to servers in this process and in others."""
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
            raise self._unavailable(self.why_not_served())
        return await self._send(payload, note, is_cancelable=True).reply()

    def ask(
        self,
        request: object,
        on_end: Callable[[PendingCall], object] | None = None,
        note: str = "",
    ) -> PendingCall | None:
        """Send a request to another process now; None if that is not possible at once."""
        can_send = self.is_matching and self._context.is_open and self._is_open
        if not can_send or self._near.is_served:
            return None
        payload = self._format.encode(request)
        ends = None if on_end is None else [on_end]
        return self._send(payload, note, is_cancelable=False, on_end=ends)

    def close(self) -> None:
        """Leave the graph when the calls under way are over. A second call does nothing.

        The calls under way continue. Other processes are told only when these are over, because a
        server may cancel the requests of a client that has gone.
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
        """Handle the loss of a server. For a moment, another server may still answer the calls."""
        if server != self._endpoint.name:
            return
        for call in self._calls.copy():  # since finished calls remove themselves
            self._context.crew.run(call.end_soon(), f"a call of {self._endpoint.name}")

    async def wait_for_route(self) -> None:
        """Wait at most `GRACE` seconds until a server with a known token can be reached."""
        if self.is_matching:
            return
        with anyio.move_on_after(GRACE):
            while not self.is_matching and any(map(self._fits, self._servers())):
                await self._context.near.wait_for_change()

    def _send(
        self,
        payload: bytes,
        note: str,
        *,
        is_cancelable: bool,
        on_end: list[Callable[[PendingCall], object]] | None = None,
    ) -> WireCall:
        attachment = self._counter.next()
        if note:
            attachment += note_tail(note)
        call = WireCall(self._context, payload, attachment, self, is_cancelable, on_end)
        self._calls.add(call)
        if self._observer is not None:  # before sending: another thread may tell of the response
            self._observer.requested(payload, self._endpoint.gid, call.sequence)
        self._context.outbox.post(call.send)
        return call

    def forget(self, call: WireCall) -> None:
        """Forget a call that nobody waits for any more."""
        self._calls.discard(call)
        self._leave_if_idle()

    def _leave_if_idle(self) -> None:
        if not self._is_open and not self._calls and not self._has_left:
            self._has_left = True
            self._context.opened.discard(self)  # until now, its calls must hear of lost servers
            self.presence.close()

    def finish(self, call: WireCall) -> Reply:
        """Return the reply of a call that is over, or raise its error."""
        self._calls.discard(call)
        if not self._is_open:
            self._leave_if_idle()
        if call.error is not None:
            raise error_said(self._endpoint.name, *call.error)
        if call.answer is None:
            raise self._unavailable(self._why_no_answer(), self._why_otherwise())
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

    def _why_no_answer(self) -> str:
        if not self._context.is_open:
            return "the Zenoh transport was closed before there was an answer"
        return "the server went away before there was an answer"

    def _why_otherwise(self) -> str:
        """Return another possible reason, if a server that has the request may still exist."""
        if self._context.is_open and any(map(self._fits, self._servers())):
            return "dropped the request: ROS 2 keeps 10 that wait"
        return ""

    def _unavailable(self, problem: str, otherwise: str = "") -> ServerUnavailable:
        name = self._endpoint.name
        return ServerUnavailable(name, problem, kind="service", otherwise=otherwise)

    def _matching(self, is_matching: bool) -> None:
        """Receive Zenoh's news about servers. A thread of the session calls this."""
        self._context.inbox.push(lambda: self._servers_changed(is_matching))

    def _servers_changed(self, is_matching: bool) -> None:
        self.is_matching = is_matching
        if not is_matching:
            self.doubt(self._endpoint.name)
        self._context.near.tell_change()

    # called in the outbox

    def _declare(self) -> None:
        is_for_all = self._target.servers == "all"
        session = self._context.session
        self.querier = session.declare_querier(self._key, self._matching, is_for_all=is_for_all)

    def _undeclare(self) -> None:
        if self.querier is not None:
            self.querier.undeclare()
            self.querier = None


class WireCall(msgspec.Struct, eq=False):
    """One request and its outcome.

    Attributes:
        context: The transport's context.
        payload: The encoded request.
        attachment: The request's attachment.
        caller: The client that makes the call.
        is_cancelable: Whether dropping the call frees it at once, or only closing its client does.
        on_end: Holds the function to call, in any thread, when the call is over. It is removed
            before it is called, because two threads may notice the end at the same moment. Most
            calls have none.
        answer: The payload and attachment of the reply.
        error: The text and the kind of an error.
        is_over: Whether a reply or error has arrived, or nothing will ever arrive.
        is_observed: Whether an observer has been told of the response.
    """

    context: Context
    payload: bytes
    attachment: bytes
    caller: WireCaller
    is_cancelable: bool
    on_end: list[Callable[[PendingCall], object]] | None = None
    answer: tuple[bytes, bytes] | None = None
    error: tuple[str, str] | None = None
    is_over: bool = False
    is_observed: bool = False
    _is_wanted: bool = True
    _changed: Signal | None = None  # created when somebody waits
    _told: Callable[[], object] | None = None
    _give_up: Callable[[], None] | None = None

    @property
    def sequence(self) -> int:
        """The sequence number of the request."""
        return read_attachment(self.attachment).sequence

    @property
    def stamp(self) -> int | None:
        """When the reply was sent (ns since the epoch); None before that, or if unknown."""
        try:
            return None if self.answer is None else read_attachment(self.answer[1]).stamp
        except InvalidMessage:
            return None

    def tell(self, told: Callable[[], object]) -> None:
        """Call ``told`` when the call is over; see `turtleact.transports.base.PendingCall`."""
        self._told = told

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
        """Give up the reply. A second call does nothing."""
        if self._is_wanted:
            self._is_wanted = False
            if self.is_cancelable and not self.is_over:
                self.context.outbox.post(self._cancel)
            self.caller.forget(self)

    async def end_soon(self) -> None:
        """End the call soon: Zenoh may have lost it with its server and not reported that."""
        with anyio.move_on_after(LOST):
            await self._wait()
        self.end()

    def end(self) -> None:
        """Record that nothing more will arrive."""
        self.is_over = True
        self._tell()

    def _tell(self) -> None:
        if self._changed is not None:
            self._changed.fire()
        if self._told is not None and self._is_wanted:
            self._told()
        if self.on_end is not None:
            self._end_here(self.on_end)

    def _end_here(self, on_end: list[Callable[[PendingCall], object]]) -> bool:
        """Call `on_end` if it is still there; return whether it was."""
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

    # called in the outbox

    def send(self) -> None:
        """Send the request."""
        querier = self.caller.querier
        if querier is None:
            self._ended()
            return
        try:
            self._give_up = querier.get(
                self.payload,
                self.attachment,
                replied=self.replied,
                failed=self._failed,
                ended=self._ended,
                is_cancelable=self.is_cancelable,
            )
        except TurtleactError:
            self._ended()
            raise

    def _cancel(self) -> None:
        if self._give_up is not None:
            self._give_up()

    # called in a thread of the session

    def replied(self, payload: bytes, attachment: bytes) -> None:
        """Receive a reply."""
        if not self.is_over:  # the first reply of several servers wins
            self.answer = payload, attachment
            counts = self.caller.counts
            if counts is not None and not counts(payload):
                return  # another server may send a better reply; otherwise `_ended` comes next
            self.is_over = True
            if self.on_end is None or not self._end_here(self.on_end):
                self.context.inbox.push(self._tell)

    def _failed(self, text: str, kind: str) -> None:
        if not self.is_over:
            self.error = text, kind
            self.is_over = True
            if self.on_end is None or not self._end_here(self.on_end):
                self.context.inbox.push(self._tell)

    def _ended(self) -> None:
        if not self.is_over:  # otherwise the loop already knows
            self.context.inbox.push(self.end)


def said(error: TurtleactError) -> tuple[str, str]:
    """Return the kind of an error, and a text from which `error_said` restores it."""
    if isinstance(error, InvalidMessage):
        return "InvalidMessage", shortened(str(error))
    if isinstance(error, ServerUnavailable):
        return "ServerUnavailable", shortened(error.problem)
    if isinstance(error, ServiceError):
        return "ServiceError", shortened(error.reason)
    return "ServiceError", summary(error)


def error_said(name: str, text: str, kind: str) -> TurtleactError:
    """Restore a server's error.

    An error of another program becomes the text of a `ServiceError`.
    """
    if kind == "InvalidMessage":
        path, _, problem = text.partition(": ")
        return InvalidMessage(path, problem)
    if kind == "Timeout":
        return ServiceTimeout(name, PATIENCE)
    if kind == "ServerUnavailable":
        return ServerUnavailable(name, text, kind="service")
    return ServiceError(name, text)
