"""A client of a bridge, without a network: the ASGI app on one end, a test on the other."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import anyio

import turtleact
from turtleact.transports import MemoryTransport
from turtleact.web import Bridge, open_bridge

HEADERS = {"host": "localhost"}


def websocket_scope(path: str = "/", query: str = "", **headers: str) -> dict[str, Any]:
    named = HEADERS | {name.replace("_", "-"): value for name, value in headers.items()}
    return {
        "type": "websocket",
        "asgi": {"version": "3.0"},
        "scheme": "ws",
        "path": path,
        "root_path": "",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in named.items()],
        "subprotocols": [],
        "extensions": {"websocket.http.response": {}},
    }


class Line:
    """One connection.

    Attributes:
        closed: The close frame, or the refusal, once there is one.
        gate: While it is not set, the client takes nothing.
        is_broken: Whether sending fails.
    """

    def __init__(self) -> None:
        self._to_app, self._inbox = anyio.create_memory_object_stream[dict[str, Any]](10_000)
        self._outbox, self._from_app = anyio.create_memory_object_stream[Any](10_000)
        self._to_app.send_nowait({"type": "websocket.connect"})
        self.closed: dict[str, Any] = {}
        self.over = anyio.Event()
        self.gate = anyio.Event()
        self.gate.set()
        self.aborted = False
        self.is_broken = False

    async def receive(self) -> dict[str, Any]:
        return await self._inbox.receive()

    async def send(self, message: Any) -> None:
        await self.gate.wait()
        if self.is_broken:
            raise OSError("gone")
        if message["type"] == "websocket.send":
            text = message.get("text")
            self._outbox.send_nowait(message["bytes"] if text is None else text)
        elif message["type"] != "websocket.accept":
            self.closed |= message

    def abort(self) -> None:
        self.aborted = True

    async def run(self, app: Any, scope: dict[str, Any]) -> None:
        scope["extensions"]["turtleact.abort"] = self.abort
        try:
            await app(scope, self.receive, self.send)
        finally:
            self.over.set()
            self._outbox.close()

    def say(self, op: str, **members: object) -> None:
        self.say_raw(json.dumps({"op": op, **members}))

    def say_raw(self, frame: str | bytes) -> None:
        kind = "text" if isinstance(frame, str) else "bytes"
        self._to_app.send_nowait({"type": "websocket.receive", kind: frame})

    async def hear_raw(self) -> Any:
        """The next frame as it is."""
        return await self._from_app.receive()

    async def hear(self) -> Any:
        """The next frame, which is JSON text."""
        frame = await self.hear_raw()
        assert isinstance(frame, str)
        return json.loads(frame)

    async def call(self, service: str, **members: object) -> Any:
        """Call a service, and give what is heard next: that is the response, if all is well."""
        self.say("call_service", id="a call", service=service, **members)
        return await self.hear()

    async def hears_nothing(self) -> Any:
        """Whether nothing was sent before the answer to a question that is put now."""
        return (await self.call("/rosapi/get_ros_version"))["values"] == {
            "version": 2,
            "distro": "jazzy",
        }

    def hang_up(self) -> None:
        self._to_app.send_nowait({"type": "websocket.disconnect", "code": 1001})

    def close(self) -> None:
        """Give back what the streams hold."""
        for stream in (self._to_app, self._inbox, self._outbox, self._from_app):
            stream.close()


@asynccontextmanager
async def line(app: Any, scope: dict[str, Any] | None = None) -> AsyncIterator[Line]:
    """A connection for the length of a block."""
    connection = Line()
    try:
        async with anyio.create_task_group() as group:
            group.start_soon(connection.run, app, scope or websocket_scope())
            yield connection
            connection.gate.set()
            connection.hang_up()
    finally:
        connection.close()


@asynccontextmanager
async def bridged(
    transport: MemoryTransport | None = None, **options: Any
) -> AsyncIterator[tuple[turtleact.Node, Bridge]]:
    """A node and a bridge to it."""
    async with (
        turtleact.open_node("lab", transport=transport) as node,
        open_bridge(node, **options) as bridge,
    ):
        yield node, bridge
