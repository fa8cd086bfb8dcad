"""The base class of entities: timers, subscriptions and other objects with callbacks."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

from turtleact.rclpy.exceptions import InvalidHandle
from turtleact.rclpy.impl.typing import Anything

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup

__all__ = ["NOTHING", "Block", "Destroyable", "Entity", "Handle"]

NOTHING = object()
"""The result of `Entity.take` if there was nothing to take after all."""


class Handle:
    """Shows whether an object may still be used.

    At the start of a ``with`` block, the handle raises `InvalidHandle` if the object was destroyed.
    If the object is destroyed while such blocks run, it is closed when the last block ends.

    Args:
        close: Closes the object; called once.
    """

    def __init__(self, close: Callable[[], object] | None = None) -> None:
        self._close = close
        self._lock = threading.Lock()
        self._users = 0
        self._is_destroyed = False

    @property
    def is_destroyed(self) -> bool:
        """Whether the object was destroyed."""
        return self._is_destroyed

    def check(self) -> None:
        """Check that the object was not destroyed.

        Raises:
            InvalidHandle: if the object was destroyed.
        """
        if self._is_destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")

    def destroy_when_not_in_use(self) -> None:
        """Destroy the object, and close it as soon as no ``with`` block uses it.

        A second call does nothing.
        """
        with self._lock:
            is_first = not self._is_destroyed
            self._is_destroyed = True
            is_free = is_first and not self._users
        if is_free and self._close is not None:
            self._close()

    def __enter__(self) -> Self:
        with self._lock:
            self.check()
            self._users += 1
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        with self._lock:
            self._users -= 1
            is_last = self._is_destroyed and not self._users
        # Without the lock, because closing may lead back here.
        if is_last and self._close is not None:
            self._close()


class Block:
    """A context manager that returns itself, and calls `_leave` at the end of the block."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._leave()

    def _leave(self) -> None:
        """Clean up at the end of the block."""
        raise NotImplementedError


class Destroyable(Block):
    """An object that can be destroyed.

    As a context manager, it destroys itself at the end of the block.
    """

    def destroy(self) -> None:
        """Destroy the object. A second call does nothing."""
        raise NotImplementedError

    def _leave(self) -> None:
        self.destroy()


class Entity(Destroyable):
    """A source of callbacks: a timer, subscription, guard condition, client, service or waitable.

    Args:
        callback_group: Decides when the callback of the entity may run.
        close: Called once, when the entity is destroyed.
        wake: Called in any thread when the entity may have become ready.

    Attributes:
        callback_group: The callback group of the entity.
        blocked_since: When the entity began to wait for its callback group (s, `time.monotonic`); 0
            if it does not wait, and -1 after a warning about the wait.
    """

    def __init__(
        self,
        callback_group: CallbackGroup,
        *,
        close: Callable[[], object] | None = None,
        wake: Callable[[], object] | None = None,
    ) -> None:
        self.callback_group = callback_group
        self.blocked_since = 0.0
        self._handle = Handle(close)
        self._wake = wake
        if callback_group is not None:
            callback_group.add_entity(self)

    @property
    def handle(self) -> Handle:
        """The entity's handle, which shows whether the entity has been destroyed."""
        return self._handle

    def wake(self) -> None:
        """Make the executor check whether the entity is ready."""
        if self._wake is not None:
            self._wake()

    def is_ready_now(self) -> bool:
        """Whether there is something for the callback to handle now. This never blocks."""
        raise NotImplementedError

    def due_in(self) -> float | None:
        """Return the time until the entity is ready (s).

        Return None if the entity's readiness does not depend on time alone.
        """
        return None

    def take(self) -> Anything:
        """Return the next argument for the callback; `NOTHING` if another thread has taken it."""
        raise NotImplementedError

    async def run(self, taken: Anything) -> None:
        """Run the callback."""
        raise NotImplementedError

    def describe(self) -> str:
        """Describe this entity for a diagnostic message, such as "the timer of 0.5 s"."""
        return type(self).__name__.lower()

    def destroy(self) -> None:
        """Destroy the entity. A second call does nothing."""
        self._handle.destroy_when_not_in_use()
