"""Subscriptions."""

from __future__ import annotations

import inspect
import time
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from typing import TYPE_CHECKING

from turtleact.errors import InvalidMessage
from turtleact.rclpy.impl.connection import Connection
from turtleact.rclpy.impl.entity import NOTHING, Entity, Handle
from turtleact.rclpy.impl.rcutils_logger import RcutilsLogger
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.messages.codec import decode
from turtleact.rclpy.qos import QoSProfile
from turtleact.transports.base import Endpoint

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup

__all__ = ["MessageInfo", "Subscription"]

logger = RcutilsLogger("rclpy.subscription")


class MessageInfo(dict[str, Anything]):
    """When a message was received (ns since 1970).

    ``source_timestamp`` and ``received_timestamp`` have the same value.
    """


class Subscription(Subscriptable, Entity):
    """Receives the messages of a topic. `Node.create_subscription` makes a subscription.

    Received messages wait as bytes until the thread that runs the callback decodes them. If more
    messages wait than the profile's depth, the oldest are dropped.

    Args:
        connection: The connection to the graph.
        endpoint: Describes the subscription on the graph.
        msg_type: The class of the messages.
        topic: The name of the topic, as it was given to `Node.create_subscription`.
        callback: Called with each message and, if it takes two arguments, a `MessageInfo`.
        callback_group: Decides when the callback may run.
        qos_profile: The quality of service.
        raw: Whether the callback gets encoded messages (bytes).
        event_handlers: The waitables that call the callbacks for events of the subscription.
        wake: Called when a message has come.
    """

    class CallbackType(Enum):
        """Which arguments a callback takes."""

        MessageOnly = 0
        WithMessageInfo = 1

    def __init__(
        self,
        connection: Connection,
        endpoint: Endpoint,
        msg_type: Anything,
        topic: str,
        callback: Anything,
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
        *,
        raw: bool = False,
        event_handlers: Sequence[Anything] = (),
        wake: Callable[[], object] | None = None,
    ) -> None:
        self._connection = connection
        self._full_name = endpoint.name
        self.msg_type = msg_type
        self.topic = topic
        self.qos_profile = qos_profile
        self.raw = raw
        self.event_handlers = event_handlers
        self._waiting: deque[tuple[bytes, int]] = deque(maxlen=qos_profile.kept)
        self.callback = callback
        super().__init__(callback_group, wake=wake)
        self._handle = Handle(connection.subscribe(endpoint, self._deliver))

    @property
    def callback(self) -> Anything:
        """The function that is called with each message."""
        return self._callback

    @callback.setter
    def callback(self, value: Anything) -> None:
        self._callback = value
        self._callback_type = _callback_type(value)

    @property
    def topic_name(self) -> str:
        """The full name of the topic."""
        with self.handle:
            return self._full_name

    def _deliver(self, data: bytes) -> None:
        """Queue a message for the callback. The transport may call this method in any thread."""
        # A deque needs no lock: with a full one, appending drops the oldest message in one step.
        self._waiting.append((data, time.time_ns()))
        for each in self.event_handlers:
            each.noted()
        self.wake()

    def is_ready_now(self) -> bool:
        """Whether a message waits; False after `destroy`."""
        return bool(self._waiting) and not self._handle.is_destroyed

    def take(self) -> Anything:
        """Remove the oldest message that waits; return it and its `MessageInfo`."""
        try:
            data, received = self._waiting.popleft()
        except IndexError:
            return NOTHING
        info = MessageInfo(source_timestamp=received, received_timestamp=received)
        if self.raw:
            return data, info
        try:
            return decode(data, self.msg_type), info
        except InvalidMessage as error:
            logger.error(f"a message of {self._full_name} cannot be read: {error}")
            return NOTHING

    async def run(self, taken: tuple[Anything, MessageInfo]) -> None:
        """Call the callback with a message."""
        if self._callback_type is self.CallbackType.MessageOnly:
            result = self._callback(taken[0])
        else:
            result = self._callback(*taken)
        if inspect.iscoroutine(result):
            await result

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return f"the subscription of {self._full_name}"

    def get_publisher_count(self) -> int:
        """Return how many publishers the topic has."""
        with self.handle:
            return self._connection.count(self._full_name, "publisher")

    def destroy(self) -> None:
        """Destroy the subscription. A second call does nothing."""
        for each in self.event_handlers:
            each.destroy()
        super().destroy()


def _callback_type(callback: Anything) -> Subscription.CallbackType:
    """Return which arguments a callback gets.

    Raises:
        RuntimeError: if the callback takes neither one nor two arguments.
    """
    try:
        signature = inspect.signature(callback)
    except (TypeError, ValueError):  # a function of C has none
        return Subscription.CallbackType.MessageOnly
    for kind, arguments in (
        (Subscription.CallbackType.MessageOnly, (object(),)),
        (Subscription.CallbackType.WithMessageInfo, (object(), object())),
    ):
        try:
            signature.bind(*arguments)
        except TypeError:
            continue
        return kind
    raise RuntimeError(
        "Subscription.__init__(): callback should be either be callable with one argument "
        "(to get only the message) or two (to get message and message info)"
    )
