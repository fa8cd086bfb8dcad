"""What a node has opened: each thing until it is closed, all of it when the node is.

Knows no names and no types of messages.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Literal, Protocol, TypeAlias
from weakref import WeakValueDictionary

import anyio

from turtleact.transports.base import Closeable

__all__ = ["Kind", "Resources"]

Kind: TypeAlias = Literal["action server", "service server", "other"]
"""The kinds of things that are closed one after the other."""


class _Closing(Protocol):
    async def aclose(self) -> None: ...


class _Serving(_Closing, Protocol):
    @property
    def is_idle(self) -> bool: ...


class Resources:
    """All that is open on a node.

    Attributes:
        is_open: Whether there may be more.
    """

    def __init__(self) -> None:
        self.is_open = True
        self._count = 0
        self._opened: dict[int, _Closing] = {}
        # Weak, and not emptied when a server begins to close: the node waits for that one too.
        self._servers: dict[str, WeakValueDictionary[int, _Serving]] = {
            "action server": WeakValueDictionary(),
            "service server": WeakValueDictionary(),
        }

    def add(self, thing: _Closing, opened: Closeable) -> Closeable:
        """Keep something until it is closed, by what is returned or with all the rest.

        Args:
            thing: What a user has of it.
            opened: What the transport has of it, closed with it.
        """
        self._count += 1
        self._opened[self._count] = thing
        return _Membership(opened.close, self._opened, self._count)

    def add_server(self, kind: Kind, server: _Serving, close: Callable[[], object]) -> Closeable:
        """Keep a server likewise; ``close`` takes it off the graph."""
        self._count += 1
        self._opened[self._count] = server
        self._servers[kind][self._count] = server
        return _Membership(close, self._opened, self._count)

    def action_servers(self) -> list[object]:
        """The action servers, those too that are being closed; the oldest first."""
        return list(self._servers["action server"].values())

    async def aclose(self) -> None:
        """Close all, shielded: first actions, then services, then the rest, the newest first.

        Whatever becomes of one, the others are closed.
        """
        with anyio.CancelScope(shield=True):
            async with AsyncExitStack() as last_first:
                last_first.push_async_callback(self._close_rest)
                last_first.push_async_callback(self._close_servers, "service server")
                last_first.push_async_callback(self._close_servers, "action server")

    async def _close_servers(self, kind: Kind) -> None:
        """Close all servers of a kind, and wait for those that somebody else is closing."""
        servers = list(self._servers[kind].values())[::-1]
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

    __slots__ = ("_close", "_number", "_things")

    def __init__(
        self, close: Callable[[], object], things: dict[int, _Closing], number: int
    ) -> None:
        self._close = close
        self._things = things
        self._number = number

    def close(self) -> None:
        self._close()
        self._things.pop(self._number, None)
