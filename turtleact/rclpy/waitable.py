"""Waitables: entities with logic of their own."""

from __future__ import annotations

from collections.abc import Callable

from turtleact.rclpy.impl.entity import NOTHING, Entity
from turtleact.rclpy.impl.typing import Anything, Subscriptable

__all__ = ["NumberOfEntities", "Waitable"]


class NumberOfEntities:
    """How many entities of each kind a waitable of rclpy waits for; executors here do not ask."""

    def __init__(
        self,
        num_subs: int = 0,
        num_gcs: int = 0,
        num_timers: int = 0,
        num_clients: int = 0,
        num_services: int = 0,
        num_events: int = 0,
    ) -> None:
        self.num_subscriptions = num_subs
        self.num_guard_conditions = num_gcs
        self.num_timers = num_timers
        self.num_clients = num_clients
        self.num_services = num_services
        self.num_events = num_events


class Waitable(Subscriptable, Entity):
    """The base of waitables. There is no wait set: an executor asks `is_ready` with None.

    Args:
        callback_group: Decides when `execute` may run.
    """

    def call_on_wake(self, wake: Callable[[], object]) -> None:
        """Call a function when it may have become ready; the node does so."""
        self._wake = wake

    def is_ready(self, wait_set: object) -> bool:
        """Whether `take_data` would return something."""
        raise NotImplementedError("Must be implemented by subclass")

    def take_data(self) -> Anything:
        """Take what `execute` gets."""
        raise NotImplementedError("Must be implemented by subclass")

    async def execute(self, taken_data: Anything) -> None:
        """Handle what was taken."""
        raise NotImplementedError("Must be implemented by subclass")

    def is_ready_now(self) -> bool:
        """Whether `take_data` would return something."""
        return not self._handle.is_destroyed and self.is_ready(None)

    def take(self) -> Anything:
        """Take what `execute` gets."""
        taken = self.take_data()
        return NOTHING if taken is None else taken

    async def run(self, taken: Anything) -> None:
        """Handle what was taken."""
        await self.execute(taken)
