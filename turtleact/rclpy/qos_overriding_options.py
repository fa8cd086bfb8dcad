"""Lets parameters override the quality of service of a publisher or subscription."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable

from turtleact.rclpy.duration import Duration
from turtleact.rclpy.exceptions import ParameterAlreadyDeclaredException
from turtleact.rclpy.impl.node_parameters import NodeParameters
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.publisher import Publisher
from turtleact.rclpy.qos import QoSPolicyEnum, QoSPolicyKind, QoSProfile

__all__ = [
    "InvalidQosOverridesError",
    "QoSOverridingOptions",
    "QosCallbackResult",
    "declare_qos_parameters",
]

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
    def with_default_policies(
        cls,
        *,
        callback: Callable[[QoSProfile], Anything] | None = None,
        entity_id: str | None = None,
    ) -> QoSOverridingOptions:
        """Return options that let parameters override history, depth and reliability."""
        return cls(DEFAULT, callback=callback, entity_id=entity_id)


def declare_qos_parameters(
    entity_type: type,
    node: NodeParameters,
    topic: str,
    qos: QoSProfile,
    options: QoSOverridingOptions,
) -> QoSProfile:
    """Declare a parameter for each policy. Return ``qos`` with the values of the parameters.

    Raises:
        InvalidQosOverridesError: if the callback rejects the profile.
    """
    is_publisher = issubclass(entity_type, Publisher)
    kind = "publisher" if is_publisher else "subscription"
    suffix = f"_{options.entity_id}" if options.entity_id else ""
    prefix = f"qos_overrides.{topic}.{kind}{suffix}"
    found = copy.copy(qos)
    descriptor: Anything = interface_class("rcl_interfaces/msg/ParameterDescriptor")
    for policy in options.policy_kinds:
        if policy is QoSPolicyKind.LIFESPAN and not is_publisher:
            continue
        name = f"{prefix}.{policy.name.lower()}"
        default = _parameter_of(qos, policy)
        try:
            parameter = node.declare_parameter(name, default, descriptor(read_only=True))
        except ParameterAlreadyDeclaredException:
            parameter = node.get_parameter(name)
        _override(found, policy, parameter.value)
    if options.callback is not None:
        result = options.callback(found)
        if not result.successful:
            raise InvalidQosOverridesError(
                f"{topic} {kind}{suffix}: {result.reason or 'the overrides were refused'}"
            )
    return found


def _parameter_of(qos: QoSProfile, policy: QoSPolicyKind) -> str | int | bool:
    """Return a policy of a profile as the value of a parameter."""
    value = getattr(qos, policy.name.lower())
    if isinstance(value, QoSPolicyEnum):
        return value.short_key
    if isinstance(value, Duration):
        return value.nanoseconds
    plain: int | bool = value
    return plain


def _override(qos: QoSProfile, policy: QoSPolicyKind, given: Anything) -> None:
    name = policy.name.lower()
    current = getattr(qos, name)
    if isinstance(current, QoSPolicyEnum):
        given = type(current).get_from_short_key(given)
    elif isinstance(current, Duration):
        given = Duration(nanoseconds=given)
    setattr(qos, name, given)


# rclpy's tests and a few programs use these by rclpy's private names.
_get_qos_policy_parameter = _parameter_of
_declare_qos_parameters = declare_qos_parameters
