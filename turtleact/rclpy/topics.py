"""Publishers and subscriptions, and the parameters that override their quality of service."""

from __future__ import annotations

import copy
import inspect
import time
from collections.abc import Callable, Iterable
from enum import Enum

from turtleact.errors import InvalidMessage
from turtleact.rclpy.exceptions import ParameterAlreadyDeclaredException
from turtleact.rclpy.impl.connection import Connection
from turtleact.rclpy.impl.entity import (
    NOTHING,
    Destroyable,
    EndSpec,
    QueueEntity,
    await_or_execute,
)
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.logging import RcutilsLogger
from turtleact.rclpy.messages import decode, encode, interface_class
from turtleact.rclpy.qos import QoSPolicyEnum, QoSPolicyKind, QoSProfile
from turtleact.rclpy.time import Duration

__all__ = [
    "InvalidQosOverridesError",
    "MessageInfo",
    "Publisher",
    "QoSOverridingOptions",
    "QosCallbackResult",
    "Subscription",
    "declare_qos_parameters",
]

logger = RcutilsLogger("rclpy.subscription")


class _TopicEnd(Subscriptable, Destroyable):
    """A publisher or subscription.

    Attributes:
        msg_type: The class of the messages.
        topic: The name of the topic, as the program gave it.
        qos_profile: The quality of service.
        callback_group: The callback group of the callbacks.
        event_handlers: The waitables that call the callbacks for events.
    """

    def _set_up(self, spec: EndSpec) -> None:
        self._connection: Connection = spec.node.connection
        self._full_name = spec.endpoint.name
        self.msg_type = spec.interface
        self.topic = spec.name
        self.qos_profile = spec.qos
        self.callback_group = spec.callback_group
        self.event_handlers = spec.events.create_event_handlers(
            spec.callback_group, spec.node, spec.endpoint
        )

    @property
    def topic_name(self) -> str:
        """The full name of the topic."""
        with self.handle:
            return self._full_name

    @property
    def logger_name(self) -> str:
        """The name of the topic, as the program gave it."""
        return self.topic

    def destroy(self) -> None:
        """Destroy the publisher or subscription. A second call does nothing."""
        for each in self.event_handlers:
            each.destroy()
        super().destroy()


class Publisher(_TopicEnd):
    """Sends messages to a topic. `Node.create_publisher` makes a publisher.

    `publish` encodes a message before it returns, so you may change the message afterwards.
    """

    def __init__(self, spec: EndSpec) -> None:
        self._set_up(spec)
        self._sender = self._connection.advertise(spec.endpoint)
        super().__init__(self._sender.close)

    def publish(self, msg: Anything) -> None:
        """Send a message, or the bytes of an encoded message.

        Raises:
            TypeError: if the message is of another class, or a value does not fit its field.
            InvalidHandle: if the publisher was destroyed.
        """
        data = msg if isinstance(msg, bytes) else encode(msg, self.msg_type)
        self.handle.check()
        self._sender.publish(data)
        for each in self.event_handlers:
            each.noted()

    def get_subscription_count(self) -> int:
        """Return how many subscriptions the topic has."""
        with self.handle:
            return self._connection.count(self._full_name, "subscription")

    def assert_liveliness(self) -> None:
        """Show that the publisher is alive.

        This matters only for the publisher's own event callbacks. Other nodes do not notice it.
        """
        with self.handle:
            for each in self.event_handlers:
                each.noted(is_message=False)

    def wait_for_all_acked(self, timeout: Duration | None = None) -> bool:  # noqa: ARG002  # as in rclpy
        """Return True at once, without waiting for the subscriptions."""
        with self.handle:
            return True


class MessageInfo(dict[str, Anything]):
    """When a message was received (ns since 1970).

    ``source_timestamp`` and ``received_timestamp`` have the same value.
    """


class Subscription(_TopicEnd, QueueEntity):
    """Receives the messages of a topic. `Node.create_subscription` makes a subscription.

    Received messages wait as bytes until the thread that runs the callback decodes them. If more
    messages wait than the profile's depth, the oldest are dropped.

    Args:
        spec: Describes the subscription.
        callback: Called with each message and, if it takes two arguments, a `MessageInfo`.
        raw: Whether the callback gets encoded messages (bytes).
    """

    class CallbackType(Enum):
        """Which arguments a callback takes."""

        MessageOnly = 0
        WithMessageInfo = 1

    def __init__(self, spec: EndSpec, callback: Anything, *, raw: bool = False) -> None:
        self.callback = callback
        self.raw = raw
        self._set_up(spec)
        QueueEntity.__init__(
            self,
            spec.callback_group,
            depth=spec.qos.kept,
            close=lambda: leave(),
            wake=spec.node.wake_executor,
        )
        # Latched messages come before this returns.
        leave = self._connection.subscribe(spec.endpoint, self._deliver)

    @property
    def callback(self) -> Anything:
        """The function that is called with each message."""
        return self._callback

    @callback.setter
    def callback(self, value: Anything) -> None:
        self._callback = value
        self._callback_type = _callback_type(value)

    def _deliver(self, data: bytes) -> None:
        """Queue a message for the callback. The transport may call this method in any thread."""
        for each in self.event_handlers:
            each.noted()
        self.put((data, time.time_ns()))

    def take(self) -> Anything:
        """Remove the oldest message that waits; return it and its `MessageInfo`."""
        item = super().take()
        if item is NOTHING:
            return NOTHING
        data, received = item
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
        is_plain = self._callback_type is self.CallbackType.MessageOnly
        await await_or_execute(self._callback, *(taken[:1] if is_plain else taken))

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return f"the subscription of {self._full_name}"

    def get_publisher_count(self) -> int:
        """Return how many publishers the topic has."""
        with self.handle:
            return self._connection.count(self._full_name, "publisher")


