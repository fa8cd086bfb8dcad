"""Answers the requests of a service with a function, and publishes events about its calls.

The services of a node use this class, and so do the services that pause an action's goals.

- The server handles each request in its own task, so it can handle several at the same time.
- Every caller gets an answer: the response, or the reason why there is none.
- If a call in this process is cancelled, its handler is also cancelled. For a caller in
  another process, the handler is cancelled only when the client is closed or the process dies.
- If the server is closed, all handlers are cancelled.

Service introspection publishes each call on the topic ``SERVICE/_service_event``, as ROS 2 does.
Events are made from the calls of a service, not from the changes of an action's goals, because some
calls do not change any goal, such as a goal request that is rejected. The client and the server
each publish two of the four kinds of events:

=====================  ======================================
``REQUEST_SENT``       the client has sent a request
``REQUEST_RECEIVED``   the server has received the request
``RESPONSE_SENT``      the server has sent the response
``RESPONSE_RECEIVED``  the client has received the response
=====================  ======================================

Source: rclpy ``service.py`` for names and behaviour; rcl ``service_event_publisher.c``;
``service_msgs/msg/ServiceEventInfo``; REP 2012.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from functools import partial
from inspect import isasyncgenfunction, isawaitable, isgeneratorfunction, isroutine
from typing import Any, Generic, Literal, Protocol, TypeAlias, TypeVar, cast, get_args

import msgspec

from turtleact.errors import (
    STOPPED,
    InvalidMessage,
    InvalidOption,
    ServerUnavailable,
    ServiceError,
    summary,
)
from turtleact.interfaces import (
    Message,
    Service,
    WireFormat,
    snapshot,
    snapshotter,
    stamp_of,
)
from turtleact.interfaces.classes import event_message
from turtleact.interfaces.standard import ServiceEventInfo
from turtleact.names import event_topic
from turtleact.tasks import GRACE, Signal, Task, Tasks, is_cancellation, wait_while
from turtleact.transports.base import (
    CallObserver,
    Endpoint,
    MakeEndpoint,
    QoS,
    Reply,
    ServiceHandler,
    Transport,
)

__all__ = [
    "EVENT_QOS",
    "Introspection",
    "LocalServiceServer",
    "ServiceType",
    "checker",
    "service_events",
]

logger = logging.getLogger("turtleact.services")

Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)
ReqMade = TypeVar("ReqMade", bound=Message, covariant=True)
ResMade = TypeVar("ResMade", bound=Message, covariant=True)

Check: TypeAlias = Callable[[object], Message]

Introspection: TypeAlias = Literal["off", "metadata", "contents"]
"""Whether to publish nothing, only the metadata of each call, or also requests and responses."""

EVENT_QOS = QoS(depth=100)
"""The quality of service of the topic of events: reliable and volatile."""


class ServiceType(Protocol[ReqMade, ResMade]):
    """What type checkers need to know about a subclass of `turtleact.Service`."""

    @property
    def type_name(self) -> str:
        """The full name of the service type: ``pkg/srv/Name``."""

    def Request(self, *args: Any, **kwargs: Any) -> ReqMade:  # noqa: ANN401  # any arguments
        """Make a request message."""

    def Response(self, *args: Any, **kwargs: Any) -> ResMade:  # noqa: ANN401  # any arguments
        """Make a response message."""


class LocalServiceServer(ServiceHandler, Generic[Req, Res]):
    """Handles the requests of one service, from clients in this process and in others.

    Raises:
        InvalidOption: if the handler is not a function, or is a generator function.

    Attributes:
        name: The fully qualified name of the service.
        service_type: The service type.
        is_open: Whether the server accepts requests.
        observer: The observer that is told of each call; None if there is none.
    """

    def __init__(
        self,
        service_type: ServiceType[Req, Res],
        name: str,
        handler: Callable[[Req], Res | Awaitable[Res]],
        *,
        tasks: Tasks,
    ) -> None:
        self.name = name
        self.service_type = service_type
        self.is_open = True
        self.observer: CallObserver | None = None
        self._handler = _checked_handler(handler)
        self._check_request = checker(service_type.Request, "request")
        self._check_response = checker(service_type.Response, "response")
        self._tasks = tasks
        self._calls: dict[_Call, None] = {}  # in the order of arrival
        self._ended = tasks.signal()

    @property
    def is_idle(self) -> bool:
        """Whether no request is being handled."""
        return not self._calls

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Handle a request and return its response. ``caller`` is the gid of the client.

        If this call is cancelled, it cancels the handler and waits for the handler to end, for at
        most `GRACE` seconds.

        Raises:
            InvalidMessage: if the request does not fit the service. The handler is not called.
            ServerUnavailable: if the server is closed before it responds.
            ServiceError: if the handler fails.
        """
        if not self.is_open:
            raise self._closed()
        call = _Call(self._check_request(request), caller, self._tasks.signal())
        self._calls[call] = None
        call.task = self._tasks.spawn(self._run(call), f"a handler of {self.name}")
        try:
            while call.answer is None:
                await call.changed.wait()
        except self._tasks.cancelled:
            call.task.cancel()
            await wait_while(lambda: call in self._calls, call.changed, GRACE)
            raise
        if isinstance(call.answer, Exception):
            raise call.answer
        return Reply(call.answer)

    def caller_lost(self, caller: bytes) -> None:
        """Cancel the handlers of a client that has gone. ``caller`` is the client's gid."""
        for call in self._calls:
            if call.caller == caller and call.task is not None:
                call.task.cancel()

    async def aclose(self) -> None:
        """Stop accepting requests, answer every caller, and wait for the handlers to end.

        Callers get `ServerUnavailable` at once, and handlers are cancelled. If a handler has
        not ended after `GRACE` seconds, an error is logged, and the handler is left running.
        """
        self.is_open = False
        for call in self._calls:
            call.settle(self._closed())
            if call.task is not None:
                call.task.cancel()
        await wait_while(lambda: self._calls, self._ended, GRACE)
        for _ in self._calls:
            logger.error("a handler of service %s has not ended; it is left running", self.name)

    async def _run(self, call: _Call) -> None:
        """Handle a request and answer its caller. Raise only exceptions that stop the program."""
        try:
            response = self._handler(call.request)
            if isawaitable(response):
                response = await response
            call.settle(self._checked(response))
        except (KeyboardInterrupt, SystemExit):
            call.settle(ServiceError(self.name, STOPPED))
            raise
        except BaseException as error:
            call.settle(ServiceError(self.name, self._reason(error)))
        finally:
            del self._calls[call]
            call.changed.fire()
            self._ended.fire()

    def _checked(self, response: object) -> Message | ServiceError:
        try:
            return self._check_response(response)
        except InvalidMessage as misfit:
            logger.error("the handler of service %s gave no valid response: %s", self.name, misfit)
            return ServiceError(self.name, f"no valid response: {misfit}")

    def _reason(self, error: BaseException) -> str:
        """Describe a handler's exception for the caller.

        The exception is also logged, unless it is a cancellation.
        """
        if is_cancellation(error, self._tasks):
            return "the handler was canceled from within"
        logger.error("the handler of service %s failed", self.name, exc_info=error)
        return f"the handler failed: {summary(error)}"

    def _closed(self) -> ServerUnavailable:
        return ServerUnavailable(self.name, "the server was closed", kind="service")


