"""Clients of services."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from turtleact.errors import ServerUnavailable, TurtleactError
from turtleact.rclpy.exceptions import ROSInterruptException
from turtleact.rclpy.impl.connection import CallEnd
from turtleact.rclpy.impl.entity import NOTHING, Entity
from turtleact.rclpy.impl.rcutils_logger import RcutilsLogger
from turtleact.rclpy.impl.typing import Anything, Subscriptable
from turtleact.rclpy.impl.waiting import wait_for_answer, wait_until
from turtleact.rclpy.messages.codec import decode, encode
from turtleact.rclpy.qos import QoSProfile
from turtleact.rclpy.service_introspection import Introspected
from turtleact.rclpy.task import Future

if TYPE_CHECKING:
    from turtleact.rclpy.callback_groups import CallbackGroup
    from turtleact.rclpy.context import Context

__all__ = ["Client"]

logger = RcutilsLogger("rclpy.client")


class Client(Introspected, Subscriptable, Entity):
    """Calls a service. Make a client with `Node.create_client`.

    Args:
        context: The context. If it is shut down, `call` and `wait_for_service` stop waiting.
        end: Sends the requests, and receives the responses.
        srv_type: The class of the service.
        srv_name: The name of the service, as the program gave it.
        full_name: The full name of the service.
        qos_profile: The quality of service.
        callback_group: Decides when a response may be handled.
        wake: Called when a response has arrived.
    """

    def __init__(
        self,
        context: Context,
        end: CallEnd,
        srv_type: Anything,
        srv_name: str,
        full_name: str,
        qos_profile: QoSProfile,
        callback_group: CallbackGroup,
        *,
        get_executor: Callable[[], Anything],
        wake: Callable[[], object] | None = None,
    ) -> None:
        self.context = context
        self.srv_type = srv_type
        self.srv_name = srv_name
        self._full_name = full_name
        self.qos_profile = qos_profile
        self._end = end
        self.service_events = (end.events,)
        self._get_executor = get_executor
        self._pending: dict[int, Future] = {}
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._sequence = 0
        self._lock = threading.Lock()
        super().__init__(callback_group, close=end.close, wake=wake)

    @property
    def service_name(self) -> str:
        """The full name of the service."""
        with self.handle:
            return self._full_name

    @property
    def logger_name(self) -> str:
        """The name for log messages: the service's name, in the form that the program used."""
        return self.srv_name

    def call(self, request: Anything, timeout_sec: float | None = None) -> Anything:
        """Send a request and wait for the response, while another thread spins the node.

        Raises:
            TypeError: if the request is not a ``srv_type.Request``, or if a value does not fit the
                type of its field.
            TimeoutError: if there is no response in time.
            ROSInterruptException: if the context is shut down before the response comes.
        """
        answered = threading.Event()
        future = self.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        # The callback would otherwise be another task of the executor that this call may block.
        what = f"call() of {self._full_name}"
        if not wait_for_answer(self, what, answered, self.context.ok, timeout_sec):
            self.remove_pending_request(future)
            raise TimeoutError if self.context.ok() else ROSInterruptException
        if future.exception() is not None:
            raise future.exception()  # type: ignore[misc]  # it is one
        return future.result()

    def call_async(self, request: Anything) -> Future:
        """Send a request, and return the future of the response.

        Raises:
            TypeError: if the request is not a ``srv_type.Request``, or if a value does not fit the
                type of its field.
        """
        data = encode(request, self.srv_type.Request)
        self._handle.check()
        future = Future(executor=None)
        with self._lock:
            self._sequence += 1
            number = self._sequence
            self._pending[number] = future
        future.add_done_callback(self.remove_pending_request)
        self._end.send(data, partial(self._answered, number), partial(self._failed, number))
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

    def is_ready_now(self) -> bool:
        """Whether a response waits to be handled."""
        return bool(self._waiting) and not self._handle.is_destroyed

    def take(self) -> Anything:
        """Return a response, with the number of its request; `NOTHING` if no response waits."""
        try:
            return self._waiting.popleft()
        except IndexError:
            return NOTHING

    async def run(self, taken: tuple[int, bytes]) -> None:
        """Set the result of the future that waits for the response."""
        number, data = taken
        with self._lock:
            future = self._pending.get(number)
        if future is not None and not future.done():
            # From now on the executor runs the done callbacks, not this thread.
            future.set_executor(self._get_executor())
            future.set_result(decode(data, self.srv_type.Response))

    def describe(self) -> str:
        """Return a description of this entity for a diagnostic message."""
        return f"the client of {self._full_name}"

    def _answered(self, number: int, data: bytes, note: str) -> None:  # noqa: ARG002  # no note
        self._waiting.append((number, data))
        self.wake()

    def _failed(self, number: int, error: TurtleactError) -> None:  # noqa: ARG002  # see below
        # As in ROS 2, the future is never done, whether there is no server or it has failed.
        if isinstance(error, ServerUnavailable):
            logger.debug(f"a request to {self._full_name} was lost: {error}")
        else:
            logger.error(f"{self._full_name} sends no response: {error}")
