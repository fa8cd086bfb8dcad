"""Serves MCP over HTTP, as an ASGI app or on a port, and on stdin and stdout.

The SDK checks the headers Host and Origin of each request, so that a page of another web site
cannot reach the server through the user's browser. A server on a loopback address needs no further
protection. On other addresses, clients must also send a token.

Source: MCP 2026-07-28, "Transports"; RFC 6750 for the token.
"""

from __future__ import annotations

import hmac
import sys
from collections.abc import AsyncIterator, Collection
from typing import TYPE_CHECKING, Final, cast

import msgspec
from mcp.server.stdio import stdio_server
from mcp.server.transport_security import TransportSecuritySettings
from starlette.responses import PlainTextResponse

from turtleact.http_server import Config, bound, serving, token_for
from turtleact.tasks import opening, run_in_daemon

if TYPE_CHECKING:
    import anyio
    from starlette.types import ASGIApp, Receive, Scope, Send

    from turtleact.mcp.server import McpServer

__all__ = ["Address", "open_app", "open_http", "serve_stdio"]

PATH: Final = "/mcp"
LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")


class Address(msgspec.Struct, frozen=True):
    """Where a server listens.

    Attributes:
        host: The address or name to which the server is bound.
        port: The port.
        token: The token that clients must send; empty if none is needed.
    """

    host: str
    port: int
    token: str

    @property
    def url(self) -> str:
        """The URL that clients connect to."""
        place = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{place}:{self.port}{PATH}"


@opening
async def open_app(
    server: McpServer, *, hosts: Collection[str] = (), token: str = ""
) -> AsyncIterator[ASGIApp]:
    """Offer a server as an ASGI app that you can mount beside other apps. The path is ``/mcp``.

    Args:
        server: The server from `turtleact.mcp.open_mcp`.
        hosts: The names and addresses by which clients may reach this machine. The loopback's names
            and addresses are always allowed.
        token: The token that clients must send, as ``Authorization: Bearer …``. If empty, clients
            need no token.
    """
    allowed = [each for host in (*LOOPBACK, *hosts) for each in (host, f"{host}:*")]
    security = TransportSecuritySettings(
        allowed_hosts=allowed,
        allowed_origins=[f"{scheme}://{each}" for each in allowed for scheme in ("http", "https")],
    )
    app = server.sdk.streamable_http_app(streamable_http_path=PATH, transport_security=security)
    async with server.sdk.session_manager.run():
        yield _Guarded(app, token) if token else app


@opening
async def open_http(
    server: McpServer,
    host: str = "127.0.0.1",
    port: int = 0,
    *,
    token: str | None = None,
    hosts: Collection[str] = (),
) -> AsyncIterator[Address]:
    """Serve MCP over HTTP on a port while an ``async with`` block runs.

    The server already listens when the block begins. It runs only on asyncio.

    Args:
        server: The server from `turtleact.mcp.open_mcp`.
        host: The address or name to bind. Other machines can reach the server unless this is a
            loopback address.
        port: The port, or 0 for any free port.
        token: The token that clients must send. If left out, clients need no token for a loopback
            address, and a random token is made for any other address.
        hosts: More names and addresses by which clients may reach this machine. ``host`` and the
            loopback's names and addresses are always allowed.

    Raises:
        InvalidOption: if the host or the port cannot be bound, or if the token is empty and the
            host is not a loopback address.
    """
    token = token_for(host, token)
    with bound(host, port) as listener:
        own = f"[{host}]" if ":" in host else host
        async with (
            open_app(server, hosts={own, *hosts}, token=token) as app,
            # Not patient: each client keeps a stream open as long as it is there, and would hold up
            # the end.
            serving(Config(app), listener, is_patient=False),
        ):
            yield Address(host, listener.getsockname()[1], token)


async def serve_stdio(server: McpServer) -> None:
    """Serve one client until it closes stdin. Then cancel the client's calls.

    Nothing else may write to stdout while this function runs. The SDK redirects prints of user code
    to stderr.
    """
    sdk = server.sdk
    lines = cast("anyio.AsyncFile[str]", _stdin())  # the SDK only iterates
    async with stdio_server(lines) as (read, write):
        await sdk.run(read, write, sdk.create_initialization_options())


async def _stdin() -> AsyncIterator[str]:
    """Yield the lines of stdin."""
    # The SDK would read in a thread that must end before the program can, so a signal would wait
    # for the client's next message. A daemon thread is left behind, and the file with it: closing
    # the file would wait for the thread.
    file = open(sys.stdin.fileno(), encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
    while line := await run_in_daemon(file.readline, "stdin"):
        yield line


class _Guarded:
    """An ASGI app that answers HTTP requests only if they have the right token."""

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
