"""Serves a node on a port: runs uvicorn, with a bridge as the app.

This module needs asyncio or uvloop, because uvicorn does. On trio, serve a bridge with another ASGI
server. Here, uvicorn is stricter with clients than usual:

- A client that does not send a whole request in time is disconnected, and the number of connections
  is limited. Otherwise anybody could use up all connections that the process may open.
- The app can disconnect a client that does not read. A client that does not answer a ping is
  disconnected, unless it is still sending a message, because its answer may follow that message.

Source: uvicorn ``h11_impl.py`` and ``websockets_sansio_impl.py``.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Collection
from typing import TYPE_CHECKING, Final, cast
from urllib.parse import quote

import anyio
import msgspec
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from turtleact import http_server
from turtleact.errors import TurtleactError
from turtleact.http_server import bound, serving, token_for
from turtleact.node import Node
from turtleact.tasks.opening import opening
from turtleact.web.access import RefusalCounter
from turtleact.web.bridge import Bridge, open_bridge
from turtleact.web.shared import Limits

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message

__all__ = [
    "PORT",
    "READ_AHEAD",
    "Config",
    "Http",
    "Socket",
    "Web",
    "address_of",
    "open_web",
]

logger = logging.getLogger("turtleact.web")

PORT: Final = 9090
"""rosbridge's own port."""

ROOM: Final = 50
"""How many connections the server accepts beyond `Limits.connections`, for the page."""

READ_AHEAD: Final = 2**14
"""How much a client may send ahead (bytes). Other clients wait while this is processed."""

LAST_ORDERS: Final = 2
"""When uvicorn ends, it waits this long for requests that are under way (s)."""

REQUEST_WITHIN: Final = 10.0
"""How long a client may take to send its request (s)."""


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
        return f"{address_of(self.host, self.port)}{query}"


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
    with bound(host, port, read_ahead=READ_AHEAD) as listener:
        async with open_bridge(
            node,
            hosts={host.lower(), *hosts},
            origins=origins,
            token=token,
            limits=limits,
            cancel_on_disconnect=cancel_on_disconnect,
        ) as bridge:
            address: tuple[str, int] = listener.getsockname()[:2]
            most = limits.connections + ROOM
            config = Config(bridge, bridge.refusals, most, limits.message_size)
            async with serving(config, listener, bridge.aclose):
                yield Web(address[0], address[1], token, bridge)


class Config(http_server.Config):
    """uvicorn's configuration, with additional settings for `Http` and `Socket`.

    Args:
        app: The ASGI app to serve.
        refusals: Counts and logs refused connections.
        limit_concurrency: How many connections may be open at a time.
        ws_max_size: The maximum size of a message on a WebSocket (bytes).

    Attributes:
        refusals: Counts and logs refused connections.
        request_within: How long a client may take to send its request (s).
        spare: How many connections may be open beyond ``limit_concurrency``. Requests on these
            extra connections are answered with 503. Any further connection is reset.
    """

    request_within: float = REQUEST_WITHIN
    spare: int = 0

    def __init__(
        self,
        app: ASGIApp,
        refusals: RefusalCounter,
        limit_concurrency: int,
        ws_max_size: int = READ_AHEAD,
    ) -> None:
        self.refusals = refusals
        super().__init__(
            app,
            http=Http,
            ws=Socket,
            limit_concurrency=limit_concurrency,
            ws_max_size=ws_max_size,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=LAST_ORDERS,
        )


class _Log(logging.Logger):
    """The logger of uvicorn's protocols for one connection.

    The protocols log a warning for each request that they refuse. Each such warning counts as a
    refusal in `RefusalCounter`, and is not logged individually. Errors are logged unchanged,
    because they show bugs.
    """

    def __init__(self, refusals: RefusalCounter) -> None:
        super().__init__("turtleact.web", logging.WARNING)
        self.parent = logger
        self._refusals = refusals

    def handle(self, record: logging.LogRecord) -> None:
        """Count a refusal if the record is a warning; log the record if it is an error."""
        if record.levelno < logging.ERROR:
            self._refusals.note(record.getMessage(), time.monotonic())
        else:
            super().handle(record)


class Http(H11Protocol):
    """An HTTP connection, which serves one request.

    At most ``limit_concurrency + spare`` connections are open, including those that have become a
    `Socket`.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in uvicorn
        """Accept a new connection, or reset it if too many are open."""
        config = cast("Config", self.config)
        self.logger = _Log(config.refusals)
        super().connection_made(transport)
        most = (self.limit_concurrency or 0) + config.spare
        if len(self.connections) > most:
            self.logger.warning("%d connections are open", most)
            transport.abort()
        else:
            self.loop.call_later(config.request_within, self._give_up)

    def _give_up(self) -> None:
        is_asked: bool = self.cycle is not None or self.transport.get_protocol() is not self
        if not is_asked:
            self.transport.abort()


class Socket(WebSocketsSansIOProtocol):
    """The WebSocket of one client."""

    _heard_at = 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take over a connection from `Http`."""
        self.logger = self.conn.logger = _Log(cast("Config", self.config).refusals)
        super().connection_made(transport)

    async def run_asgi(self) -> None:
        """Run the app for the connection.

        The extension ``turtleact.abort`` lets the app disconnect the client.
        """
        extensions = cast("dict[str, object]", self.scope["extensions"])
        extensions["turtleact.abort"] = self.transport.abort
        await super().run_asgi()

    def data_received(self, data: bytes) -> None:
        """Handle data that has arrived."""
        self._heard_at = self.loop.time()
        super().data_received(data)

    async def send(self, message: Message) -> None:  # type: ignore[override]  # uvicorn's types are private
        """Send an ASGI message from the app to the client."""
        await super().send(message)  # type: ignore[arg-type]  # likewise
        if message["type"] == "websocket.http.response.body":
            # A refusal is an answer to the handshake, too. uvicorn does not see it that way, and
            # would log an error for each.
            self.handshake_complete = True

    def keepalive_timeout(self) -> None:
        """Disconnect a client that has not answered a ping in time.

        A client that has sent other data since the ping stays connected, because its answer may
        follow.
        """
        if self._heard_at > self.ping_sent_at:
            self.pong_timer = None
            self.schedule_ping()
        else:
            super().keepalive_timeout()


def address_of(host: str, port: int) -> str:
    """Return the URL with which a browser on this machine reaches a server."""
    host = ANY.get(host, host)
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"
