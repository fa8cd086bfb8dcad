"""Callback groups decide which callbacks of a node may run at the same time."""

from __future__ import annotations

import threading
from weakref import ReferenceType, ref

from turtleact.rclpy.impl.typing import Anything

__all__ = ["CallbackGroup", "MutuallyExclusiveCallbackGroup", "ReentrantCallbackGroup"]


class CallbackGroup:
    """The base class of callback groups.

    Attributes:
        entities: Weak references to the entities of the group.
    """

    def __init__(self) -> None:
        self.entities: set[ReferenceType[Anything]] = set()

    def add_entity(self, entity: Anything) -> None:
        """Add an entity to the group."""
        self.entities.add(ref(entity))

    def has_entity(self, entity: Anything) -> bool:
        """Whether an entity belongs to the group."""
        return ref(entity) in self.entities

    def can_execute(self, entity: Anything) -> bool:
        """Whether a callback of the entity may begin now."""
        raise NotImplementedError

    def beginning_execution(self, entity: Anything) -> bool:
        """Reserve the group for a callback of the entity. Return False if the group is not free."""
        raise NotImplementedError

    def ending_execution(self, entity: Anything) -> None:
        """Mark the group as free, because the callback of the entity has ended."""
        raise NotImplementedError


class ReentrantCallbackGroup(CallbackGroup):
    """Lets all callbacks run at the same time."""

    def can_execute(self, entity: Anything) -> bool:  # noqa: ARG002  # any entity
        """Whether a callback of the entity may begin now."""
        return True

    def beginning_execution(self, entity: Anything) -> bool:  # noqa: ARG002  # any entity
        """Return True, because any number of callbacks may run at the same time."""
        return True

    def ending_execution(self, entity: Anything) -> None:
        """Do nothing, because the group was not reserved."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """Lets one callback run at a time.

    If the callback is a coroutine, the next callback may run only after the coroutine has ended.
    """

    def __init__(self) -> None:
        super().__init__()
        self._active_entity: Anything | None = None
        self._lock = threading.Lock()

    @property
    def active_entity(self) -> Anything | None:
        """The entity with the callback that runs now; None if no callback runs."""
        return self._active_entity

    def can_execute(self, entity: Anything) -> bool:
        """Whether a callback of the entity may begin now."""
        with self._lock:
            assert ref(entity) in self.entities  # noqa: S101  # as in rclpy
            return self._active_entity is None

    def beginning_execution(self, entity: Anything) -> bool:
        """Reserve the group for a callback of the entity. Return False if the group is not free."""
        with self._lock:
            assert ref(entity) in self.entities  # noqa: S101  # as in rclpy
            if self._active_entity is None:
                self._active_entity = entity
                return True
            return False

    def ending_execution(self, entity: Anything) -> None:
        """Mark the group as free, because the callback of the entity has ended."""
        with self._lock:
            assert self._active_entity is entity  # noqa: S101  # as in rclpy
            self._active_entity = None
