"""Service introspection: publishes the requests and responses of a service, as ROS 2 does.

`turtleact.introspection` describes the events and their topic. Here they have rclpy's message
classes, and the program may switch them on and off at any time.

Source: rclpy ``service_introspection.py``; rcl ``service_event_publisher.c``.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from enum import IntEnum
from typing import Protocol

from turtleact.rclpy.clock import Clock
from turtleact.rclpy.impl.connection import CallEvents, Connection, Sender
from turtleact.rclpy.impl.entity import Entity
from turtleact.rclpy.impl.rcutils_logger import RcutilsLogger
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.messages.classes import interface_class
from turtleact.rclpy.messages.codec import decode, encode, hash_of
from turtleact.rclpy.qos import QoSProfile
from turtleact.transports.base import Endpoint, EndpointKind

__all__ = ["Introspected", "ServiceEvents", "ServiceIntrospectionState"]

logger = RcutilsLogger("rclpy.service_introspection")


class ServiceIntrospectionState(IntEnum):
    """What is published: nothing, only who called when, or also the requests and responses."""

    OFF = 0
    METADATA = 1
    CONTENTS = 2


class Owner(Protocol):
    """The part of a node that this module uses."""

    @property
    def connection(self) -> Connection:
        """The graph."""

    def endpoint(
        self, kind: EndpointKind, name: str, type_name: str, qos: QoSProfile | None = None
    ) -> Endpoint:
        """Describe an endpoint of this node."""


class ServiceEvents(CallEvents):
    """Publishes the events of one end of a service, once `configure` has switched them on.

    Args:
        node: The node that has the end.
        service: The full name of the service.
        srv_type: The class of the service.
        is_client: Whether it is the client's end.
    """

    def __init__(self, node: Owner, service: str, srv_type: Anything, *, is_client: bool) -> None:
        self._node = node
        self._topic = f"{service}/_service_event"
        self._type = srv_type
        self._is_client = is_client
        self._lock = threading.Lock()
        self._clock: Clock | None = None
        self._sender: Sender | None = None
        self._has_contents = False
        self._is_closed = False

    @property
    def is_on(self) -> bool:
        """Whether events are published."""
        return self._sender is not None

    def configure(self, clock: Clock, qos: QoSProfile, state: ServiceIntrospectionState) -> None:
        """Choose what is published, the clock that times it, and its topic's quality of service."""
        sender = None
        if state != ServiceIntrospectionState.OFF:
            type_name = f"{self._type.type_name}_Event"
            end = self._node.endpoint("publisher", self._topic, type_name, qos)
            self._node.connection.wait_until_explored()  # so that a reader gets the first event
            sender = self._node.connection.advertise(end, hash_of(type_name))
        with self._lock:
            if self._is_closed:  # by another thread, while this one opened the topic
                before = sender
            else:
                before, self._sender, self._clock = self._sender, sender, clock
                self._has_contents = state == ServiceIntrospectionState.CONTENTS
        if before is not None:
            before.close()

    def requested(self, request: object, gid: bytes, sequence: int) -> None:
        """Publish that a request was sent or received."""
        kind = "REQUEST_SENT" if self._is_client else "REQUEST_RECEIVED"
        self._publish(kind, gid, sequence, request=request)

    def responded(self, response: object, gid: bytes, sequence: int) -> None:
        """Publish that a response was sent or received."""
        kind = "RESPONSE_RECEIVED" if self._is_client else "RESPONSE_SENT"
        self._publish(kind, gid, sequence, response=response)

    def close(self) -> None:
        """Leave the topic for good."""
        with self._lock:
            self._is_closed = True
            before, self._sender = self._sender, None
        if before is not None:
            before.close()

    def _publish(self, kind: str, gid: bytes, sequence: int, **shown: Anything) -> None:
        """Publish an event. A failure is logged, because it must not affect the call."""
        try:
            self._publish_unless_off(kind, gid, sequence, shown)
        except Exception as error:
            logger.error(f"an event of {self._topic} cannot be published: {error}")

    def _publish_unless_off(
        self, kind: str, gid: bytes, sequence: int, shown: dict[str, Anything]
    ) -> None:
        with self._lock:  # any thread may call this, and another one may configure meanwhile
            sender, clock, has_contents = self._sender, self._clock, self._has_contents
        if sender is None or clock is None or not sender.has_readers:
            return
        made: Anything = interface_class("service_msgs/msg/ServiceEventInfo")
        info = made(
            event_type=getattr(made, kind),
            stamp=clock.now().to_msg(),
            client_gid=list(gid),
            sequence_number=sequence,
        )
        event = self._type.Event(info=info)
        if has_contents:
            for part, data in shown.items():
                message_class = getattr(self._type, part.capitalize())
                setattr(event, part, [decode(data, message_class)])
        sender.publish(encode(event, type(event)))


class Introspected(Entity):
    """An entity with one end of a service, or of the three services of an action.

    Attributes:
        service_events: The events of each of these services.
    """

    service_events: Sequence[ServiceEvents]

    def configure_introspection(
        self,
        clock: Clock,
        service_event_qos_profile: QoSProfile,
        introspection_state: ServiceIntrospectionState,
    ) -> None:
        """Choose what is published about the calls of each service.

        Args:
            clock: Tells the times of the events.
            service_event_qos_profile: The quality of service of the topic
                ``SERVICE/_service_event``.
            introspection_state: What is published.

        Raises:
            InvalidHandle: if the entity was destroyed.
        """
        with self.handle:
            for each in self.service_events:
                each.configure(clock, service_event_qos_profile, introspection_state)
