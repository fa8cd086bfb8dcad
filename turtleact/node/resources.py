"""Tracks everything that a node has opened, and closes it when the node closes.

This module knows nothing about names and message types.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack, contextmanager
from typing import TypeVar, cast
from weakref import WeakValueDictionary

import anyio

from turtleact.tasks import LoopGuard
from turtleact.transports.base import AsyncCloseable, Closeable, Owner, ServerKind, Serving

__all__ = ["Resources"]

T = TypeVar("T")


class Resources(Owner):
    """Tracks everything that is open on a node.

    Attributes:
        home: The event loop of the node.
        is_open: Whether resources can still be opened on the node.
    """

    def __init__(self, home: LoopGuard) -> None:
        self.home = home
        self.is_open = True
        self._watchers: list[Callable[[object], object]] = []
        self._count = 0
        self._opened: dict[int, AsyncCloseable] = {}
        self._waits: set[anyio.CancelScope] = set()
        # The references are weak, and a server stays here while it closes: the node waits for it.
        self._servers: dict[str, WeakValueDictionary[int, Serving]] = {
            "action server": WeakValueDictionary(),
            "service server": WeakValueDictionary(),
        }

    def add(
        self, thing: AsyncCloseable, close: Callable[[], object], kind: ServerKind | None = None
    ) -> Closeable:
        """Track ``thing`` until the returned object is closed; see `Owner.add`."""
        self._count += 1
        self._opened[self._count] = thing
        if kind is not None:
            self._servers[kind][self._count] = cast("Serving", thing)
        for told in self._watchers:
            told(thing)
        return _Membership(close, self._opened, self._count)

    def watch(self, told: Callable[[object], object]) -> None:
        """Call ``told`` with each object that is open now or is opened later."""
        self._watchers.append(told)
        for thing in tuple(self._opened.values()):
            told(thing)

    def find(self, kind: type[T]) -> T | None:
        """Return the oldest open object of a class; None if there is none."""
        return next((each for each in self._opened.values() if isinstance(each, kind)), None)

    def action_servers(self) -> list[object]:
        """The action servers, oldest first, including those that are closing."""
        return list(self._servers["action server"].values())

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Make a context manager that cancels the waits in its block when the node closes.

        The block then ends without an exception. Check `is_open` before and after the block.
        """
        with anyio.CancelScope() as scope:
            self._waits.add(scope)
            try:
                yield
            finally:
                self._waits.discard(scope)

    async def aclose(self) -> None:
        """Close everything, shielded from cancellation: actions, then services, then the rest.

        If closing one object fails, the others are still closed.
        """
        with anyio.CancelScope(shield=True):
            # An exit stack calls its callbacks in reverse order, and calls all of them even if
            # one raises. It then raises the error at the end.
            async with AsyncExitStack() as last_first:
                last_first.push_async_callback(self._close_rest)
                last_first.push_async_callback(self._close_servers, "service server")
                last_first.push_async_callback(self._close_servers, "action server")

    async def _close_servers(self, kind: ServerKind) -> None:
        """Close all servers of a kind, and wait for those that are closing already."""
        servers = list(self._servers[kind].values())[::-1]
        async with anyio.create_task_group() as closing:
            for server in servers:
                if not server.is_idle:
                    closing.start_soon(server.aclose)
            for server in servers:  # idle servers close without waiting, so they need no task
                if server.is_idle:
                    await server.aclose()

    async def _close_rest(self) -> None:
        # Only now: while actions and services close, their bodies and handlers may still open
        # things and wait for them.
        self.is_open = False
        for scope in self._waits:
            scope.cancel()
        async with AsyncExitStack() as newest_first:
            for thing in self._opened.values():
                newest_first.push_async_callback(thing.aclose)


class _Membership:
    """The registration of one open object with its node.

    Closing the registration removes the object from the node and the transport. A node may have
    thousands of registrations. A registration is one Python object, while a closure would need four
    objects.
    """

    __slots__ = ("_close", "_number", "_things")

    def __init__(
        self, close: Callable[[], object], things: dict[int, AsyncCloseable], number: int
    ) -> None:
        self._close = close
        self._things = things
        self._number = number

    def close(self) -> None:
        self._close()
        self._things.pop(self._number, None)
