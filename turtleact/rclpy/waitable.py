"""Waitables: the entities of a node that its executor serves before timers and messages."""

from __future__ import annotations

from collections.abc import Callable

from turtleact.rclpy.impl.entity import Entity
from turtleact.rclpy.impl.typing import Subscriptable

__all__ = ["Waitable"]


class Waitable(Subscriptable, Entity):
    """The base class of action servers, action clients and event handlers.

    turtleact has no wait sets, so programs cannot define waitables of their own.

    Args:
        callback_group: Decides when `run` may be called.
    """

    def call_on_wake(self, wake: Callable[[], object]) -> None:
        """Set the function to call when the waitable may have become ready."""
        self._wake = wake
