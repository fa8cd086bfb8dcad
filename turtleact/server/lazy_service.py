"""A service of an action: in the graph from the start, and made with its first request."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from turtleact.services import ServiceServer
from turtleact.tasks import Tasks
from turtleact.transports.base import Reply

if TYPE_CHECKING:
    from turtleact.server.action_server import ActionServer

__all__ = ["LazyService"]


def _never(_request: object, _caller: bytes) -> None:
    """Nothing is answered at once."""


class LazyService:
    """A service that is made with its first request: its classes take a while to make.

    Requests from a wire are not checked again: they were read as what they have to be.

    Args:
        server: The server that it belongs to.
        name: The name of the service.
        find_type: Makes its class.
        handle: Takes a request, of that very class, and the gid of its client, if it has one.
        tasks: Runs what answers requests.
        now: Takes a request likewise, if that needs no waiting; else None, with nothing done.

    Attributes:
        server: The server that it belongs to.
        name: The name of the service.
        find_type: Makes its class.
        is_open: Whether it takes requests.
        answered: Fires whenever a request has been answered.
        waiting: How many wait for their answer.
    """

    def __init__(
        self,
        server: ActionServer[Any, Any, Any],
        name: str,
        find_type: Callable[[], Any],
        handle: Callable[[Any, bytes], Awaitable[Reply]],
        tasks: Tasks,
        now: Callable[[Any, bytes], Reply | None] = _never,
    ) -> None:
        self.server = server
        self._now = now
        self.name = name
        self.find_type = find_type
        self.is_open = True
        self._handle = handle
        self._tasks = tasks
        self.answered = tasks.signal()
        self.waiting = 0
        self._made: ServiceServer[Any, Any] | None = None

    async def answer(self, request: object) -> object:
        """Have a request handled, and wait for its response."""
        if self._made is None:
            self._made = self._make()
        with self._counting():
            return await self._made.answer(request)

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a request that came over a wire."""
        with self._counting():
            return await self._handle(request, caller)

    def reply_now(self, request: object, caller: bytes) -> Reply | None:
        """The same if it takes no waiting."""
        reply = self._now(request, caller)
        if reply is not None:
            self.answered.fire()
        return reply

    async def aclose(self) -> None:
        """Answer all who wait."""
        self.is_open = False
        if self._made is not None:
            await self._made.aclose()

    @contextmanager
    def _counting(self) -> Iterator[None]:
        self.waiting += 1
        try:
            yield
        finally:
            self.waiting -= 1
            self.answered.fire()

    def _make(self) -> ServiceServer[Any, Any]:
        async def handle(request: object) -> object:
            return (await self._handle(request, b"")).message

        return ServiceServer(self.find_type(), self.name, handle, tasks=self._tasks)
