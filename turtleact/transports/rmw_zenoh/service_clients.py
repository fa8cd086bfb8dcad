"""The client end of a service: calls to servers in this process and in others.

A call to a server in this process passes objects. A call to another process is a Zenoh query. If
the server answers with an error, the call raises this error. If there is no server, or if the
server dies, Zenoh ends the query without giving a reason. The client then looks for the reason in
the graph.

Source: rmw_zenoh_cpp ``rmw_client_data.cpp``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import anyio
import msgspec

from turtleact.errors import InvalidMessage, ServerUnavailable, ServiceError, TurtleactError
from turtleact.tasks import GRACE
from turtleact.transports.base import (
    Caller,
    CallObserver,
    Endpoint,
    Format,
    PendingCall,
    Reply,
    Target,
    why_not_served,
)
from turtleact.transports.rmw_zenoh.context import Context, Declaration, Named
from turtleact.transports.rmw_zenoh.wire import (
    Attachments,
    decode_error,
    note_in,
    read_attachment,
)

if TYPE_CHECKING:
    from turtleact.tasks import Signal
    from turtleact.transports.rmw_zenoh.session import Querier

__all__ = ["WireCall", "WireCaller"]

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
