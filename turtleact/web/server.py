"""Serves a node, or the metrics of a program, on a port: runs uvicorn with a bridge as the app.

This module needs asyncio or uvloop, because uvicorn does. On trio, serve a bridge with another ASGI
server.

Source: uvicorn ``websockets_sansio_impl.py``; Prometheus, "Exposition formats", text format 0.0.4.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Collection
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Final, cast
from urllib.parse import quote

import anyio
import msgspec
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from turtleact.errors import TurtleactError
from turtleact.http_server import Access, Config, bound, is_loopback, serving, token_for
from turtleact.node import Node
from turtleact.tasks import opening
from turtleact.web.bridge import Bridge, open_bridge
from turtleact.web.shared import Limits

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.types import Message

__all__ = ["CONTENT_TYPE", "PORT", "Socket", "Web", "open_metrics", "open_web"]

PORT: Final = 9090
"""rosbridge's own port."""

ROOM: Final = 50
"""How many connections the server accepts beyond `Limits.connections`, for the page."""

LAST_ORDERS: Final = 2
"""When uvicorn ends, it waits this long for requests that are under way (s)."""

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"

FORBIDDEN: Final = (
    "only programs on this machine may read this; --metrics 0.0.0.0:PORT lets all in\n"
)


class Web(msgspec.Struct, frozen=True):
    """A running web server.

    Attributes:
        host: The address on which the server listens.
        port: The port on which the server listens.
        token: The token that clients must send; empty if none is needed.
        bridge: The app that the server runs.
    """

    host: str
    port: int
    token: str
    bridge: Bridge

    @property
    def url(self) -> str:
        """The page's URL. For rosbridge, put ``ws:`` in place of ``http:``."""
        query = f"?token={quote(self.token, safe='')}" if self.token else ""
        return f"{_address_of(self.host, self.port)}{query}"


ANY: Final = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104  # told, not bound
"""The address that a browser on this machine uses if all addresses are bound."""


@opening
async def open_web(
    node: Node,
    host: str = "127.0.0.1",
    port: int = PORT,
    *,
    token: str | None = None,
    hosts: Collection[str] = (),
    origins: Collection[str] = (),
    limits: Limits | None = None,
    cancel_on_disconnect: bool = False,
) -> AsyncIterator[Web]:
    """Serve a node on a port for the length of a block.

    The server already listens when the block begins. At the end of the block, the server sends each
    client the frames that are still to be sent, and then a close frame.

    Args:
        node: The node to serve.
        host: The address or name to bind. Other machines can reach the server unless this is a
            loopback address.
        port: The port, 1 to 65535, or 0 for any free one.
        token: The token that clients must send. If left out, there is no token on a loopback
            address, and a new random token (`Web.token`) on any other address.
        hosts: As in `open_bridge`. ``host`` is always allowed.
        origins: As in `open_bridge`.
        limits: As in `open_bridge`.
        cancel_on_disconnect: As in `open_bridge`.

    Raises:
        InvalidOption: if the host or the port cannot be bound, or if the token is empty and the
            host is not a loopback address.
        TurtleactError: if the event loop is not asyncio's or uvloop's.
    """
    if anyio.get_cancelled_exc_class() is not asyncio.CancelledError:
        raise TurtleactError(
            "the web server only runs on asyncio: on trio, mount open_bridge in another server"
        )
    limits = limits or Limits()
    token = token_for(host, token)
    with bound(host, port) as listener:
        async with open_bridge(
            node,
            hosts={host.lower(), *hosts},
            origins=origins,
            token=token,
            limits=limits,
            cancel_on_disconnect=cancel_on_disconnect,
        ) as bridge:
            address: tuple[str, int] = listener.getsockname()[:2]
            config = Config(
                bridge,
                ws=Socket,
                limit_concurrency=limits.connections + ROOM,
                ws_max_size=limits.message_size,
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=LAST_ORDERS,
            )
            async with serving(config, listener, bridge.aclose):
                yield Web(address[0], address[1], token, bridge)


@asynccontextmanager
async def open_metrics(text: Callable[[], str], host: str, port: int) -> AsyncIterator[str]:
    """Serve a text at ``/metrics`` for Prometheus until the ``async with`` block ends.

    The context manager yields the text's URL. If the server listens on a loopback address, only
    programs on this machine get the text. Otherwise everybody does who can reach the port.

    Args:
        text: Called at each request. Returns all metrics as text.
        host: The address or name to bind.
        port: The port, 1 to 65535, or 0 for any free one.

    Raises:
        InvalidOption: if the host or the port cannot be bound.
    """
    access = Access(frozenset({host.lower()}))

    async def answer(request: Request) -> Response:
        headers = request.headers
        problem = access.problem(host=headers.get("host", ""), origin=headers.get("origin"))
        if problem and is_loopback(host):
            return PlainTextResponse(FORBIDDEN, 403)
        return Response(text(), media_type=CONTENT_TYPE)

    app = Starlette(routes=[Route("/metrics", answer)])
    with bound(host, port) as listener:
        async with serving(Config(app, timeout_graceful_shutdown=LAST_ORDERS), listener):
            yield f"{_address_of(host, listener.getsockname()[1])}metrics"


class Socket(WebSocketsSansIOProtocol):
    """The WebSocket of one client."""

    async def run_asgi(self) -> None:
        """Run the app for the connection.

        The extension ``turtleact.abort`` lets the app disconnect a client that does not read.
        """
        extensions = cast("dict[str, object]", self.scope["extensions"])
        extensions["turtleact.abort"] = self.transport.abort
        await super().run_asgi()

    async def send(self, message: Message) -> None:  # type: ignore[override]  # uvicorn's types are private
        """Send an ASGI message from the app to the client."""
        await super().send(message)  # type: ignore[arg-type]  # likewise
        if message["type"] == "websocket.http.response.body":
            # A refusal is an answer to the handshake, too. uvicorn does not see it that way, and
            # would log an error for each.
            self.handshake_complete = True


def _address_of(host: str, port: int) -> str:
    """Return the URL with which a browser on this machine reaches a server."""
    host = ANY.get(host, host)
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"
