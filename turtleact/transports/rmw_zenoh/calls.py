"""Both ends of a service: calls within the process as objects, the others as queries.

A request names its client by gid and sequence number. Each is handled in a task of its own, and is
answered in any case: with the response, or with what the handler raised, which clients of our kind
raise again. Zenoh ends a query without a word where nobody serves the key, or the server dies: the
graph then says why.

Source: rmw_zenoh_cpp ``rmw_service_data.cpp``, ``rmw_client_data.cpp``.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import anyio

from turtleact.errors import (
    InvalidMessage,
    ServerUnavailable,
    ServiceError,
    TurtleactError,
)
from turtleact.summaries import loggable, summary
from turtleact.tasks import GRACE
from turtleact.transports.base import (
    Asked,
    Caller,
    Closeable,
    Endpoint,
    Format,
    Prompt,
    Reply,
    Replying,
    Target,
    why_not_served,
)
from turtleact.transports.rmw_zenoh.asking import Call
from turtleact.transports.rmw_zenoh.attachment import (
    Attachment,
    note_in,
    read_attachment,
    write_attachment,
)
from turtleact.transports.rmw_zenoh.failures import error_said, said
from turtleact.transports.rmw_zenoh.link import Counter, Link, Named, Presence

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.session import Declared, Querier, Query

__all__ = ["WireCaller", "WireService"]

logger = logging.getLogger("turtleact.services")


class WireService:
    """The serving end of a service.

    Args:
        link: What carries the messages.
        named: The endpoint.
        format: How requests are read and responses written.
        is_for_others: Whether its handlers answer other processes.

    Attributes:
        is_open: Whether it takes requests, and more handlers.
    """

    def __init__(self, link: Link, named: Named, format: Format, *, is_for_others: bool) -> None:
        self._link = link
        self._named = named
        self._name = named.endpoint.name
        self._format = format
        self._offers: list[_Offer] = []
        self._under_way: set[tuple[bytes, int]] = set()
        self._declared: Declared | None = None
        self.is_open = True
        declare = self._declare if is_for_others else None
        self._presence = Presence(
            link, named.token, declare, self._undeclare, on_demand=named.on_demand
        )
        link.opened.add(self)

    def add(self, handler: object) -> Closeable:
        """Let a handler answer too; requests of other processes go to the first one.

        Returns:
            What takes it back. The service is there until the last of them is closed.
        """
        near = self._link.near.serve(self._named.endpoint, self._format, handler)
        offer = _Offer(self, near, handler)
        self._offers.append(offer)
        return offer

    def remove(self, offer: _Offer) -> None:
        """Take a handler back; a second time does nothing."""
        if offer in self._offers:
            self._offers.remove(offer)
            if not self._offers:
                self.close()

    def close(self) -> None:
        """Take no more requests; those under way go on. A second time does nothing."""
        if not self.is_open:
            return
        self.is_open = False
        for offer in tuple(self._offers):
            offer.close()
        self._presence.close()
        self._link.opened.discard(self)

    def _take(self, query: Query) -> None:
        """Called in a thread of the session."""
        self._link.inbox.push(partial(self._begin, query))

    def _begin(self, query: Query) -> None:
        try:
            beside = read_attachment(query.attachment)
            if (beside.gid, beside.sequence) in self._under_way:
                raise InvalidMessage("attachment", f"request {beside.sequence} is under way")
            request = self._format.decode(query.payload)
        except InvalidMessage as error:
            logger.warning("service %s: a request cannot be read: %s", self._name, error)
            self._fail(query, error)
            return
        offer = self._offers[0] if self._offers else None
        if offer is None or not self._link.is_open:
            self._fail(query, self._closed())
            return
        try:
            prompt = offer.prompt
            reply = None if prompt is None else prompt.reply_now(request, beside.gid)
            if reply is not None:
                self._respond(query, beside, reply)
        except Exception as error:
            self._fail(query, self._failure(error))
            return
        if reply is None:
            self._under_way.add((beside.gid, beside.sequence))
            answering = self._answer(offer, query, beside, request)
            self._link.crew.run(answering, f"a request to {self._name}")

    async def _answer(
        self, offer: _Offer, query: Query, beside: Attachment, request: object
    ) -> None:
        """Have a request answered; nothing but a cancellation gets out."""
        error: TurtleactError | None = self._closed()
        try:
            assert offer.replying is not None  # noqa: S101  # else it was not chosen
            self._respond(query, beside, await offer.replying.reply(request, beside.gid))
            error = None
        except Exception as failure:
            error = self._failure(failure)
        finally:
            self._under_way.discard((beside.gid, beside.sequence))
            if error is not None:
                self._fail(query, error)

    def _respond(self, query: Query, beside: Attachment, reply: Reply) -> None:
        payload = self._format.encode(reply.message)
        attachment = write_attachment(beside.sequence, time.time_ns(), beside.gid, reply.note)
        self._link.outbox.post(partial(query.reply, payload, attachment))

    def _failure(self, error: Exception) -> TurtleactError:
        """What a client is told of what a handler has raised."""
        if isinstance(error, TurtleactError):
            return error
        logger.error("the handler of service %s failed", self._name, exc_info=loggable(error))
        return ServiceError(self._name, f"the handler failed: {summary(error)}")

    def _fail(self, query: Query, error: TurtleactError) -> None:
        kind, text = said(error)
        self._link.outbox.post(lambda: query.fail(text, kind))

    def _closed(self) -> ServerUnavailable:
        return ServerUnavailable(self._name, "the server was closed", kind="service")

    # in the outbox

    def _declare(self) -> None:
        self._declared = self._link.session.declare_queryable(self._named.key, self._take)

    def _undeclare(self) -> None:
        if self._declared is not None:
            self._declared.undeclare()


class _Offer:
    """A handler of a service, and what has it open within the process."""

    __slots__ = ("_near", "_service", "prompt", "replying")

    def __init__(self, service: WireService, near: Closeable, handler: object) -> None:
        self.replying = handler if isinstance(handler, Replying) else None
        self.prompt = handler if isinstance(handler, Prompt) else None
        self._service = service
        self._near = near

    def close(self) -> None:
        self._near.close()
        self._service.remove(self)


class WireCaller:
    """The asking end of a service.

    Args:
        link: What carries the messages.
        named: The endpoint.
        format: How requests are written and responses read.
        target: Which servers are asked, and which of their replies count.
        find: Gives the servers of the same name that others have.
    """

    def __init__(
        self,
        link: Link,
        named: Named,
        format: Format,
        target: Target,
        find: Callable[[str], list[Endpoint]],
    ) -> None:
        self._link = link
        self._key = named.key
        self._endpoint = endpoint = named.endpoint
        self._format = format
        self._target = target
        self.counts = target.counts
        self._find = find
        self._counter = Counter(endpoint.gid)
        self._is_open = True
        self._is_matching = False
        self._querier: Querier | None = None
        self._calls: set[Call] = set()
        self._near: Caller = link.near.join(endpoint, format)
        self._presence = Presence(link, named.token, self._declare, self._undeclare)
        link.opened.add(self)

    @property
    def is_served(self) -> bool:
        """Whether a call would reach a server now."""
        return self._near.is_served or (self._is_matching and self._link.is_open)

    async def call(self, request: object) -> Reply:
        """Send a request, and wait for the reply; see `turtleact.transports.base.Caller`."""
        if self._near.is_served or not self._is_open:
            return await self._near.call(request)
        payload = self._format.encode(request)
        if not self._is_matching:
            await self._wait_for_route()
        if not self._is_matching or not self._link.is_open:
            raise self._unavailable(self.why_not_served())
        return await self._send(payload, is_cancelable=True).reply()

    def ask(self, request: object) -> Asked | None:
        """Send a request now; None if it would not go to another process, or has to wait."""
        is_far = self._is_matching and self._link.is_open and not self._near.is_served
        if not is_far or not self._is_open:
            return None
        return self._send(self._format.encode(request), is_cancelable=False)

    def close(self) -> None:
        """Leave the graph, but others are told only when the calls under way are over.

        They go on, and a server may cancel those of a client that has gone. A second time does
        nothing.
        """
        if self._is_open:
            self._is_open = False
            self._near.close()
            if not self._calls:
                self._leave()

    def give_up(self) -> None:
        """Let all calls under way end: the transport is being closed."""
        calls, self._calls = self._calls, set()
        for call in calls:
            call.end()

    def doubt(self, server: str) -> None:
        """A server has gone: give calls to it a moment to end, or to be answered by another."""
        if server != self._endpoint.name:
            return
        for call in tuple(self._calls):  # one that is over is taken at once
            self._link.crew.run(call.end_soon(), f"a call of {self._endpoint.name}")

    async def _wait_for_route(self) -> None:
        """Wait until a server whose token has come can be reached, `GRACE` seconds at most."""
        with anyio.move_on_after(GRACE):
            while not self._is_matching and any(map(self._fits, self._servers())):
                await self._link.near.wait_for_change()

    def _send(self, payload: bytes, *, is_cancelable: bool) -> Call:
        call = Call(self._link, payload, self._counter.next(), self, is_cancelable=is_cancelable)
        self._calls.add(call)
        self._link.outbox.post(lambda: call.send(self._querier))
        return call

    def over(self, call: Call) -> None:
        """Note that nobody waits for a call any more."""
        if call in self._calls:
            self._calls.discard(call)
            if not self._is_open and not self._calls:
                self._leave()

    def _leave(self) -> None:
        self._link.opened.discard(self)  # until now it is to be told of servers that go
        self._presence.close()

    def read(self, call: Call) -> Reply:
        """What came of a call; raises what its server raised."""
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
        return Reply(message, note_in(attachment))

    # servers

    def _servers(self) -> list[Endpoint]:
        return self._find(self._endpoint.name)

    def _fits(self, server: Endpoint) -> bool:
        ours = self._endpoint
        return (server.type_name, server.type_hash) == (ours.type_name, ours.type_hash)

    def why_not_served(self, suffix: str = "") -> str:
        """Why a call would reach no server; see `turtleact.transports.base.Caller`."""
        ours, servers = self._endpoint, self._servers()
        if not self._link.is_open:
            return "the Zenoh transport is closed"
        if reachable := [each.node for each in servers if self._fits(each)]:
            return f"node {reachable[0]} serves it, but cannot be reached"
        if not servers:
            return why_not_served(self._link.near.endpoints(ours.name), ours, suffix)
        return why_not_served(servers, ours, suffix)

    def _why_no_answer(self) -> str:
        if not self._link.is_open:
            return "the Zenoh transport was closed before there was an answer"
        return "the server went away before there was an answer"

    def _why_otherwise(self) -> str:
        """What else may have happened, if one that was asked may be there still."""
        if self._link.is_open and any(map(self._fits, self._servers())):
            return "dropped the request: ROS 2 keeps 10 that wait"
        return ""

    def _unavailable(self, problem: str, otherwise: str = "") -> ServerUnavailable:
        name = self._endpoint.name
        return ServerUnavailable(name, problem, kind="service", otherwise=otherwise)

    def _matching(self, is_matching: bool) -> None:
        """Called in a thread of the session."""
        self._link.inbox.push(lambda: self._servers_changed(is_matching))

    def _servers_changed(self, is_matching: bool) -> None:
        self._is_matching = is_matching
        if not is_matching:
            self.doubt(self._endpoint.name)
        self._link.near.tell_change()

    # in the outbox

    def _declare(self) -> None:
        is_for_all = self._target.servers == "all"
        session = self._link.session
        self._querier = session.declare_querier(self._key, self._matching, is_for_all=is_for_all)

    def _undeclare(self) -> None:
        if self._querier is not None:
            self._querier.undeclare()
            self._querier = None
