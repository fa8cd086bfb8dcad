"""Clients of services and actions, kept for the next who wants the same one."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Hashable
from contextlib import asynccontextmanager
from typing import Final, Generic, Protocol, TypeVar

__all__ = ["Pool"]

MOST_IDLE: Final = 64
"""So many that nobody uses are kept; to open one is to be announced on the graph."""


class Closing(Protocol):
    """What a pool holds."""

    async def aclose(self) -> None:
        """Leave the graph."""


K = TypeVar("K", bound=Hashable)
C = TypeVar("C", bound=Closing)


class Pool(Generic[K, C]):
    """Things that are opened once for all who use them.

    Args:
        open: Opens the thing of a key.
    """

    def __init__(self, open: Callable[[K], C]) -> None:
        self._open = open
        self._held: dict[K, C] = {}  # the one used last stands last
        self._users: dict[K, int] = {}

    @asynccontextmanager
    async def use(self, key: K) -> AsyncIterator[C]:
        """The thing of a key, which stays open for the length of the block at least."""
        held = self._held.pop(key, None)
        if held is None:
            held = self._open(key)
        self._held[key] = held
        self._users[key] = self._users.get(key, 0) + 1
        try:
            yield held
        finally:
            self._users[key] -= 1
            if not self._users[key]:
                del self._users[key]
                await self._tidy()

    async def aclose(self) -> None:
        """Close all."""
        held, self._held = self._held, {}
        for each in held.values():
            await each.aclose()

    async def _tidy(self) -> None:
        """Close the one that nobody has used for longest, if there are too many."""
        idle = [key for key in self._held if key not in self._users]
        if len(idle) > MOST_IDLE:
            await self._held.pop(idle[0]).aclose()
