"""Waitables: entities with logic of their own."""

from __future__ import annotations

from collections.abc import Callable

from turtleact.rclpy.callback_groups import CallbackGroup
from turtleact.rclpy.impl.entity import NOTHING, Entity
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.task import Future

__all__ = ["NumberOfEntities", "Waitable"]


class NumberOfEntities:
    """How many entities of each kind a waitable of rclpy waits for."""

    __slots__ = (
        "num_clients",
        "num_events",
        "num_guard_conditions",
        "num_services",
        "num_subscriptions",
        "num_timers",
    )

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

    def __add__(self, other: NumberOfEntities) -> NumberOfEntities:
        return NumberOfEntities(
            *(getattr(self, slot) + getattr(other, slot) for slot in self._order())
        )

    def __repr__(self) -> str:
        values = ", ".join(f"{slot}={getattr(self, slot)}" for slot in self._order())
        return f"<{type(self).__name__}({values})>"

    @staticmethod
    def _order() -> tuple[str, ...]:
        return (
            "num_subscriptions",
            "num_guard_conditions",
            "num_timers",
            "num_clients",
            "num_services",
            "num_events",
        )


class Waitable(Subscriptable, Entity):
    """The base of waitables. There is no wait set: an executor asks `is_ready` with None.

    Args:
        callback_group: Decides when `execute` may run.
    """

    def __init__(self, callback_group: CallbackGroup) -> None:
        super().__init__(callback_group)
        self._futures: list[Future] = []

    def call_on_wake(self, wake: Callable[[], object]) -> None:
        """Call a function when it may have become ready; the node does so."""
        self._wake = wake

    def add_future(self, future: Future) -> None:
        """Keep a future that belongs to it."""
        self._futures.append(future)

    def remove_future(self, future: Future) -> None:
        """Forget a future."""
        if future in self._futures:
            self._futures.remove(future)

    def is_ready(self, wait_set: object) -> bool:
        """Whether `take_data` would return something."""
        raise NotImplementedError("Must be implemented by subclass")

    def take_data(self) -> Anything:
        """Take what `execute` gets."""
        raise NotImplementedError("Must be implemented by subclass")

    async def execute(self, taken_data: Anything) -> None:
        """Handle what was taken."""
        raise NotImplementedError("Must be implemented by subclass")

    def get_num_entities(self) -> NumberOfEntities:
        """Return how many entities it waits for; nobody asks."""
        return NumberOfEntities()

    def add_to_wait_set(self, wait_set: object) -> None:
        """Do nothing: there is no wait set."""

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