class _Call(msgspec.Struct, eq=False):
    """One request and its answer.

    Attributes:
        request: A checked copy of the request.
        caller: The gid of the request's client.
        changed: A signal that fires when the call is answered, and when the handler has ended.
        answer: The response, or the error that the caller gets; None before.
        task: The task of the handler.
    """

    request: Message
    caller: bytes
    changed: Signal
    answer: Message | Exception | None = None
    task: Task | None = None

    def settle(self, answer: Message | Exception) -> None:
        """Set the response or the error, unless the call is answered already; wake the caller."""
        if self.answer is None:
            self.answer = answer
        self.changed.fire()


class ServiceEvents(CallObserver):
    """Publishes the events that one client or one server of a service sees.

    The topic exists from the beginning, because tools subscribe only to topics that they can see.
    An event is built only while the topic has subscribers.

    Args:
        transport: The transport that publishes the events.
        endpoint: A function that returns the description of an endpoint.
        service: The endpoint of the client or server whose calls are published.
        find_type: A function that returns the class of the service.
        now: Returns the time for the stamps (ns). None means the time of the graph's clock.
        has_contents: Whether to publish the requests and responses, too.
    """

    def __init__(
        self,
        transport: Transport,
        endpoint: MakeEndpoint,
        service: Endpoint,
        find_type: Callable[[], object],
        now: Callable[[], int] | None = None,
        *,
        has_contents: bool,
    ) -> None:
        self._has_contents = has_contents
        is_client = service.kind == "client"
        info = ServiceEventInfo
        self._request = info.REQUEST_SENT if is_client else info.REQUEST_RECEIVED
        self._response = info.RESPONSE_RECEIVED if is_client else info.RESPONSE_SENT
        self._now = transport.clock.now if now is None else now
        self._topic = event_topic(service.name)
        described = endpoint("publisher", self._topic, f"{service.type_name}_Event", EVENT_QOS)
        if service.on_demand:
            described = msgspec.structs.replace(described, on_demand=True)
        self._find_type = find_type
        self._requests = WireFormat(find_type)  # as the server reads them
        self._responses = WireFormat(find_type, asks=True)
        self._format = WireFormat(self._find_event)
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

    def _find_event(self) -> type[Message]:
        return event_message(cast("type[Service]", self._find_type()))

    def expect_readers(self) -> None:
        """Publish from now on, even if no reader is known yet."""
        self._publication.expect_readers()

    def close(self) -> None:
        """Close the publisher."""
        self._is_open = False
        self._publication.close()

    def _publish(self, kind: int, gid: bytes, sequence: int, message: object) -> None:
        """Publish an event. A failure is only logged, because it must not affect the call."""
        try:
            info = ServiceEventInfo(kind, stamp_of(self._now()), list(gid), sequence)
            event: Any = self._find_event()(info)
            if self._has_contents and kind == self._request:
                event.request = [_copied(self._requests, message)]
            elif self._has_contents:
                event.response = [_copied(self._responses, message)]
            if self._publication.has_object_readers:
                self._publication.publish(event)
            else:
                self._publication.send(self._format.encode(event))
        except Exception:
            logger.exception("an event of topic %s cannot be published", self._topic)


