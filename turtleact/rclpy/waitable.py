"""Waitables: entities that decide in their own code when they are ready and what they run."""

from __future__ import annotations

from collections.abc import Callable

from turtleact.rclpy.impl.entity import NOTHING, Entity
from turtleact.rclpy.impl.typing import Anything, Subscriptable

__all__ = ["NumberOfEntities", "Waitable"]


class NumberOfEntities:
    """How many entities of each kind a waitable of rclpy waits for.

    turtleact's executors do not use this class.
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
    """The base class of waitables. turtleact has no wait sets: executors call ``is_ready(None)``.

    Args:
        callback_group: Decides when `execute` may run.
    """

    def call_on_wake(self, wake: Callable[[], object]) -> None:
        """Set the function to call when the waitable may have become ready.

        `Node.add_waitable` calls this method.
        """
        self._wake = wake

    def is_ready(self, wait_set: object) -> bool:
        """Whether `take_data` would return something."""
        raise NotImplementedError("Must be implemented by subclass")

    def take_data(self) -> Anything:
        """Remove and return the argument for `execute`; None if there is none."""
        raise NotImplementedError("Must be implemented by subclass")

    async def execute(self, taken_data: Anything) -> None:
        """Handle the result of `take_data`."""
        raise NotImplementedError("Must be implemented by subclass")

    def is_ready_now(self) -> bool:
        """Whether `take_data` would return something; False after `destroy`."""
        return not self._handle.is_destroyed and self.is_ready(None)

    def take(self) -> Anything:
        """Return the result of `take_data`, or `NOTHING` instead of None."""
        taken = self.take_data()
        return NOTHING if taken is None else taken

    async def run(self, taken: Anything) -> None:
        """Pass the result of `take` to `execute`."""
        await self.execute(taken)
