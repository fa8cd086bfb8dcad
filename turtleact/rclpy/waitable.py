"""Waitables, which are served before timers and messages, and guard conditions."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING

from turtleact.rclpy.impl.entity import NOTHING, Entity
from turtleact.rclpy.impl.typing import Anything, Subscriptable

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup
    from turtleact.rclpy.context import Context

__all__ = ["GuardCondition", "Waitable"]


class Waitable(Subscriptable, Entity):
    """The base class of action servers, action clients and event handlers.

    turtleact has no wait sets, so programs cannot define waitables of their own.

    Args:
        callback_group: Decides when `run` may be called.
    """

    def call_on_wake(self, wake: Callable[[], object]) -> None:
        """Set the function to call when the waitable may have become ready."""
        self._wake = wake


class GuardCondition(Entity):
    """Makes an executor call a function once after a call of `trigger`.

    Make a guard condition with `Node.create_guard_condition`.
    """

    def __init__(
        self,
        callback: Anything,
        callback_group: CallbackGroup,
        context: Context | None = None,  # noqa: ARG002  # rclpy's signature
        wake: Callable[[], object] | None = None,
    ) -> None:
        self.callback = callback
        self._is_triggered = False
        super().__init__(callback_group, wake=wake)

    def trigger(self) -> None:
        """Make an executor call the function soon. Any thread may call this."""
        with self.handle:
            self._is_triggered = True
        self.wake()

    def is_ready_now(self) -> bool:
        """Whether the condition was triggered."""
        return self._is_triggered and not self._handle.is_destroyed

    def take(self) -> Anything:
        """Forget that the condition was triggered; return `NOTHING` if it was not."""
        if not self._is_triggered:
            return NOTHING
        self._is_triggered = False
        return None

    async def run(self, taken: None) -> None:  # noqa: ARG002  # nothing to take
        """Call the callback of the guard condition."""
        if self.callback is not None:
            result = self.callback()
            if inspect.iscoroutine(result):
                await result

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return "a guard condition"
