"""The services of a node: servers that answer requests, and clients that send them.

`turtleact.goals.service_server` handles requests. A client in the same process calls the server
object directly. Other clients send their requests through a `turtleact.transports.base.Caller`.

Source: rclpy ``service.py`` and ``client.py`` for names and behaviour.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar, cast

from turtleact.errors import ServerUnavailable, ServiceTimeout
from turtleact.goals.service_server import LocalServiceServer, ServiceType, checker
from turtleact.interfaces import Message
from turtleact.tasks import Tasks
from turtleact.tasks.clock import check_timeout, within
from turtleact.transports.base import (
    Caller,
    Closeable,
    Owner,
    Transport,
    find_server,
    wait_until_served,
)

__all__ = ["ServiceClient", "ServiceServer", "ServiceType"]

Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)


class ServiceServer(Generic[Req, Res]):
    """Answers the requests of one service. `turtleact.Node.service` makes one.

    Attributes:
        name: The fully qualified name of the service.
        service_type: The service type.
    """

    def __init__(
        self, local: LocalServiceServer[Req, Res], owner: Owner, registration: Closeable
    ) -> None:
        self.name = local.name
        self.service_type = local.service_type
        self._local = local
        self._membership = owner.add(self, registration.close, "service server")

    @property
    def is_open(self) -> bool:
        """Whether the server accepts requests."""
        return self._local.is_open

    @property
    def is_idle(self) -> bool:
        """Whether no request is being handled."""
        return self._local.is_idle

    async def aclose(self) -> None:
        """Stop accepting requests, answer every caller, and wait for the handlers to end.

        Callers get `ServerUnavailable` at once, and handlers are cancelled. If a handler has
        not ended after 5 seconds, an error is logged, and the handler is left running. A handler of
        this server must not await this method.
        """
        self._local.is_open = False
        self._membership.close()
        await self._local.aclose()
        if self._local.observer is not None:
            self._local.observer.close()


class ServiceClient(Generic[Req, Res]):
    """Calls one service. `turtleact.Node.service_client` makes one.

    Attributes:
        name: The fully qualified name of the service.
        service_type: The service type.
        find_difference: Names the first field that the servers define differently; empty if they do
            not.
    """

    find_difference: Callable[[], Awaitable[str]]

    def __init__(
        self,
        service_type: ServiceType[Req, Res],
        name: str,
        transport: Transport,
        caller: Caller,
        owner: Owner,
        tasks: Tasks,
    ) -> None:
        self.name = name
        self.service_type = service_type
        self._transport = transport
        self._caller = caller
        self._membership = owner.add(self, caller.close)
        self._home = owner.home.of(f"the client of service '{name}'")
        self._tasks = tasks
        self._is_open = True
        self._calls = 0  # under way
        self._check_request = checker(service_type.Request, "request")

    async def call(self, request: Req, timeout: float | None = None) -> Res:
        """Send a request and wait for its response.

        The request and the response are checked and copied. Any number of calls may run at the same
        time.

        Cancelling: cancels the handler if it is in this process, and waits at most 5 seconds for
        its end. A handler in another process continues until this client is closed, because ROS 2
        cannot cancel a request.

        Args:
            request: The request message.
            timeout: How long to wait for the response (s, by the graph's clock). After that time,
                the call is cancelled. If left out, there is no limit; with 0 or less, the call does
                not wait at all.

        Raises:
            InvalidOption: if ``timeout`` is not a number. Nothing was sent.
            InvalidMessage: if a value does not fit its type. Nothing was sent.
            ServerUnavailable: if nobody serves the service, or its server is closed before it
                responds. See `open_zenoh` for how long the call looks for servers in other
                processes.
            ServiceError: if the handler failed. The server's log has the traceback.
            ServiceTimeout: if there was no response within ``timeout``.
        """
        self._home.check()
        check_timeout(timeout)
        await self._tasks.checkpoint()  # so that calls in a loop let other tasks run
        if timeout is None:
            return cast("Res", await self._answer(request))
        async with within(timeout, self._transport.clock):
            return cast("Res", await self._answer(request))
        raise ServiceTimeout(self.name, timeout)

    async def wait_for_service(self, timeout: float | None = None) -> bool:
        """Wait until a server exists for the service. Cancelling: safe.

        Args:
            timeout: How long to wait (s, by the graph's clock). If left out, there is no limit.

        Returns:
            Whether the service has a server.

        Raises:
            InvalidOption: if ``timeout`` is not a number.
        """
        self._home.check()
        return await wait_until_served(self._transport, self._find, timeout)

    async def aclose(self) -> None:
        """Close the client without waiting for calls under way.

        Calls under way continue. The client leaves the graph when all its calls have ended.
        """
        self._is_open = False
        self._membership.close()
        self._close_observer()

    def _close_observer(self) -> None:
        """Close the observer once the client is closed and no call is left to observe."""
        if self._caller.observer is not None and not (self._is_open or self._calls):
            self._caller.observer.close()

    async def _answer(self, request: object) -> object:
        await find_server(self._transport, self._find)
        self._calls += 1
        try:
            return (await self._caller.call(self._check_request(request))).message
        except ServerUnavailable as error:
            error.hint = await self.find_difference()
            raise
        finally:
            self._calls -= 1
            self._close_observer()

    def _find(self) -> object | None:
        return self._caller if self._caller.is_served else None
