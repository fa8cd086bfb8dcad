"""Serves a node as an ASGI app: rosbridge on a WebSocket for programs, and a page for people.

The app is a callable that uses a running node. It does not need ASGI's lifespan events, so you can
mount it into any other app. The app runs on asyncio and trio, under any ASGI server.

Source: ASGI 3.0; rosbridge v2.
"""

from __future__ import annotations

import logging
import math
from collections.abc import AsyncIterator, Collection
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Final

import anyio
import msgspec
from starlette.requests import HTTPConnection
from starlette.responses import Response
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from turtleact.errors import TurtleactError
from turtleact.http_server import Access
from turtleact.node import Node
from turtleact.tasks import Background, opening
from turtleact.web.connection import TRY_AGAIN_LATER, Connection
from turtleact.web.shared import BridgeState, Limits

__all__ = ["FAREWELL", "Bridge", "Statistics", "open_bridge", "page_response", "plain_text"]

logger = logging.getLogger("turtleact.web")

FAREWELL: Final = 2.0
"""When the bridge is closed, clients have this long to read their last frames (s)."""

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self' ws: wss:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'"
)
HEADERS: Final = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
    "Connection": "close",  # a client that says nothing more holds none
}
MEDIA_TYPES: Final = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}

TELL_EVERY: Final = 10.0
"""The shortest time between two log lines about refused connections (s)."""


class Statistics(msgspec.Struct, frozen=True):
    """Counts of a bridge at one moment.

    Attributes:
        connections: How many clients are connected.
        goals: How many goals of clients are under way, including those of disconnected clients.
        waiting: How many frames wait to be sent to the connected clients.
        dropped: How many frames for connected clients were dropped because the clients read too
            slowly.
    """

    connections: int
    goals: int
    waiting: int
    dropped: int


class Bridge:
    """An ASGI app that serves a node. Use `open_bridge` to create one.

    Attributes:
        is_open: Whether the bridge accepts new connections.
    """

    def __init__(self, shared: BridgeState, access: Access) -> None:
        self.is_open = True
        self._shared = shared
        self._access = access
        self._connections: set[Connection] = set()
        self._left = shared.tasks.signal()
        self._refused = 0
        self._told_at = -math.inf

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one HTTP request or one WebSocket, as ASGI demands."""
        if scope["type"] == "websocket":
            await self._connect(WebSocket(scope, receive, send))
        elif scope["type"] == "http":
            await self._answer(HTTPConnection(scope))(scope, receive, send)
        else:
            raise TurtleactError(
                f"a bridge cannot handle '{scope['type']}': open it with open_bridge"
            )

    def statistics(self) -> Statistics:
        """Return the bridge's counts at this moment."""
        queues = [connection.queue for connection in self._connections]
        return Statistics(
            connections=len(queues),
            goals=len(self._shared.goals),
            waiting=sum(map(len, queues)),
            dropped=sum(queue.dropped for queue in queues),
        )

    async def aclose(self) -> None:
        """Accept no more connections, and close the existing ones.

        Each client gets the frames that are still to be sent, and then a close frame. A client that
        has not read these frames after `FAREWELL` seconds is disconnected. Clients that wait for
        a goal or a service call are told that no answer will come.
        """
        # First the results of goals that have ended are waited for. Then the clients are told that
        # they will hear no more of their goals, and their connections are closed. What they share
        # is closed last, because an open connection may use it.
        self.is_open = False
        with anyio.move_on_after(FAREWELL, shield=True):
            await self._shared.goals.wait_until_told()
            await self._shared.watch.wait_until_told()
        self._shared.goals.leave()
        for connection in self._connections:
            connection.close()
        with anyio.CancelScope(shield=True):
            # Shielded, as closing must be complete even if the program is being cancelled; bounded,
            # as a client that reads nothing must not hold up its end.
            with anyio.move_on_after(FAREWELL):
                await self._wait_until_left()
            for connection in self._connections:
                connection.let_go("the bridge is closed")
            await self._wait_until_left()
            await self._shared.aclose()

    async def _wait_until_left(self) -> None:
        while self._connections:
            await self._left.wait()

    async def _connect(self, websocket: WebSocket) -> None:
        refusal = self._refusal(websocket)
        if refusal is not None:
            self._note_refusal(refusal)
            # An answer with a status says why. Servers without that extension of ASGI can only
            # close the handshake, which the client sees as 403.
            if "websocket.http.response" in websocket.scope.get("extensions", {}):
                await websocket.send_denial_response(refusal)
            else:
                await websocket.close(TRY_AGAIN_LATER)
            return
        connection = Connection(self._shared, websocket)
        self._connections.add(connection)
        try:
            await connection.run()
        finally:
            self._connections.remove(connection)
            self._left.fire()

    def _note_refusal(self, refusal: Response) -> None:
        """Log why a connection is refused, at most once in `TELL_EVERY` seconds.

        A page with an old token tries again each second.
        """
        if anyio.current_time() - self._told_at < TELL_EVERY:
            self._refused += 1
            return
        reason = bytes(refusal.body).decode().rstrip()
        logger.warning("a web connection was refused (%d more before): %s", self._refused, reason)
        self._refused, self._told_at = 0, anyio.current_time()

    def _refusal(self, websocket: WebSocket) -> Response | None:
        """Return the response to a refused client; None if the client may connect."""
        if _path(websocket) != "/":
            return plain_text(404, "rosbridge is at the path /")
        problem = self._problem(websocket)
        if problem:
            return plain_text(403, problem)
        if not self.is_open or len(self._connections) >= self._shared.limits.connections:
            return plain_text(
                503, f"{len(self._connections)} clients are connected: come back later"
            )
        return None

    def _problem(self, asked: HTTPConnection) -> str:
        """Return why a request is refused, or an empty string if it is allowed."""
        scheme, _, token = asked.headers.get("authorization", "").partition(" ")
        return self._access.problem(
            host=asked.headers.get("host", ""),
            origin=asked.headers.get("origin"),
            token=token if scheme.lower() == "bearer" else asked.query_params.get("token", ""),
        )

    def _answer(self, asked: HTTPConnection) -> Response:
        if asked.scope["method"] not in ("GET", "HEAD"):
            return plain_text(405, "only GET works here")
        path = _path(asked)
        # Only the HTML page needs the token, because the other files contain no data.
        problem = self._problem(asked) if path == "/" else ""
        if problem:
            refusal = plain_text(403, problem)
            self._note_refusal(refusal)
            return refusal
        return page_response(path, "page")


