"""Clients and servers of services, and the introspection of their calls.

`turtleact.goals.service_server` describes the events of the introspection and their topic. A
program with rclpy may switch the events on and off at any time.

Source: rclpy ``client.py``, ``service.py`` and ``service_introspection.py``; rcl
``service_event_publisher.c``.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from enum import IntEnum
from functools import partial

from turtleact.errors import InvalidMessage, ServerUnavailable, TurtleactError
from turtleact.rclpy.clock import Clock
from turtleact.rclpy.exceptions import ROSInterruptException
from turtleact.rclpy.impl.connection import CallEnd, Respond, ServiceEnd
from turtleact.rclpy.impl.entity import (
    NOTHING,
    EndSpec,
    Entity,
    QueueEntity,
    await_or_execute,
    wait_for_answer,
    wait_until,
)
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.logging import RcutilsLogger
from turtleact.rclpy.messages import decode, encode
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.task import Future
from turtleact.transports.base import Reply

__all__ = ["Client", "Introspected", "Service", "ServiceIntrospectionState"]

logger = RcutilsLogger("rclpy.service")


class ServiceIntrospectionState(IntEnum):
    """What is published about each call.

    With ``OFF``, nothing is published. With ``METADATA``, the caller and the time are published.
    With ``CONTENTS``, the request and the response are published, too.
    """

    OFF = 0
    METADATA = 1
    CONTENTS = 2


class Introspected(Entity):
    """A client or server of a service, or of an action with its three services.

    Attributes:
        ends: The end of each of these services.
    """

    ends: Sequence[CallEnd | ServiceEnd]

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
            mode: Anything = introspection_state.name.lower()
            for each in self.ends:
                each.events.configure(mode, clock.now_ns, service_event_qos_profile)


class _ServiceEnd(Introspected, Subscriptable, QueueEntity):
    """A client or server of a service.

    Args:
        spec: Describes the client or server.
    """

    def __init__(self, spec: EndSpec) -> None:
        super().__init__(spec.callback_group, close=self._close, wake=spec.node.wake_executor)
        self._full_name = spec.endpoint.name
        self.srv_type = spec.interface
        self.srv_name = spec.name
        self.qos_profile = spec.qos

    @property
    def service_name(self) -> str:
        """The full name of the service."""
        with self.handle:
            return self._full_name

    @property
    def logger_name(self) -> str:
        """The name of the service, as the program gave it."""
        return self.srv_name

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return f"the {type(self).__name__.lower()} of {self._full_name}"

    def _close(self) -> None:
        for end in self.ends:
            end.close()


class Client(_ServiceEnd):
    """Calls a service. Make a client with `Node.create_client`.

    Args:
        spec: Describes the client.
    """

    def __init__(self, spec: EndSpec) -> None:
        super().__init__(spec)
        self.context = spec.node.context
        self._node = spec.node
        self._end = CallEnd(spec.node.connection, spec.endpoint)
        self.ends = (self._end,)
        self._pending: dict[int, Future] = {}
        self._sequence = 0
        self._lock = threading.Lock()

    def call(self, request: Anything, timeout_sec: float | None = None) -> Anything:
        """Send a request and wait for the response, while another thread spins the node.

        Raises:
            TypeError: if the request is not a ``srv_type.Request``, or if a value does not fit the
                type of its field.
            TimeoutError: if there is no response in time.
            ROSInterruptException: if the context is shut down before the response comes.
        """
        future = self.call_async(request)
        what = f"call() of {self._full_name}"
        if not wait_for_answer(self, what, future, self.context.ok, timeout_sec):
            self.remove_pending_request(future)
            raise TimeoutError if self.context.ok() else ROSInterruptException
        return future.result()

    def call_async(self, request: Anything) -> Future:
        """Send a request, and return the future of the response.

        If no response comes, the future is never done, as in ROS 2.

        Raises:
            TypeError: if the request is not a ``srv_type.Request``, or if a value does not fit the
                type of its field.
        """
        data = encode(request, self.srv_type.Request)
        self.handle.check()
        future = Future(executor=None)
        with self._lock:
            self._sequence += 1
            number = self._sequence
            self._pending[number] = future
        future.add_done_callback(self.remove_pending_request)
        self._end.send(data, partial(self._answered, number))
        return future

    def get_pending_request(self, sequence_number: int) -> Future:
        """Return the future of a request. Raises KeyError if the request is not pending."""
        with self._lock:
            return self._pending[sequence_number]

    def remove_pending_request(self, future: Future) -> None:
        """Forget the request of a future.

        If the future is not done yet, it will never be done.
        """
        with self._lock:
            for number, pending in self._pending.items():
                if pending is future:
                    del self._pending[number]
                    break

    def service_is_ready(self) -> bool:
        """Whether a call would reach a server now."""
        with self.handle:
            return self._end.is_served

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Wait, without spinning, until the service has a server.

        Return whether the service has a server.
        """
        return wait_until(self.service_is_ready, timeout_sec, self.context.ok)

    async def run(self, taken: tuple[int, bytes]) -> None:
        """Set the result of the future that waits for the response."""
        number, data = taken
        with self._lock:
            future = self._pending.get(number)
        if future is not None and not future.done():
            # From now on the executor runs the done callbacks, not this thread.
            future.set_executor(self._node.executor)
            future.set_result(decode(data, self.srv_type.Response))

    def _answered(self, number: int, reply: Reply | TurtleactError) -> None:
        if isinstance(reply, Reply):
            self.put((number, reply.message))
        elif isinstance(reply, ServerUnavailable):
            logger.debug(f"a request to {self._full_name} was lost: {reply}")
        else:
            logger.error(f"{self._full_name} sends no response: {reply}")


class Service(_ServiceEnd):
    """Answers the requests of a service. `Node.create_service` makes a service.

    Args:
        spec: Describes the service.
        callback: Takes a request and an empty response, and returns a response.
    """

    def __init__(self, spec: EndSpec, callback: Anything) -> None:
        super().__init__(spec)
        self.callback = callback
        self.ends = (ServiceEnd(spec.node.connection, spec.endpoint, self._receive),)

    def _receive(self, request: bytes, respond: Respond) -> None:
        self.put((request, respond))

    def take(self) -> Anything:
        """Remove the oldest request that waits; return it and the function that answers it."""
        item = super().take()
        if item is NOTHING:
            return NOTHING
        data, respond = item
        try:
            return decode(data, self.srv_type.Request), respond
        except InvalidMessage as error:
            logger.error(f"a request to {self._full_name} cannot be read: {error}")
            respond(error)  # the transport counts the request as under way until its answer
            return NOTHING

    async def run(self, taken: tuple[Anything, Respond]) -> None:
        """Call the callback and send its response."""
        request, respond = taken
        response = await await_or_execute(self.callback, request, self.srv_type.Response())
        self.send_response(response, respond)

    def send_response(self, response: Anything, header: Respond) -> None:
        """Send a response.

        Raises:
            TypeError: if the response is of another class, or a value does not fit its field.
        """
        header(Reply(encode(response, self.srv_type.Response)))