def _copied(format: WireFormat, message: object) -> Message:
    """Return a message that is encoded, or that somebody else may change."""
    if isinstance(message, bytes):
        return format.decode(message)
    return snapshot(cast("Message", message))


def service_events(
    transport: Transport,
    endpoint: MakeEndpoint,
    service: Endpoint,
    find_type: Callable[[], object],
    mode: Introspection,
) -> CallObserver | None:
    """Return the observer that publishes a service's events; None if the mode is "off".

    Args:
        transport: The transport to publish on.
        endpoint: A function that makes the description of the topic.
        service: The service endpoint whose calls are published.
        find_type: A function that returns the class of the service.
        mode: Which events to publish: "off", "metadata" or "contents".

    Raises:
        InvalidOption: if the mode does not exist.
    """
    if mode not in get_args(Introspection):
        words = ", ".join(get_args(Introspection))
        raise InvalidOption("introspection", f"expected one of {words}, not {mode!r}")
    if mode == "off":
        return None
    has_contents = mode == "contents"
    return ServiceEvents(transport, endpoint, service, find_type, has_contents=has_contents)


def _checked_handler(handler: object) -> Callable[[Message], object]:
    """Check that a handler is a function that can return a response."""
    if not callable(handler):
        raise InvalidOption("handler", f"expected a function, not {handler!r}")
    is_function = isroutine(handler) or isinstance(handler, partial | type)
    called = handler if is_function else type(handler).__call__
    if isasyncgenfunction(called) or isgeneratorfunction(called):
        raise InvalidOption("handler", "expected a function that returns a response; this yields")
    return cast("Callable[[Message], object]", handler)


def checker(make: Callable[..., Message], root: str) -> Check:
    """Return a function that checks and copies a request or response."""
    return cast("Check", snapshotter(cast("type[Message]", make), root=root))