@opening
async def open_bridge(
    node: Node,
    *,
    hosts: Collection[str] = (),
    origins: Collection[str] = (),
    token: str = "",
    limits: Limits | None = None,
    cancel_on_disconnect: bool = False,
) -> AsyncIterator[Bridge]:
    """Serve a node as an ASGI app for the length of a block.

    Args:
        node: The node to serve, on any kind of graph.
        hosts: The names that a Host header may have, besides IP addresses and loopback names.
        origins: The origins (``https://example.com``) of pages that may connect, besides the
            server's own origin and those of loopback hosts.
        token: The token that clients must send, as ``?token=…`` or as ``Authorization: Bearer …``.
            If empty, clients need no token.
        limits: The limits on what clients may use. If left out, the defaults of `Limits` apply.
        cancel_on_disconnect: Whether the goals of a client are canceled when it disconnects.
    """
    shared = BridgeState(node, limits or Limits(), cancel_on_disconnect=cancel_on_disconnect)
    bridge = Bridge(shared, Access(frozenset(hosts), frozenset(origins), token))
    learning = Background(
        node.learner.keep_learning(lambda _, name: "/_" not in name), "learning types for the page"
    )
    try:
        yield bridge
    finally:
        await learning.aclose()
        await bridge.aclose()


def plain_text(status: int, text: str) -> Response:
    """Return a response with one line of text."""
    return Response(f"{text}\n", status, HEADERS, media_type="text/plain")


def page_response(path: str, *folders: str) -> Response:
    """Return the response with a file of a page, which is in one of these folders.

    The first folder also has the HTML page itself, whose name is that of the folder.
    """
    name = {"/": f"{folders[0]}.html", "/favicon.ico": "icon.svg"}.get(path, path[1:])
    content = next(filter(None, (_files(folder).get(name) for folder in folders)), None)
    if content is None:
        return plain_text(404, "the only page is at the path /")
    return Response(content, headers=HEADERS, media_type=MEDIA_TYPES[Path(name).suffix])


@cache
def _files(folder: str) -> dict[str, bytes]:
    entries = resources.files("turtleact.web").joinpath(folder).iterdir()
    return {each.name: each.read_bytes() for each in entries}


def _path(asked: HTTPConnection) -> str:
    """Return the path of a request, relative to the path at which the bridge is mounted."""
    path: str = asked.scope["path"]
    return path.removeprefix(asked.scope.get("root_path", "")) or "/"
