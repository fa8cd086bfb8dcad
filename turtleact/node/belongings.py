"""What a node has opened: each thing until it is closed, all of it when the node is.

Knows no names and no types of messages.
"""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import Protocol, TypeVar
from weakref import WeakValueDictionary

import anyio

from turtleact.server import ActionServer
from turtleact.services import ServiceServer
from turtleact.transports.base import Closeable

__all__ = ["Belongings"]


class _Closing(Protocol):
    async def aclose(self) -> None: ...


class _Serving(_Closing, Protocol):
    @property
    def is_idle(self) -> bool: ...


S = TypeVar("S", bound=_Serving)


class Belongings:
    """All that is open on a node.

    Attributes:
        is_open: Whether there may be more.
    """

    def __init__(self) -> None:
        self.is_open = True
        self._count = 0
        self._opened: dict[int, _Closing] = {}
        self._servers: WeakValueDictionary[int, _Serving] = WeakValueDictionary()

    def add(self, thing: _Closing, opened: Closeable) -> Closeable:
        """Keep something until it is closed, by what is given back or with all the rest.

        Args:
            thing: What a user has of it.
            opened: What the transport has of it, and is closed with it.
        """
        self._count += 1
        number = self._count
        self._opened[number] = thing
        if isinstance(thing, ActionServer | ServiceServer):
            self._servers[number] = thing
        return _Membership(opened, self._opened, number)

    def servers(self, kind: type[S]) -> list[S]:
        """The servers of a kind, those too that are being closed; the oldest first."""
        return [each for each in self._servers.values() if isinstance(each, kind)]

    async def aclose(self) -> None:
        """Close all, shielded: first actions, then services, then the rest, the newest first.

        Whatever becomes of one, the others are closed.
        """
        with anyio.CancelScope(shield=True):
            async with AsyncExitStack() as last_first:
                last_first.push_async_callback(self._close_rest)
                last_first.push_async_callback(self._close_servers, ServiceServer)
                last_first.push_async_callback(self._close_servers, ActionServer)

    async def _close_servers(self, kind: type[_Serving]) -> None:
        """Close all servers of a kind, and wait for those that somebody else is closing."""
        servers = self.servers(kind)[::-1]
        async with anyio.create_task_group() as closing:
            for server in servers:
                if not server.is_idle:
                    closing.start_soon(server.aclose)
            for server in servers:  # the others wait for nothing, and a task costs more than that
                if server.is_idle:
                    await server.aclose()

    async def _close_rest(self) -> None:
        self.is_open = False
        async with AsyncExitStack() as newest_first:
            for thing in self._opened.values():
                newest_first.push_async_callback(thing.aclose)


class _Membership:
    """A hold on something that is open: closing it lets go of it on both sides.

    There are thousands of them, so no closure is made, which is four objects each.
    """

    __slots__ = ("_number", "_opened", "_things")

    def __init__(self, opened: Closeable, things: dict[int, _Closing], number: int) -> None:
        self._opened = opened
        self._things = things
        self._number = number

    def close(self) -> None:
        self._opened.close()
        self._things.pop(self._number, None)
