"""A server over HTTP: an ASGI app for other servers, and a port of its own.

The SDK checks the Host and the Origin of a request, so that a page of another site cannot reach the
server through a browser. On a loopback address that is enough. Clients on other machines have to
know a token, too.

Source: MCP 2026-07-28, "Transports", Streamable HTTP; RFC 6750 for the token.
"""

from __future__ import annotations

import errno
import hmac
import secrets
import socket
from collections.abc import AsyncIterator, Collection, Iterator
from contextlib import asynccontextmanager, contextmanager
from ipaddress import ip_address
from typing import TYPE_CHECKING, Final

import anyio
import msgspec
import uvicorn
from mcp.server.transport_security import TransportSecuritySettings
from starlette.responses import PlainTextResponse

from turtleact.errors import InvalidOption, TurtleactError
from turtleact.tasks import Background

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send

    from turtleact.mcp.server import McpServer

__all__ = ["Address", "open_app", "open_http"]

PATH: Final = "/mcp"
LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")
LAST_ORDERS: Final = 8
"""How long calls have to end their goals when the server ends (s)."""


class Address(msgspec.Struct, frozen=True):
    """Where a server listens.

    Attributes:
        host: The address that it is bound to.
        port: The port.
        token: The token that clients must send; empty if none is needed.
    """

    host: str
    port: int
    token: str

    @property
    def url(self) -> str:
        """What clients connect to."""
        place = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{place}:{self.port}{PATH}"


@asynccontextmanager
async def open_app(
    server: McpServer, *, hosts: Collection[str] = (), token: str = ""
) -> AsyncIterator[ASGIApp]:
    """A server as an ASGI app, to be mounted beside others; its path is ``/mcp``.

    Args:
        server: Made by `turtleact.mcp.open_mcp`.
        hosts: Names and addresses of this machine that clients may use, besides loopback ones.
        token: The token that clients must send: ``Authorization: Bearer …``. Empty for none.
    """
    allowed = [each for host in (*LOOPBACK, *hosts) for each in (host, f"{host}:*")]
    security = TransportSecuritySettings(
        allowed_hosts=allowed,
        allowed_origins=[f"{scheme}://{each}" for each in allowed for scheme in ("http", "https")],
    )
    app = server.sdk.streamable_http_app(streamable_http_path=PATH, transport_security=security)
    async with server.sdk.session_manager.run():
        yield _Guarded(app, token) if token else app


@asynccontextmanager
async def open_http(
    server: McpServer,
    host: str = "127.0.0.1",
    port: int = 0,
    *,
    token: str | None = None,
    hosts: Collection[str] = (),
) -> AsyncIterator[Address]:
    """Serve on a port; the server listens when the block begins. Needs asyncio.

    Args:
        server: Made by `turtleact.mcp.open_mcp`.
        host: The address or name to bind; other machines can reach it unless it is a loopback one.
        port: The port, or 0 for any free one.
        token: The token that clients must send. If left out, none is needed on a loopback address;
            elsewhere one is made for this run.
        hosts: As for `open_app`; ``host`` is among them.

    Raises:
        InvalidOption: if the host or the port cannot be bound, or if the token is empty and the
            host is not a loopback one.
    """
    if token is None:
        token = "" if _is_loopback(host) else secrets.token_urlsafe(16)
    if not token and not _is_loopback(host):
        raise InvalidOption("token", f"must not be empty if other machines can connect ({host})")
    with _bound(host, port) as listener:
        own = f"[{host}]" if ":" in host else host
        async with open_app(server, hosts={own, *hosts}, token=token) as app:
            config = uvicorn.Config(
                app,
                lifespan="off",
                log_config=None,
                access_log=False,
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=LAST_ORDERS,
            )
            serving = _Uvicorn(config)
            running = Background(serving.serve([listener]), "the HTTP server")
            try:
                await serving.ready.wait()
                if not serving.started:
                    raise TurtleactError("the HTTP server has not started: its log says why")
                yield Address(host, listener.getsockname()[1], token)
            finally:
                serving.should_exit = True
                await running.aclose()


class _Uvicorn(uvicorn.Server):
    """uvicorn's server; reports its start, and leaves signals to the program."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.ready = anyio.Event()

    async def serve(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until ``should_exit``."""
        try:
            await super().serve(sockets)
        finally:
            self.ready.set()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen."""
        await super().startup(sockets)
        self.ready.set()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


class _Guarded:
    """An app behind a token."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self._app = app
        self._expected = f"Bearer {token}".encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        given = dict(scope.get("headers", ())).get(b"authorization", b"")
        # Compared in constant time: how long it takes must not tell how much of a guess was right.
        if scope["type"] == "http" and not hmac.compare_digest(given, self._expected):
            refusal = PlainTextResponse(
                "the token is missing or wrong: send it as 'Authorization: Bearer …'\n",
                401,
                {"WWW-Authenticate": "Bearer"},
            )
            await refusal(scope, receive, send)
            return
        await self._app(scope, receive, send)


@contextmanager
def _bound(host: str, port: int) -> Iterator[socket.socket]:
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        family, kind, protocol, _, address = found[0]
        listener = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise InvalidOption("host", f"{host} is not an address of this machine: {error}") from None
    with listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(address)
        except OSError as error:
            hint = ": choose another port" if error.errno == errno.EADDRINUSE else ""
            problem = f"{host}:{port} cannot be bound: {error.strerror}{hint}"
            raise InvalidOption("port", problem) from None
        yield listener


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
