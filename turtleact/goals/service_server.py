"""Answers the requests of a service with a function.

The services of a node use this class, and so do the services of an action that are called less
often. Clients in the same process call the server object directly (`LocalService`). Other clients
send their requests through a `turtleact.transports.base.Caller`.

- The server handles each request in its own task, so it can handle several at the same time.
- Every caller gets an answer: the response, or the reason why there is none.
- If a call in this process is cancelled, its handler is also cancelled. For a caller in
  another process, the handler is cancelled only when the client is closed or the process dies.
- If the server is closed, all handlers are cancelled.

Source: rclpy ``service.py`` for names and behaviour.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from inspect import isasyncgenfunction, isawaitable, isgeneratorfunction, isroutine
from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
    Protocol,
    TypeAlias,
    TypeVar,
    cast,
    runtime_checkable,
)

from turtleact.errors import (
    STOPPED,
    InvalidMessage,
    InvalidOption,
    ServerUnavailable,
    ServiceError,
    TurtleactError,
    summary,
)
from turtleact.interfaces import Message, snapshotter
from turtleact.tasks import GRACE, Signal, Task, Tasks, is_cancellation, wait_while
from turtleact.transports.base import (
    CallObserver,
    Endpoint,
    MakeEndpoint,
    Reply,
    ServiceHandler,
    Transport,
)

if TYPE_CHECKING:
    from turtleact.goals.introspection import Introspection

__all__ = [
    "LocalService",
    "LocalServiceServer",
    "ServiceType",
    "checker",
    "closed_on_error",
    "service_events",
]

logger = logging.getLogger("turtleact.services")

Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)
ReqMade = TypeVar("ReqMade", bound=Message, covariant=True)
ResMade = TypeVar("ResMade", bound=Message, covariant=True)

Check: TypeAlias = Callable[[object], Message]


class ServiceType(Protocol[ReqMade, ResMade]):
    """What type checkers need to know about a subclass of `turtleact.Service`."""

    @property
    def type_name(self) -> str:
        """The full name of the service type: ``pkg/srv/Name``."""

    def Request(self, *args: Any, **kwargs: Any) -> ReqMade:  # noqa: ANN401  # any arguments
        """Make a request message."""

    def Response(self, *args: Any, **kwargs: Any) -> ResMade:  # noqa: ANN401  # any arguments
        """Make a response message."""


@runtime_checkable
class LocalService(Protocol):
    """The part of `LocalServiceServer` that clients in the same process use."""

    is_open: bool
    observer: CallObserver | None

    async def answer(self, request: object) -> object:
        """Handle a request and return its response."""


class LocalServiceServer(ServiceHandler, Generic[Req, Res]):
    """Handles the requests of one service, from clients in this process and in others.

    Transports, and clients in the same process, call this object.

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

    async def answer(self, request: object, caller: bytes = b"") -> Res:
        """Handle a request and return its response.

        ``caller`` is the gid of the client if it is in another process, and empty otherwise.
        If this call is cancelled, it cancels the handler and waits for the handler to end, for at
        most `GRACE` seconds.

        Raises:
            InvalidMessage: if the request does not fit the service. The handler is not called.
            ServerUnavailable: if the server is closed before it responds.
            ServiceError: if the handler fails.
        """
        if not self.is_open:
            raise self._closed()
        call = _Call(self._check_request(request), self._tasks.signal(), caller)
        self._calls[call] = None
        call.task = self._tasks.spawn(self._run(call), f"a handler of {self.name}")
        try:
            while not call.outcome.done():
                await call.changed.wait()
        except self._tasks.cancelled:
            call.cancel()
            await wait_while(lambda: not call.has_ended, call.changed, GRACE)
            raise
        return cast("Res", call.outcome.result())

    async def reply(self, request: object, caller: bytes) -> Reply:
        """Answer a request from another process with the response that `answer` returns."""
        return Reply(await self.answer(request, caller))

    def caller_lost(self, caller: bytes) -> None:
        """Cancel the handlers of a client that has gone. ``caller`` is the client's gid."""
        for call in self._calls:
            if call.caller == caller:
                call.cancel()

    async def aclose(self) -> None:
        """Stop accepting requests, answer every caller, and wait for the handlers to end.

        Callers get `ServerUnavailable` at once, and handlers are cancelled. If a handler has
        not ended after `GRACE` seconds, an error is logged, and the handler is left running.
        """
        self.is_open = False
        for call in self._calls:
            call.answer(error=self._closed())
            call.cancel()
        await wait_while(lambda: self._calls, self._ended, GRACE)
        for _ in self._calls:
            logger.error("a handler of service %s has not ended; it is left running", self.name)

    async def _run(self, call: _Call) -> None:
        """Handle a request and answer its caller. Raise only exceptions that stop the program."""
        if call.is_canceled:  # before the task took its first step
            self._end(call, error=self._closed())
            return
        try:
            response = self._handler(call.request)
            if isawaitable(response):
                response = await response
        except (KeyboardInterrupt, SystemExit):
            self._end(call, error=ServiceError(self.name, STOPPED))
            raise
        except BaseException as error:
            self._end(call, error=ServiceError(self.name, self._reason(error)))
            return
        try:
            checked = self._check_response(response)
        except InvalidMessage as misfit:
            logger.error("the handler of service %s gave no valid response: %s", self.name, misfit)
            self._end(call, error=ServiceError(self.name, f"no valid response: {misfit}"))
        else:
            self._end(call, checked)

    def _reason(self, error: BaseException) -> str:
        """Describe a handler's exception for the caller.

        The exception is also logged, unless it is a cancellation.
        """
        if is_cancellation(error, self._tasks):
            return "the handler was canceled from within"
        logger.error("the handler of service %s failed", self.name, exc_info=error)
        return f"the handler failed: {summary(error)}"

    def _end(
        self, call: _Call, response: object = None, *, error: TurtleactError | None = None
    ) -> None:
        del self._calls[call]
        call.has_ended = True
        call.answer(response, error=error)
        self._ended.fire()

    def _closed(self) -> ServerUnavailable:
        return ServerUnavailable(self.name, "the server was closed", kind="service")


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
    if mode == "off":
        return None
    from turtleact.goals.introspection import ServiceEvents  # few programs need it

    return ServiceEvents(transport, endpoint, service, find_type, mode)


