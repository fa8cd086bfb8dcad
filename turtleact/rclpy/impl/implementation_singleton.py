"""What some programs use of rclpy's extension module."""

from __future__ import annotations

from turtleact.rclpy.event_handler import (
    QoSPublisherEventType,
    QoSSubscriptionEventType,
    UnsupportedEventTypeError,
)
from turtleact.rclpy.exceptions import InvalidHandle, RCLError, UnknownROSArgsError
from turtleact.rclpy.impl.node_graph import NodeNameNonExistentError
from turtleact.rclpy.utilities import get_rmw_implementation_identifier

__all__ = ["rclpy_implementation"]


class rclpy_implementation:  # rclpy's name
    """Stands for the extension module."""

    InvalidHandle = InvalidHandle
    NodeNameNonExistentError = NodeNameNonExistentError
    RCLError = RCLError
    RCLInvalidROSArgsError = RCLError
    UnknownROSArgsError = UnknownROSArgsError
    UnsupportedEventTypeError = UnsupportedEventTypeError
    rcl_publisher_event_type_t = QoSPublisherEventType
    rcl_subscription_event_type_t = QoSSubscriptionEventType
    rclpy_get_rmw_implementation_identifier = staticmethod(get_rmw_implementation_identifier)
