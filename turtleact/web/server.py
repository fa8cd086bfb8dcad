"""Serves a node on a port: runs uvicorn, with a bridge as the app.

This module needs asyncio or uvloop, because uvicorn does. On trio, serve a bridge with another ASGI
server. Here, uvicorn is stricter with clients than usual:

- A client that does not send a whole request in time is disconnected, and the number of connections
  is limited. Otherwise anybody could use up all connections that the process may open.
- The app can disconnect a client that does not read. A client that does not answer a ping is
  disconnected, unless it is still sending a message, because its answer may follow that message.
- A client that sends a text that is not UTF-8 is disconnected. The log gets one line without a
  traceback, because this is the client's mistake.

Source: uvicorn ``h11_impl.py`` and ``websockets_sansio_impl.py``; RFC 6455, section 8.1.
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
from turtleact.web.access import Refusals
from turtleact.web.bridge import Bridge, open_bridge
from turtleact.web.connection import TRY_AGAIN_LATER
from turtleact.web.mailbox import Budget
from turtleact.web.shared import Limits

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message
    from websockets.frames import Frame

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

LINGER: Final = 1.0
"""After disconnecting a client, the server still reads and drops its data for this time (s)."""

OVERHEAD: Final = 64
"""The memory that Python uses for each part of a message, besides its contents (bytes)."""

TOO_MUCH: Final = "all clients together hold too much memory, and this one most of it"

MOST_PINGS: Final = 100
"""The maximum number of pings from a client in a second."""


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
            config.budget = bridge.budget
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
        budget: Limits the memory of all WebSockets. Leave it unset if the app has no WebSockets.
        request_within: How long a client may take to send its request (s).
        spare: How many connections may be open beyond ``limit_concurrency``. Requests on these
            extra connections are answered with 503. Any further connection is reset.
    """

    budget: Budget
    request_within: float = REQUEST_WITHIN
    spare: int = 0

    def __init__(
        self,
        app: ASGIApp,
        refusals: Refusals,
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
    refusal in `Refusals`, and is not logged individually. Errors are logged unchanged, because they
    show bugs.
    """

    def __init__(self, refusals: Refusals) -> None:
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
    """The WebSocket of one client.

    All data held for the client counts towards the budget of all clients: the part of a message
    that has arrived, messages that the app has not handled yet, and data that the client has not
    received yet.
    """

    _heard_at = 0.0
    _pinged_at = 0.0
    _pings = 0
    _fragments = 0
    _unread = 0
    _is_let_go = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take over a connection from `Http`."""
        config = cast("Config", self.config)
        self._budget = config.budget
        self.logger = self.conn.logger = _Log(config.refusals)
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
        if self._is_let_go:
            return
        self._heard_at = self.loop.time()
        super().data_received(data)
        self._count()

    def connection_lost(self, exc: Exception | None) -> None:
        """Record that the connection has ended. Its data no longer counts towards the budget."""
        super().connection_lost(exc)
        self._budget.hold(self, 0)

    def resume_writing(self) -> None:
        """Record that the client has received data."""
        super().resume_writing()
        self._count()

    def shrink(self) -> int:
        """Disconnect the client, because all clients together hold too much memory."""
        logger.warning("a web client was disconnected: %s", TOO_MUCH)
        self._is_let_go = True
        self.frames = []
        is_open = self.handshake_complete and not self.transport.is_closing()
        if not is_open or self.close_sent or self._unsent():  # it would not read a close frame
            self.transport.abort()
        else:
            self.conn.send_close(TRY_AGAIN_LATER, TOO_MUCH)
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.conn.reader.buffer.clear()
            self.close_sent = True
            self.queue.put_nowait({"type": "websocket.disconnect", "code": TRY_AGAIN_LATER})
            # The kernel resets a connection that is closed before all is read that has arrived,
            # and the client would not get the close frame. So go on reading for a moment.
            self.close_timer = self.loop.call_later(LINGER, self.transport.close)
            self.transport.resume_reading()
        return 0

    def handle_text(self, event: Frame) -> None:
        """Handle a text message or its first part."""
        self._fragments = _cost(event)
        super().handle_text(event)

    def handle_bytes(self, event: Frame) -> None:
        """Handle a binary message or its first part."""
        self._fragments = _cost(event)
        super().handle_bytes(event)

    def handle_cont(self, event: Frame) -> None:
        """Handle another part of a message."""
        self._fragments += _cost(event)
        super().handle_cont(event)

    async def receive(self) -> Message:  # type: ignore[override]  # uvicorn's types are private
        """Return the next message to the app.

        If the app calls this method when no message is queued, the app has handled all earlier
        messages. Then these messages no longer count towards the budget.
        """
        if self.queue.empty():
            self._unread = 0
            self._count()
        return cast("Message", await super().receive())

    async def send(self, message: Message) -> None:  # type: ignore[override]  # likewise
        """Send an ASGI message from the app to the client."""
        await super().send(message)  # type: ignore[arg-type]  # likewise
        if message["type"] == "websocket.http.response.body":
            # A refusal is an answer to the handshake, too. uvicorn does not see it that way, and
            # would log an error for each.
            self.handshake_complete = True
        self._count()

    def _count(self) -> None:
        """Tell the budget how much memory is held for the client."""
        if not (self._is_let_go or self.disconnected or self.transport.is_closing()):
            incoming = len(self.conn.reader.buffer) + self._fragments + self._unread
            self._budget.hold(self, incoming + self._unsent())

    def _unsent(self) -> int:
        return self.transport.get_write_buffer_size()

    def handle_ping(self) -> None:
        """Answer a ping. Disconnect a client that sends over `MOST_PINGS` pings in a second."""
        now = self.loop.time()
        if now - self._pinged_at >= 1.0:
            self._pinged_at, self._pings = now, 0
        self._pings += 1
        if self._pings <= MOST_PINGS:
            super().handle_ping()
        elif self._pings == MOST_PINGS + 1:
            logger.warning(
                "a web client was disconnected: it sent %d pings in a second", self._pings
            )
            self.transport.abort()

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

    def send_receive_event_to_app(self) -> None:
        """Pass a complete message to the app. A text that is not UTF-8 ends the connection."""
        self._unread += self._fragments
        self._fragments = 0
        is_read = self.curr_msg_data_type == "text" and not self.close_sent
        if is_read and not _is_text(self.frames):
            logger.warning("a web client was disconnected: it sent a text that is not UTF-8")
            self.frames = []
            self.conn.send_close(1007)
            self.handle_parser_exception()
        else:
            super().send_receive_event_to_app()


def address_of(host: str, port: int) -> str:
    """Return the URL with which a browser on this machine reaches a server."""
    host = ANY.get(host, host)
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


def _cost(part: Frame) -> int:
    """Return the memory used for a part of a message (bytes).

    Python's overhead is included, because many tiny parts also use much memory.
    """
    return len(part.data) + OVERHEAD


def _is_text(parts: list[bytes]) -> bool:
    try:
        b"".join(parts).decode()
    except UnicodeDecodeError:
        return False
    return True