@contextmanager
def closed_on_error(events: CallObserver | None) -> Iterator[CallObserver | None]:
    """Close a service's event publisher if the block raises, or its topic would stay."""
    try:
        yield events
    except BaseException:
        if events is not None:
            events.close()
        raise


class _Call:
    """One request and its outcome.

    Attributes:
        request: A checked copy of the request.
        caller: The gid of the request's client in another process; empty for a client in this
            process.
        changed: A signal that fires when the call is answered, and when the handler has ended.
        outcome: The response, or the error that the caller gets.
        is_canceled: Whether `cancel` was called.
        has_ended: Whether the handler has ended.
        task: The task of the handler.
    """

    __slots__ = ("caller", "changed", "has_ended", "is_canceled", "outcome", "request", "task")

    def __init__(self, request: Message, changed: Signal, caller: bytes = b"") -> None:
        self.request = request
        self.caller = caller
        self.changed = changed
        self.outcome = Future[object]()
        self.is_canceled = False
        self.has_ended = False
        self.task: Task | None = None

    def cancel(self) -> None:
        """Cancel the handler at its next await."""
        self.is_canceled = True
        if self.task is not None:
            self.task.cancel()

    def answer(self, response: object = None, *, error: TurtleactError | None = None) -> None:
        """Set the answer, unless the call has one already, and wake the caller."""
        if not self.outcome.done():
            if error is None:
                self.outcome.set_result(response)
            else:
                self.outcome.set_exception(error)
        self.changed.fire()


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
