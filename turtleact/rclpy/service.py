"""Servers of services."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from turtleact.errors import InvalidMessage
from turtleact.rclpy.impl.connection import Connection, RequestHandler, Respond
from turtleact.rclpy.impl.entity import NOTHING, Entity
from turtleact.rclpy.impl.rcutils_logger import RcutilsLogger
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.messages.codec import decode, encode
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.service_introspection import Introspected, SwitchableEvents
from turtleact.transports.base import Endpoint

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup

__all__ = ["Service"]

logger = RcutilsLogger("rclpy.service")


class Service(Introspected, Subscriptable, Entity):
    """Answers the requests of a service. `Node.create_service` makes a service.

    Args:
        connection: The connection to the graph.
        endpoint: Describes the service on the graph.
        srv_type: The class of the service.
        srv_name: The name of the service, as it was given to `Node.create_service`.
        callback: Takes a request and an empty response, and returns a response.
        callback_group: Decides when the callback may run.
        qos_profile: The quality of service.
        events: Publishes the events of calls, once `configure_introspection` has switched them on.
        wake: Called when a request has come.
    """

    def __init__(
        self,
        connection: Connection,
        endpoint: Endpoint,
        srv_type: Anything,
        srv_name: str,
        callback: Anything,
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
        events: SwitchableEvents,
        *,
        wake: Callable[[], object] | None = None,
    ) -> None:
        self.srv_type = srv_type
        self.srv_name = srv_name
        self._full_name = endpoint.name
        self.callback = callback
        self.qos_profile = qos_profile
        self.service_events = (events,)
        self._waiting: deque[tuple[bytes, Respond]] = deque()
        super().__init__(callback_group, close=self._close, wake=wake)
        self._leave_graph = connection.serve(endpoint, RequestHandler(self._receive, events))

    @property
    def service_name(self) -> str:
        """The full name of the service."""
        with self.handle:
            return self._full_name

    def _receive(self, request: bytes, respond: Respond) -> None:
        self._waiting.append((request, respond))
        self.wake()

    def is_ready_now(self) -> bool:
        """Whether a request waits; False after `destroy`."""
        return bool(self._waiting) and not self._handle.is_destroyed

    def take(self) -> Anything:
        """Remove the oldest request that waits; return it and the function that answers it."""
        try:
            data, respond = self._waiting.popleft()
        except IndexError:
            return NOTHING
        try:
            return decode(data, self.srv_type.Request), respond
        except InvalidMessage as error:
            logger.error(f"a request to {self._full_name} cannot be read: {error}")
            respond(error, "")  # the transport counts the request as under way until its answer
            return NOTHING

    async def run(self, taken: tuple[Anything, Respond]) -> None:
        """Call the callback and send its response."""
        request, respond = taken
        response = self.callback(request, self.srv_type.Response())
        if inspect.iscoroutine(response):
            response = await response
        self.send_response(response, respond)

    def send_response(self, response: Anything, header: Callable[[bytes, str], object]) -> None:
        """Send a response.

        Raises:
            TypeError: if the response is of another class, or a value does not fit its field.
        """
        header(encode(response, self.srv_type.Response), "")

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return f"the service {self._full_name}"

    def _close(self) -> None:
        for each in self.service_events:
            each.close()
        self._leave_graph()
