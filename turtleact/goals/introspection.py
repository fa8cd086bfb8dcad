"""Service introspection: publishes the requests and responses of a service, as ROS 2 does.

The client and the server of a service each publish events on the topic ``SERVICE/_service_event``,
with messages of the type ``SERVICE_TYPE_Event``. An action has three services, so its clients and
servers publish on three such topics. There are four kinds of events:

=====================  ======================================
``REQUEST_SENT``       the client has sent a request
``REQUEST_RECEIVED``   the server has received the request
``RESPONSE_SENT``      the server has sent the response
``RESPONSE_RECEIVED``  the client has received the response
=====================  ======================================

Events are made from the calls of a service, not from the changes of an action's goals, because some
calls do not change any goal. Examples are a goal request that is rejected, a cancel request that is
refused, and a second request for the same result. In addition, code that observes goals does not
know the sequence numbers of requests.

The topic exists as soon as introspection is on, because tools subscribe only to topics that they
can see. An event is built only while the topic has subscribers.

Source: rcl ``service_event_publisher.c``; ``service_msgs/msg/ServiceEventInfo``; REP 2012.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import msgspec

from turtleact.errors import InvalidOption
from turtleact.interfaces import EventFormat, WireFormat
from turtleact.interfaces.standard import ServiceEventInfo
from turtleact.names import event_topic
from turtleact.transports.base import CallObserver, QoS

if TYPE_CHECKING:
    from turtleact.transports.base import Endpoint, MakeEndpoint, Transport

__all__ = ["EVENT_QOS", "Introspection", "ServiceEvents"]

logger = logging.getLogger("turtleact.services")

Introspection: TypeAlias = Literal["off", "metadata", "contents"]
"""Whether to publish nothing, only the metadata of each call, or also requests and responses."""

EVENT_QOS = QoS(depth=100)
"""The quality of service of the topic: reliable and volatile."""


class ServiceEvents(CallObserver):
    """Publishes the events that one client or one server of a service sees.

    Args:
        transport: The transport that publishes the events.
        endpoint: A function that returns the description of an endpoint.
        service: The endpoint of the client or server whose calls are published.
        find_type: A function that returns the class of the service.
        mode: What is published: "metadata" (who called and when), or "contents" (also the requests
            and responses).

    Raises:
        InvalidOption: if the mode is unknown.
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
        self._format = EventFormat(find_type)
        self._encode_request = WireFormat(find_type, asks=True).encode
        self._encode_response = WireFormat(find_type).encode
        self._publication = transport.advertise(described, self._format)
        self._is_open = True

    def requested(self, request: object, gid: bytes, sequence: int) -> None:
        """Publish that a request has been sent or received."""
        if self._is_open and self._publication.has_readers:
            self._publish(self._request, gid, sequence, request)

    def responded(self, response: object, gid: bytes, sequence: int) -> None:
        """Publish that a response has been sent or received."""
        if self._is_open and self._publication.has_readers:
            self._publish(self._response, gid, sequence, response)

    def close(self) -> None:
        """Close the publisher."""
        self._is_open = False
        self._publication.close()

    def _publish(self, kind: int, gid: bytes, sequence: int, message: object) -> None:
        """Publish an event. A failure is only logged, because it must not affect the call."""
        try:
            contents: dict[str, bytes] = {}
            if self._has_contents:
                is_request = kind == self._request
                encode = self._encode_request if is_request else self._encode_response
                data = message if isinstance(message, bytes) else encode(message)
                contents["request" if is_request else "response"] = data
            info = self._format.info(kind, self._now(), gid, sequence)
            event = self._format.write(info, **contents)
            if self._publication.has_object_readers:
                self._publication.publish(self._format.decode(event))
            else:
                self._publication.send(event)
        except Exception:
            logger.exception("an event of topic %s cannot be published", self._topic)
