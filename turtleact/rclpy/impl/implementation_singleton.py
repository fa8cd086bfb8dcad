"""Provides the names that some programs import from rclpy's C extension module."""

from __future__ import annotations

from turtleact.rclpy import qos
from turtleact.rclpy.event_handler import (
    QoSPublisherEventType,
    QoSSubscriptionEventType,
    UnsupportedEventTypeError,
)
from turtleact.rclpy.exceptions import InvalidHandle, RCLError, UnknownROSArgsError
from turtleact.rclpy.impl.node_graph import NodeNameNonExistentError
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.utilities import get_rmw_implementation_identifier

__all__ = ["rclpy_implementation"]


class rmw_qos_profile_t:
    """Replaces rclpy's class of the same name, which has the predefined QoS profiles."""

    @staticmethod
    def predefined(name: str) -> QoSProfile:
        """Return the profile with a name such as ``qos_profile_default``."""
        found: QoSProfile = getattr(qos, name)
        return found


class rclpy_implementation:  # rclpy's name
    """Replaces the extension module of rclpy."""

    InvalidHandle = InvalidHandle
    NodeNameNonExistentError = NodeNameNonExistentError
    RCLError = RCLError
    RCLInvalidROSArgsError = RCLError
    UnknownROSArgsError = UnknownROSArgsError
    UnsupportedEventTypeError = UnsupportedEventTypeError
    rmw_qos_profile_t = rmw_qos_profile_t
    rcl_publisher_event_type_t = QoSPublisherEventType
    rcl_subscription_event_type_t = QoSSubscriptionEventType
    rclpy_get_rmw_implementation_identifier = staticmethod(get_rmw_implementation_identifier)
