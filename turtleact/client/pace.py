"""How many requests of a client wait at one service at a time.

A service of ROS 2 keeps ten requests that its node has not taken yet, and drops the oldest of more:
nobody hears of it. Servers of turtleact drop none, and say in a note that they are such.

Source: rmw_zenoh_cpp ``rmw_service_data.cpp``, ``add_new_query``; rmw ``qos_profiles.h``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import anyio

if TYPE_CHECKING:
    from turtleact.transports.base import Caller, Reply

__all__ = ["Pace"]

AT_ONCE: Final = 8
"""So many requests are sent before the first is answered; two are left to other clients."""


class Pace:
    """Sends requests to one service, each in its turn, while too many wait there."""

    def __init__(self) -> None:
        self._room = anyio.CapacityLimiter(AT_ONCE)

    def send_all(self) -> None:
        """Send all that wait for their turn: the server drops nothing."""
        self._room.total_tokens = math.inf
        self._room.total_tokens = AT_ONCE

    async def call(self, caller: Caller, request: object) -> Reply:
        """Send a request in its turn, and wait for the reply; raises as the caller does.

        Cancelling: safe; a request that waits for its turn is not sent.
        """
        turn = object()  # a task may have several
        try:
            self._room.acquire_on_behalf_of_nowait(turn)
        except anyio.WouldBlock:
            await self._room.acquire_on_behalf_of(turn)
        try:
            return await caller.call(request)
        finally:
            self._room.release_on_behalf_of(turn)
