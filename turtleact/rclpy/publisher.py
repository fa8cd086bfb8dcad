"""Publishers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from turtleact.rclpy.duration import Duration
from turtleact.rclpy.impl.connection import Connection
from turtleact.rclpy.impl.entity import Destroyable, Handle
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.messages.codec import encode
from turtleact.rclpy.qos import QoSProfile
from turtleact.transports.base import Endpoint

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup

__all__ = ["Publisher"]


class Publisher(Subscriptable, Destroyable):
    """Sends messages to a topic. `Node.create_publisher` makes a publisher.

    `publish` encodes a message before it returns, so you may change the message afterwards.

    Args:
        connection: The connection to the graph.
        endpoint: Describes the publisher on the graph.
        msg_type: The class of the messages.
        topic: The name of the topic, as it was given to `Node.create_publisher`.
        qos_profile: The quality of service.
        event_handlers: The waitables that call the callbacks for events of the publisher.
        callback_group: The callback group of these callbacks.
    """

    def __init__(
        self,
        connection: Connection,
        endpoint: Endpoint,
        msg_type: Anything,
        topic: str,
        qos_profile: QoSProfile,
        *,
        event_handlers: Sequence[Anything] = (),
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self._connection = connection
        self._sender = connection.advertise(endpoint)
        self._handle = Handle(self._sender.close)
        self._full_name = endpoint.name
        self.msg_type = msg_type
        self.topic = topic
        self.qos_profile = qos_profile
        self.event_handlers = event_handlers
        self.callback_group = callback_group

    @property
    def handle(self) -> Handle:
        """The handle, which shows whether the publisher may still be used."""
        return self._handle

    @property
    def topic_name(self) -> str:
        """The full name of the topic."""
        with self._handle:
            return self._full_name

    @property
    def logger_name(self) -> str:
        """The name of the topic, as it was given to `Node.create_publisher`."""
        return self.topic

    def publish(self, msg: Anything) -> None:
        """Send a message, or the bytes of an encoded message.

        Raises:
            TypeError: if the message is of another class, or a value does not fit its field.
            InvalidHandle: if the publisher was destroyed.
        """
        data = msg if isinstance(msg, bytes) else encode(msg, self.msg_type)
        self._handle.check()
        self._sender.publish(data)
        for each in self.event_handlers:
            each.noted()

    def get_subscription_count(self) -> int:
        """Return how many subscriptions the topic has."""
        with self._handle:
            return self._connection.count(self._full_name, "subscription")

    def assert_liveliness(self) -> None:
        """Show that the publisher is alive.

        This matters only for the publisher's own event callbacks. Other nodes do not notice it.
        """
        with self._handle:
            for each in self.event_handlers:
                each.noted(is_message=False)

    def wait_for_all_acked(self, timeout: Duration | None = None) -> bool:  # noqa: ARG002  # as in rclpy
        """Return True at once, without waiting for the subscriptions."""
        with self._handle:
            return True

    def destroy(self) -> None:
        """Destroy the publisher. A second call does nothing."""
        for each in self.event_handlers:
            each.destroy()
        self._handle.destroy_when_not_in_use()
