"""The server end of a service: handlers in this process, and requests from other processes.

A request carries its client's gid and a sequence number. Each request is handled in its own task,
unless the handler can answer it without a task. Every request is answered, either with the response
or with an error, such as the handler's exception.

Source: rmw_zenoh_cpp ``rmw_service_data.cpp``.
"""

from __future__ import annotations

import logging
from contextvars import copy_context
from functools import partial
from time import time_ns
from typing import TYPE_CHECKING

import msgspec

from turtleact.errors import InvalidMessage, ServerUnavailable, ServiceError, TurtleactError
from turtleact.tasks.failures import summary
from turtleact.transports.base import (
    REQUEST_NOTE,
    Closeable,
    Format,
    Reply,
    ServiceHandler,
)
from turtleact.transports.rmw_zenoh.context import Context, Declaration, Named
from turtleact.transports.rmw_zenoh.wire import (
    encode_error,
    read_attachment,
    write_attachment,
)

if TYPE_CHECKING:
    from turtleact.transports.rmw_zenoh.session import Declared, Query

__all__ = ["WireService"]

logger = logging.getLogger("turtleact.services")


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
