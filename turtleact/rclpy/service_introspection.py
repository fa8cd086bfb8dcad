"""Service introspection: publishes the requests and responses of a service, as ROS 2 does.

`turtleact.goals.introspection` describes the events and their topic. A program with rclpy may
switch the events on and off at any time.

Source: rclpy ``service_introspection.py``; rcl ``service_event_publisher.c``.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from enum import IntEnum

from turtleact.interfaces import EventFormat, get_interface
from turtleact.interfaces.standard import ServiceEventInfo as Info
from turtleact.names import event_topic
from turtleact.rclpy.clock import Clock
from turtleact.rclpy.impl.connection import CallEvents, Sender
from turtleact.rclpy.impl.entity import Entity
from turtleact.rclpy.impl.rcutils_logger import RcutilsLogger
from turtleact.rclpy.impl.typing import Anything
from turtleact.rclpy.qos import QoSProfile

__all__ = ["Introspected", "ServiceIntrospectionState", "SwitchableEvents"]

logger = RcutilsLogger("rclpy.service_introspection")


class ServiceIntrospectionState(IntEnum):
    """What is published about each call.

    With ``OFF``, nothing is published. With ``METADATA``, the caller and the time are published.
    With ``CONTENTS``, the request and the response are published, too.
    """

    OFF = 0
    METADATA = 1
    CONTENTS = 2


class SwitchableEvents(CallEvents):
    """Publishes the events of a client or server, once `configure` has switched them on.

    Args:
        node: The node of the client or server.
        service: The full name of the service.
        srv_type: The class of the service.
        is_client: Whether the events are those of a client.
    """

    def __init__(
        self, node: Anything, service: str, srv_type: Anything, *, is_client: bool
    ) -> None:
        self._node = node
        self._topic = event_topic(service)
        self._type_name = srv_type.type_name
        self._format = EventFormat(lambda: get_interface(srv_type.type_name))
        self._is_client = is_client
        self._lock = threading.Lock()
        self._clock: Clock | None = None
        self._sender: Sender | None = None
        self._has_contents = False

    @property
    def is_on(self) -> bool:
        """Whether events are published."""
        return self._sender is not None

    def configure(self, clock: Clock, qos: QoSProfile, state: ServiceIntrospectionState) -> None:
        """Choose what to publish, the clock for the stamps, and the topic's quality of service."""
        sender = None
        if state != ServiceIntrospectionState.OFF:
            end = self._node.endpoint("publisher", self._topic, f"{self._type_name}_Event", qos)
            self._node.connection.wait_until_explored()  # so that a reader gets the first event
            sender = self._node.connection.advertise(end)
        with self._lock:
            before, self._sender, self._clock = self._sender, sender, clock
            self._has_contents = state == ServiceIntrospectionState.CONTENTS
        if before is not None:
            before.close()

    def requested(self, request: object, gid: bytes, sequence: int) -> None:
        """Publish that a request was sent or received."""
        kind = Info.REQUEST_SENT if self._is_client else Info.REQUEST_RECEIVED
        self._publish(kind, gid, sequence, request=request)

    def responded(self, response: object, gid: bytes, sequence: int) -> None:
        """Publish that a response was sent or received."""
        kind = Info.RESPONSE_RECEIVED if self._is_client else Info.RESPONSE_SENT
        self._publish(kind, gid, sequence, response=response)

    def close(self) -> None:
        """Close the topic."""
        with self._lock:
            before, self._sender = self._sender, None
        if before is not None:
            before.close()

    def _publish(self, kind: int, gid: bytes, sequence: int, **shown: Anything) -> None:
        """Publish an event. If this fails, only log the error, so that the call is not affected."""
        with self._lock:  # any thread may call this, and another one may configure meanwhile
            sender, clock, has_contents = self._sender, self._clock, self._has_contents
        if sender is None or clock is None or not sender.has_readers:
            return
        try:
            info = self._format.info(kind, clock.now().nanoseconds, gid, sequence)
            sender.publish(self._format.write(info, **(shown if has_contents else {})))
        except Exception as error:
            logger.error(f"an event of {self._topic} cannot be published: {error}")


class Introspected(Entity):
    """A client or server of a service, or of an action with its three services.

    Attributes:
        service_events: One `SwitchableEvents` for each of these services.
    """

    service_events: Sequence[Anything]

    def configure_introspection(
        self,
        clock: Clock,
        service_event_qos_profile: QoSProfile,
        introspection_state: ServiceIntrospectionState,
    ) -> None:
        """Choose what is published about the calls of each service.

        Args:
            clock: The clock for the stamps of the events.
            service_event_qos_profile: The quality of service of the topic
                ``SERVICE/_service_event``.
            introspection_state: What to publish.

        Raises:
            InvalidHandle: if the entity was destroyed.
        """
        with self.handle:
            for each in self.service_events:
                each.configure(clock, service_event_qos_profile, introspection_state)
