"""Events of publishers and subscriptions: matched, missed deadlines, lost liveliness.

turtleact's transports enforce no policy in time, so these events are found here: matching by
looking at the graph, deadlines by counting messages. Incompatible types and qualities of service
do not keep endpoints apart, as in rmw_zenoh, so the other events never happen.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

from turtleact.rclpy.callback_groups import CallbackGroup
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.waitable import Waitable

__all__ = [
    "EventHandler",
    "PublisherEventCallbacks",
    "QoSEventHandler",
    "QoSPublisherEventType",
    "QoSSubscriptionEventType",
    "SubscriptionEventCallbacks",
    "UnsupportedEventTypeError",
]


class UnsupportedEventTypeError(RuntimeError):
    """The middleware has no such event."""


class QoSPublisherEventType(IntEnum):
    """The events of a publisher."""

    RCL_PUBLISHER_OFFERED_DEADLINE_MISSED = 0
    RCL_PUBLISHER_LIVELINESS_LOST = 1
    RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS = 2
    RCL_PUBLISHER_INCOMPATIBLE_TYPE = 3
    RCL_PUBLISHER_MATCHED = 4


class QoSSubscriptionEventType(IntEnum):
    """The events of a subscription."""

    RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED = 0
    RCL_SUBSCRIPTION_LIVELINESS_CHANGED = 1
    RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS = 2
    RCL_SUBSCRIPTION_MESSAGE_LOST = 3
    RCL_SUBSCRIPTION_INCOMPATIBLE_TYPE = 4
    RCL_SUBSCRIPTION_MATCHED = 5


class EventHandler(Waitable):
    """Calls a callback for each event of one kind."""

    def __init__(
        self, callback_group: CallbackGroup, callback: Callable[[Anything], object]
    ) -> None:
        super().__init__(callback_group)
        self.callback = callback

    def is_ready(self, wait_set: object) -> bool:  # noqa: ARG002  # there is none
        """Whether an event waits."""
        return False

    def publisher_is_alive(self) -> None:
        """Record that the publisher asserts that it is alive."""


QoSEventHandler = EventHandler


class Watch:
    """The facts about an endpoint that its events depend on."""

    def counted(self, deliver: Callable[[bytes], None]) -> Callable[[bytes], None]:
        """Return a function that counts messages and passes them on."""
        return deliver


class _EventCallbacks:
    """The callbacks of the events of an endpoint."""

    def __init__(self, **callbacks: Anything) -> None:
        self.use_default_callbacks: bool = callbacks.pop("use_default_callbacks", True)
        for name in self._names():
            setattr(self, name, callbacks.pop(name, None))
        if callbacks:
            raise TypeError(f"unexpected keyword arguments: {', '.join(callbacks)}")

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        raise NotImplementedError

    def watch(self, *_: object) -> Watch:
        """Return the facts about an endpoint."""
        return Watch()

    def create_event_handlers(
        self, callback_group: CallbackGroup, watch: Watch, wake: Callable[[], object]
    ) -> list[EventHandler]:
        """Make a waitable for each callback."""
        del watch, wake
        found = (getattr(self, name) for name in self._names())
        return [EventHandler(callback_group, each) for each in found if each is not None]


class PublisherEventCallbacks(_EventCallbacks):
    """The callbacks of the events of a publisher, each with a keyword argument of its name."""

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return ("deadline", "liveliness", "incompatible_qos", "incompatible_type", "matched")


class SubscriptionEventCallbacks(_EventCallbacks):
    """The callbacks of the events of a subscription, each with a keyword argument of its name."""

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return (
            "deadline",
            "liveliness",
            "incompatible_qos",
            "message_lost",
            "incompatible_type",
            "matched",
        )
