"""Waitables: entities with logic of their own."""

from __future__ import annotations

from collections.abc import Callable

from turtleact.rclpy.impl.entity import NOTHING, Entity
from turtleact.rclpy.impl.typing import Anything, Subscriptable

__all__ = ["NumberOfEntities", "Waitable"]


class NumberOfEntities:
    """How many entities of each kind a waitable of rclpy waits for.

    Executors here do not use it.
    """

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
    """The base of waitables. Executors have no wait sets: they call ``is_ready(None)``.

    Args:
        callback_group: Decides when `execute` may run.
    """

    def call_on_wake(self, wake: Callable[[], object]) -> None:
        """Set the function to call when the waitable may have become ready. The node calls this."""
        self._wake = wake

    def is_ready(self, wait_set: object) -> bool:
        """Whether `take_data` would return something."""
        raise NotImplementedError("Must be implemented by subclass")

    def take_data(self) -> Anything:
        """Take the argument for `execute`."""
        raise NotImplementedError("Must be implemented by subclass")

    async def execute(self, taken_data: Anything) -> None:
        """Handle the result of `take_data`."""
        raise NotImplementedError("Must be implemented by subclass")

    def is_ready_now(self) -> bool:
        """Whether `take_data` would return something."""
        return not self._handle.is_destroyed and self.is_ready(None)

    def take(self) -> Anything:
        """Take the argument for `execute`."""
        taken = self.take_data()
        return NOTHING if taken is None else taken

    async def run(self, taken: Anything) -> None:
        """Handle the result of `take`."""
        await self.execute(taken)
