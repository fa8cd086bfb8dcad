"""Calls services from any thread.

A server of rclpy in the same process gets the request directly. If the server is in another process
and is known already, the calling thread itself sends the request, without waiting for the event
loop.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from itertools import count

from turtleact.errors import TurtleactError
from turtleact.rclpy.impl.connection import Connection, RequestHandler, Respond
from turtleact.rclpy.service_introspection import SwitchableEvents
from turtleact.transports.base import (
    EVERY_SERVER,
    Caller,
    Endpoint,
    PendingCall,
    Reply,
    Target,
)

__all__ = ["CallEnd"]


class CallEnd:
    """Sends a client's requests to the servers of a service, and receives the responses.

    Args:
        connection: The connection to the graph.
        endpoint: Describes the client on the graph.
        type_hash: The type hash of the service.
        events: Publishes the events of the calls, if introspection is on.
        target: Which servers get the requests.

    Attributes:
        events: The publisher of the calls' introspection events.
    """

    def __init__(
        self,
        connection: Connection,
        endpoint: Endpoint,
        type_hash: str,
        events: SwitchableEvents,
        target: Target = EVERY_SERVER,
    ) -> None:
        self._connection = connection
        self._endpoint = endpoint
        self._caller: Caller = connection.join(endpoint, type_hash, target)
        self._caller.observer = self.events = events
        self._gid = os.urandom(16)  # identifies it in the events of calls inside the process
        self._sequence = count(1)
        self._lock = threading.Lock()
        self._found: RequestHandler | None = None
        self._seen = -1

    @property
    def is_served(self) -> bool:
        """Whether a call would reach a server now."""
        return self._caller.is_served

    def send(
        self,
        request: bytes,
        answered: Callable[[bytes, str], object],
        failed: Callable[[TurtleactError], object],
    ) -> None:
        """Send a request.

        Args:
            request: The encoded request.
            answered: Called in any thread, with the response and the note that came with it.
            failed: Called in any thread, with the error, if no response will come.
        """
        handler = self._local()
        if handler is not None:

            def respond(response: bytes | TurtleactError, note: str) -> None:
                if isinstance(response, TurtleactError):
                    failed(response)
                else:
                    answered(response, note)

            handler.take(request, self._watched(handler, request, respond))
            return

        def ended(call: PendingCall) -> None:
            try:
                settle(call.take())
            except TurtleactError as error:
                failed(error)

        async def call() -> None:
            try:
                settle(await self._caller.call(request))
            except TurtleactError as error:
                failed(error)

        def settle(reply: Reply) -> None:
            assert isinstance(reply.message, bytes)  # noqa: S101  # see `Encoded`
            answered(reply.message, reply.note)

        with self._lock:
            is_sent = self._caller.ask(request, ended) is not None
        if not is_sent:  # a server that was seen may not be reachable yet
            self._connection.loop.start(call)

    def close(self) -> None:
        """Publish no more events, and leave the graph when all pending calls have ended.

        In rcl, a client publishes a response event only when the client takes the response. A
        destroyed client takes no more responses, so no more response events are published.
        """
        self._connection.loop.post(self._caller.close)
        self.events.close()

    def _watched(self, handler: RequestHandler, request: bytes, respond: Respond) -> Respond:
        """Report a request to the observers, and return a function that reports the response.

        The transport does not report calls inside this process, so this method does.
        """
        both = (self.events, handler.observer)
        observers = [each for each in both if each is not None and each.is_on]
        if not observers:
            return respond
        sequence = next(self._sequence)
        for each in observers:
            each.requested(request, self._gid, sequence)

        def answer(response: bytes | TurtleactError, note: str) -> None:
            if not isinstance(response, TurtleactError):
                for each in reversed(observers):
                    each.responded(response, self._gid, sequence)
            respond(response, note)

        return answer

    def _local(self) -> RequestHandler | None:
        """Return the server in this process, if there is one.

        The server is looked up again whenever the graph has changed.
        """
        changes = self._connection.changes
        if changes != self._seen:
            endpoint = self._endpoint
            self._found = self._connection.local(endpoint.name, endpoint.type_name)
            self._seen = changes
        return self._found