def _callback_type(callback: Anything) -> Subscription.CallbackType:
    """Return which arguments a callback gets.

    Raises:
        RuntimeError: if the callback takes neither one nor two arguments.
    """
    try:
        signature = inspect.signature(callback)
    except (TypeError, ValueError):  # a function of C has none
        return Subscription.CallbackType.MessageOnly
    for kind in Subscription.CallbackType:
        try:
            signature.bind(*range(kind.value + 1))
        except TypeError:
            continue
        return kind
    raise RuntimeError(
        "Subscription.__init__(): callback should be either be callable with one argument "
        "(to get only the message) or two (to get message and message info)"
    )


# --- quality of service from parameters -----------------------------------------------------------

QosCallbackResult: Anything = interface_class("rcl_interfaces/msg/SetParametersResult")

DEFAULT = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY)


class InvalidQosOverridesError(Exception):
    """The callback of `QoSOverridingOptions` has rejected a profile."""


class QoSOverridingOptions:
    """Which policies of a profile may be overridden by parameters.

    Args:
        policy_kinds: The policies that may be overridden.
        callback: Called with the overridden profile. The callback's result may reject the profile.
        entity_id: A part of the parameters' names, which distinguishes a node's endpoints of the
            same topic.
    """

    def __init__(
        self,
        policy_kinds: Iterable[QoSPolicyKind],
        *,
        callback: Callable[[QoSProfile], Anything] | None = None,
        entity_id: str | None = None,
    ) -> None:
        self.policy_kinds = tuple(policy_kinds)
        self.callback = callback
        self.entity_id = entity_id

    @classmethod
    def with_default_policies(cls, **options: Anything) -> QoSOverridingOptions:
        """Return options that let parameters override history, depth and reliability."""
        return cls(DEFAULT, **options)


def declare_qos_parameters(
    entity_type: type, node: Anything, topic: str, qos: QoSProfile, options: QoSOverridingOptions
) -> QoSProfile:
    """Declare a parameter for each policy. Return ``qos`` with the values of the parameters.

    Raises:
        InvalidQosOverridesError: if the callback rejects the profile.
    """
    kind = "publisher" if issubclass(entity_type, Publisher) else "subscription"
    suffix = f"_{options.entity_id}" if options.entity_id else ""
    found = copy.copy(qos)
    descriptor: Anything = interface_class("rcl_interfaces/msg/ParameterDescriptor")
    for policy in options.policy_kinds:
        if policy is QoSPolicyKind.LIFESPAN and kind == "subscription":
            continue
        policy_name = policy.name.lower()
        name = f"qos_overrides.{topic}.{kind}{suffix}.{policy_name}"
        try:
            default = _as_parameter(qos, policy)
            parameter = node.declare_parameter(name, default, descriptor(read_only=True))
        except ParameterAlreadyDeclaredException:
            parameter = node.get_parameter(name)
        setattr(found, policy_name, _as_policy(getattr(qos, policy_name), parameter.value))
    result = None if options.callback is None else options.callback(found)
    if result is not None and not result.successful:
        raise InvalidQosOverridesError(
            f"{topic} {kind}{suffix}: {result.reason or 'the overrides were refused'}"
        )
    return found


def _as_parameter(qos: QoSProfile, policy: QoSPolicyKind) -> str | int | bool:
    """Return a policy of a profile as the value of a parameter."""
    value: Anything = getattr(qos, policy.name.lower())
    if isinstance(value, QoSPolicyEnum):
        return value.short_key
    plain: int | bool = value.nanoseconds if isinstance(value, Duration) else value
    return plain


def _as_policy(current: Anything, given: Anything) -> Anything:
    """Return the value of a parameter as a policy of the same kind as ``current``."""
    if isinstance(current, QoSPolicyEnum):
        return type(current).get_from_short_key(given)
    return Duration(nanoseconds=given) if isinstance(current, Duration) else given


# rclpy's tests and a few programs use these by rclpy's private names.
_get_qos_policy_parameter = _as_parameter
_declare_qos_parameters = declare_qos_parameters
