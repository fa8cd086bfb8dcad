"""Callback groups decide which callbacks of a node may run at the same time."""

from __future__ import annotations

import threading
from typing import Protocol
from weakref import ReferenceType, ref

__all__ = ["CallbackGroup", "MutuallyExclusiveCallbackGroup", "ReentrantCallbackGroup"]


class Member(Protocol):
    """The part of an entity that a callback group uses."""

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""


class CallbackGroup:
    """The base of all callback groups.

    Attributes:
        entities: Weak references to the entities of the group.
    """

    def __init__(self) -> None:
        self.entities: set[ReferenceType[Member]] = set()

    def add_entity(self, entity: Member) -> None:
        """Add an entity to the group."""
        self.entities.add(ref(entity))

    def has_entity(self, entity: Member) -> bool:
        """Whether an entity belongs to the group."""
        return ref(entity) in self.entities

    def can_execute(self, entity: Member) -> bool:
        """Whether a callback of the entity may begin now."""
        raise NotImplementedError

    def beginning_execution(self, entity: Member) -> bool:
        """Take the right to run a callback of the entity. Return whether the right was free."""
        raise NotImplementedError

    def ending_execution(self, entity: Member) -> None:
        """Give the right back."""
        raise NotImplementedError


class ReentrantCallbackGroup(CallbackGroup):
    """Lets all callbacks run side by side."""

    def can_execute(self, entity: Member) -> bool:  # noqa: ARG002  # any entity
        """Whether a callback of the entity may begin now."""
        return True

    def beginning_execution(self, entity: Member) -> bool:  # noqa: ARG002  # any entity
        """Take the right to run a callback of the entity."""
        return True

    def ending_execution(self, entity: Member) -> None:
        """Do nothing, because no callback waits."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """Lets one callback run at a time. A coroutine counts until its end."""

    def __init__(self) -> None:
        super().__init__()
        self._active_entity: Member | None = None
        self._lock = threading.Lock()

    @property
    def active_entity(self) -> Member | None:
        """The entity that holds the group."""
        return self._active_entity

    def can_execute(self, entity: Member) -> bool:
        """Whether a callback of the entity may begin now."""
        with self._lock:
            assert ref(entity) in self.entities  # noqa: S101  # as in rclpy
            return self._active_entity is None

    def beginning_execution(self, entity: Member) -> bool:
        """Take the right to run a callback of the entity. Return whether the right was free."""
        with self._lock:
            assert ref(entity) in self.entities  # noqa: S101  # as in rclpy
            if self._active_entity is None:
                self._active_entity = entity
                return True
            return False

    def ending_execution(self, entity: Member) -> None:
        """Give the right back."""
        with self._lock:
            assert self._active_entity is entity  # noqa: S101  # as in rclpy
            self._active_entity = None
