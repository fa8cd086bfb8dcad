"""Serves a node as an ASGI app: rosbridge on a WebSocket for programs, and a page for people.

The app is a plain callable over a running node. It has no lifespan, so you can mount it into any
other app. The app runs on asyncio and trio, under any ASGI server.

Source: ASGI 3.0; rosbridge v2.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from functools import cache
from importlib import resources
from typing import Final

import anyio
import msgspec
from starlette.requests import HTTPConnection
from starlette.responses import Response
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from turtleact.errors import TurtleactError
from turtleact.node import Node
from turtleact.web.access import Access, Refusals
from turtleact.web.connection import TRY_AGAIN_LATER, Connection
from turtleact.web.shared import Limits, Shared

__all__ = ["Bridge", "Statistics", "open_bridge", "page_file", "plain_text"]

FAREWELL: Final = 2.0
"""When the bridge is closed, clients have this long to take their last frames (s)."""

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
MODULES: Final = (
    "connection",
    "draft",
    "driving",
    "elements",
    "fields",
    "goals",
    "main",
    "places",
    "timeline",
    "topics",
    "turtles",
    "values",
    "watch",
    "world",
)
"""The page's JavaScript modules."""

FILES: Final = {
    "/": ("page.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/favicon.ico": ("icon.svg", "image/svg+xml"),
    **{f"/{name}.js": (f"{name}.js", "text/javascript") for name in MODULES},
}
"""The files of the page by path. Only the first needs the token; the others hold no data."""


class Statistics(msgspec.Struct, frozen=True):
    """A snapshot of a bridge.

    Attributes:
        connections: How many clients are connected.
        goals: How many goals of these clients are under way.
        waiting: How many frames wait to be sent.
        dropped: How many frames the connected clients have lost because they were too slow.
    """

    connections: int
    goals: int
    waiting: int
    dropped: int


class Bridge:
    """An ASGI app over a node. `open_bridge` makes one.

    Attributes:
        is_open: Whether it takes connections.
        budget: How much memory all clients together may hold.
        refusals: Logs the connections that are refused.
    """

    def __init__(self, shared: Shared, access: Access) -> None:
        self.is_open = True
        self.budget = shared.budget
        self.refusals = Refusals()
        self._shared = shared
        self._access = access
        self._connections: set[Connection] = set()
        self._left = shared.tasks.signal()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request. An ASGI server, or an app around this one, calls this."""
        if scope["type"] == "websocket":
            await self._connect(WebSocket(scope, receive, send))
        elif scope["type"] == "http":
            await self._answer(HTTPConnection(scope))(scope, receive, send)
        else:
            raise TurtleactError(
                f"a bridge cannot handle '{scope['type']}': open it with open_bridge"
            )

    def statistics(self) -> Statistics:
        """A snapshot of the bridge."""
        boxes = [connection.mailbox for connection in self._connections]
        return Statistics(
            connections=len(boxes),
            goals=len(self._shared.goals),
            waiting=sum(map(len, boxes)),
            dropped=sum(box.dropped for box in boxes),
        )

    async def aclose(self) -> None:
        """Take no more connections, and end the existing connections.

        Each client gets the frames that must still arrive, and a close frame. A client has
        `FAREWELL` seconds to take them. Clients that wait for a goal or a call are told that no
        answer will come.
        """
        # First the clients are told that they will hear no more of their goals. Then their
        # connections are closed. What they share is closed last, because an open connection may use
        # it.
        self.is_open = False
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
        self.refusals.tell()

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
        self.refusals.note(bytes(refusal.body).decode().rstrip(), anyio.current_time())

    def _refusal(self, websocket: WebSocket) -> Response | None:
        """The response to a refused client; None if the client may connect."""
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
        """Why a client is refused; empty if it may connect."""
        scheme, _, token = asked.headers.get("authorization", "").partition(" ")
        return self._access.problem(
            host=asked.headers.get("host", ""),
            origin=asked.headers.get("origin"),
            token=token if scheme.lower() == "bearer" else asked.query_params.get("token", ""),
        )

    def _answer(self, asked: HTTPConnection) -> Response:
        if asked.scope["method"] not in ("GET", "HEAD"):
            return plain_text(405, "only GET works here")
        found = FILES.get(_path(asked))
        if found is None:
            return plain_text(404, "the only page is at the path /")
        name, media_type = found
        problem = self._problem(asked) if media_type == "text/html" else ""
        if problem:
            refusal = plain_text(403, problem)
            self._note_refusal(refusal)
            return refusal
        return Response(page_file(name), media_type=media_type, headers=HEADERS)


@asynccontextmanager
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
        hosts: Host names that clients may use, besides IP addresses and loopback names.
        origins: The origins (``https://example.com``) of pages that may connect, besides the
            server's own origin and those of loopback hosts.
        token: The token that clients must send: ``?token=…``, or ``Authorization: Bearer …``.
        limits: How much clients may ask for.
        cancel_on_disconnect: Whether a client that disconnects cancels its goals.
    """
    shared = Shared(node, limits or Limits(), cancel_on_disconnect=cancel_on_disconnect)
    bridge = Bridge(shared, Access(frozenset(hosts), frozenset(origins), token))
    try:
        yield bridge
    finally:
        await bridge.aclose()


def plain_text(status: int, text: str) -> Response:
    """A response with a line of text."""
    return Response(f"{text}\n", status, HEADERS, media_type="text/plain")


@cache
def page_file(name: str, folder: str = "page") -> bytes:
    """A file of a page."""
    return resources.files("turtleact.web").joinpath(folder, name).read_bytes()


def _path(asked: HTTPConnection) -> str:
    """The path relative to where the bridge is mounted."""
    path: str = asked.scope["path"]
    return path.removeprefix(asked.scope.get("root_path", "")) or "/"
