"""Service introspection: publishes the requests and responses of a service, as ROS 2 does.

Each end of a service publishes on the topic ``SERVICE/_service_event``, with messages of the type
``SERVICE_TYPE_Event``. An action has three services, so it has three such topics at each end.

=====================  ======================================
``REQUEST_SENT``       the client has sent a request
``REQUEST_RECEIVED``   the server has received it
``RESPONSE_SENT``      the server has answered
``RESPONSE_RECEIVED``  the client has received the answer
=====================  ======================================

The events are made from the calls of a service, not from the observers of an action's goals. A
rejected goal, a cancel request that was refused, and a second request for a result change no goal,
and observers do not know the sequence numbers of requests.

The topic exists as soon as introspection is on, since tools subscribe only to topics that they can
see. A message is built only while somebody reads the topic.

Source: rcl ``service_event_publisher.c``; ``service_msgs/msg/ServiceEventInfo``; REP 2012.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast, get_args

import msgspec

from turtleact.errors import InvalidOption
from turtleact.interfaces import Service, WireFormat, snapshotter, stamp_of
from turtleact.interfaces.classes import event_message
from turtleact.interfaces.standard import ServiceEventInfo
from turtleact.transports.base import CallObserver, QoS

if TYPE_CHECKING:
    from turtleact.transports.base import Endpoint, MakeEndpoint, Transport

__all__ = ["EVENT_QOS", "Introspection", "ServiceEvents", "event_topic"]

logger = logging.getLogger("turtleact.services")

Introspection: TypeAlias = Literal["off", "metadata", "contents"]
"""What is published: nothing; only who called when; or also the requests and responses."""

EVENT_QOS = QoS(depth=100)
"""The quality of service of the topic: reliable and volatile."""


class ServiceEvents(CallObserver):
    """Publishes the events of one service at one end.

    Args:
        transport: The transport to open the topic on.
        endpoint: Makes descriptions of endpoints.
        service: The endpoint whose calls are published.
        find_type: Returns the class of the service.
        mode: "metadata" or "contents".

    Raises:
        InvalidOption: if the mode does not exist.
    """

    def __init__(
        self,
        transport: Transport,
        endpoint: MakeEndpoint,
        service: Endpoint,
        find_type: Callable[[], object],
        mode: Introspection,
    ) -> None:
        if mode not in get_args(Introspection):
            words = ", ".join(get_args(Introspection))
            raise InvalidOption("introspection", f"expected one of {words}, not {mode!r}")
        self._find_type = find_type
        self._has_contents = mode == "contents"
        is_client = service.kind == "client"
        info = ServiceEventInfo
        self._request = info.REQUEST_SENT if is_client else info.REQUEST_RECEIVED
        self._response = info.RESPONSE_RECEIVED if is_client else info.RESPONSE_SENT
        self._now = transport.clock.now
        self._topic = event_topic(service.name)
        described = endpoint("publisher", self._topic, f"{service.type_name}_Event", EVENT_QOS)
        if service.on_demand:
            described = msgspec.structs.replace(described, on_demand=True)
        format = WireFormat(self._message_type)
        self._publication = transport.advertise(described, format)

    def requested(self, request: object, gid: bytes, sequence: int) -> None:
        """Publish that a request has been sent or received."""
        if self._publication.has_readers:
            shown = [request] if self._has_contents else []
            self._publish(self._info(self._request, gid, sequence), shown, [])

    def responded(self, response: object, gid: bytes, sequence: int) -> None:
        """Publish that a response has been sent or received."""
        if self._publication.has_readers:
            shown = [response] if self._has_contents else []
            self._publish(self._info(self._response, gid, sequence), [], shown)

    def close(self) -> None:
        """Leave the topic."""
        self._publication.close()

    def _info(self, kind: int, gid: bytes, sequence: int) -> ServiceEventInfo:
        return ServiceEventInfo(kind, stamp_of(self._now()), list(gid), sequence)

    def _publish(self, info: ServiceEventInfo, request: list[Any], response: list[Any]) -> None:
        """Publish an event. A failure is logged, because it must not affect the call."""
        event_type: Any = self._message_type()
        try:
            event = event_type(info, request, response)
            if self._publication.has_near_readers:  # a handler may change its request later
                event = snapshotter(event_type)(event)
            self._publication.publish(event)
        except Exception:
            logger.exception("an event of topic %s cannot be published", self._topic)

    def _message_type(self) -> type[Any]:
        return event_message(cast("type[Service]", self._find_type()))


def event_topic(service: str) -> str:
    """Return the name of the topic with a service's events.

    >>> event_topic("/spawn")
    '/spawn/_service_event'
    """
    return f"{service}/_service_event"
