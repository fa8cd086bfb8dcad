"""What a client has to keep to on its line: uvicorn's protocols, which trust a little less here.

- A client that connects and says nothing, or half a request, is let go, and there is an end to
  connections: else it costs nothing to take all that the process may open.
- A client that does not read can be cut off by the app. One that answers no ping is gone, but not
  one that has much to say: its answer stands in line behind that.
- A text that is none is the client's mistake: a line in the log, and no traceback.

Source: uvicorn ``h11_impl.py`` and ``websockets_sansio_impl.py``; RFC 6455, section 8.1.
"""

from __future__ import annotations

import asyncio
import logging
from typing import Final, cast

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

__all__ = ["Http", "Socket"]

logger = logging.getLogger("turtleact.web")

REQUEST_WITHIN: Final = 10.0
"""So long a client has to say what it wants (s)."""

MOST_PINGS: Final = 100
"""So often a client may ask in a second whether the server is there."""


class Http(H11Protocol):
    """A connection on which a client asks for something, once.

    There are ``limit_concurrency`` of them at most, those that have become a `Socket` among them.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in uvicorn
        """Take a connection, unless there are too many."""
        super().connection_made(transport)
        if self.limit_concurrency is not None and len(self.connections) > self.limit_concurrency:
            transport.abort()
        else:
            self.loop.call_later(REQUEST_WITHIN, self._give_up)

    def _give_up(self) -> None:
        is_asked: bool = self.cycle is not None or self.transport.get_protocol() is not self
        if not is_asked:
            self.transport.abort()


class Socket(WebSocketsSansIOProtocol):
    """A WebSocket."""

    _heard_at = 0.0
    _pinged_at = 0.0
    _pings = 0

    async def run_asgi(self) -> None:
        """Serve the connection."""
        extensions = cast("dict[str, object]", self.scope["extensions"])
        extensions["turtleact.abort"] = self.transport.abort
        await super().run_asgi()

    def data_received(self, data: bytes) -> None:
        """Read on."""
        self._heard_at = self.loop.time()
        super().data_received(data)

    def handle_ping(self) -> None:
        """Answer a ping; the answers would pile up to a client that does nothing else."""
        now = self.loop.time()
        if now - self._pinged_at >= 1.0:
            self._pinged_at, self._pings = now, 0
        self._pings += 1
        if self._pings <= MOST_PINGS:
            super().handle_ping()
        elif self._pings == MOST_PINGS + 1:
            logger.warning("a web client was let go: it sent %d pings in a second", self._pings)
            self.transport.abort()

    def keepalive_timeout(self) -> None:
        """End, unless the pong that is missed stands behind what the client says meanwhile."""
        if self._heard_at > self.ping_sent_at:
            self.pong_timer = None
            self.schedule_ping()
        else:
            super().keepalive_timeout()

    def send_receive_event_to_app(self) -> None:
        """Hand a message to the app; a text that is none ends the connection."""
        is_read = self.curr_msg_data_type == "text" and not self.close_sent
        if is_read and not _is_text(self.frames):
            logger.warning("a web client was let go: it sent a text that is not UTF-8")
            self.frames = []
            self.conn.send_close(1007)
            self.handle_parser_exception()
        else:
            super().send_receive_event_to_app()


def _is_text(parts: list[bytes]) -> bool:
    try:
        b"".join(parts).decode()
    except UnicodeDecodeError:
        return False
    return True
