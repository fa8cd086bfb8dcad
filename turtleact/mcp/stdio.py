"""Serves MCP on stdin and stdout, for a client that has started the server as a child process.

The SDK reads stdin in a thread that cannot be interrupted. Because of that thread, a program that
gets a signal could not end until the client sent its next message. So the event loop reads stdin
instead, where it can: on a POSIX system, if stdin is a pipe, a socket or a terminal.

While the SDK is still being imported, a client already waits for the answer to its first message.
`open_wire` gives this answer at once (see `turtleact.mcp.greeting`).

Source: MCP 2026-07-28, "Transports", for the framing: one JSON message per line.
"""

from __future__ import annotations

import asyncio
import os
import stat
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from importlib.metadata import version
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, TextIO, cast

import anyio

from turtleact.mcp.greeting import greet
from turtleact.tasks import Background

if TYPE_CHECKING:
    from turtleact.mcp.greeting import Greeting
    from turtleact.mcp.server import McpServer

__all__ = ["Wire", "import_sdk", "open_wire", "serve_stdio"]

CHUNK: Final = 2**16

LONGEST: Final = 2**24
"""The maximum length of a message (bytes)."""


def import_sdk() -> None:
    """Import the modules that `serve_stdio` needs. This is slow. Any thread may call it."""
    import mcp.server.stdio  # noqa: F401  # needs modules of the system's own


class Wire:
    """Reads the lines that come from stdin. `open_wire` makes a wire.

    Args:
        reader: Reads stdin; None if the event loop cannot read it.

    Attributes:
        greeting: The answer that this object gave to the first line; None if the SDK must answer.
        greeted: An event that is set when `greeting` has its final value.
        is_taken: Whether the SDK now reads the lines. If so, only the SDK may write to stdout.
    """

    def __init__(self, reader: asyncio.StreamReader | None) -> None:
        self.greeting: Greeting | None = None
        self.greeted = anyio.Event()
        self.is_taken = False
        self.lines = None if reader is None else _lines(reader)
        self._first: str | None = None

    async def greet(self) -> None:
        """Read the first line, and answer it if it is a valid ``initialize`` request."""
        try:
            if self.lines is not None:
                self._first = await anext(self.lines, None)
            if self._first is not None and not self.is_taken:
                self.greeting = greet(self._first, version("turtleact"))
            if self.greeting is not None:
                with suppress(BrokenPipeError):  # the client has gone; the end of stdin says so
                    sys.stdout.buffer.write(self.greeting.line)
                    sys.stdout.buffer.flush()
        finally:
            self.greeted.set()

    async def __aiter__(self) -> AsyncIterator[str]:
        """Yield all lines, including the first line, which `greet` has already read."""
        await self.greeted.wait()
        if self._first is not None and self.lines is not None:
            yield self._first
            async for line in self.lines:
                yield line


@asynccontextmanager
async def open_wire() -> AsyncIterator[Wire]:
    """Read stdin during an ``async with`` block, and answer the client's ``initialize`` request."""
    file = _file_of(sys.stdin)
    if file is None or not _can_be_waited_for(file):
        yield Wire(None)
        return
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    own = os.fdopen(os.dup(file), "rb", buffering=0)
    transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), own)
    wire = Wire(reader)
    greeting = Background(wire.greet(), "greeting the client")
    try:
        yield wire
    finally:
        await greeting.aclose()
        transport.close()


async def serve_stdio(server: McpServer, wire: Wire) -> None:
    """Serve one client until it closes stdin. Then cancel the client's calls.

    Nothing else may write to stdout while this function runs. The SDK redirects prints of user code
    to stderr.
    """
    from mcp.server.stdio import stdio_server  # needs modules of the system's own

    wire.is_taken = True
    sdk = server.sdk
    stdin = None if wire.lines is None else cast("anyio.AsyncFile[str]", wire)  # is only iterated
    async with stdio_server(stdin) as (read, write):
        out = write if stdin is None else _WithoutGreeting(write, wire)
        await sdk.run(read, out, sdk.create_initialization_options())


class _WithoutGreeting:
    """The SDK's outgoing stream.

    If `Wire` has already answered ``initialize``, this stream drops the SDK's answer.
    """

    def __init__(self, inner: Any, wire: Wire) -> None:  # noqa: ANN401  # the SDK's stream
        self._inner = inner
        self._wire = wire

    async def send(self, item: Any, /) -> None:  # noqa: ANN401  # the SDK's message
        """Send a message, but drop an answer to ``initialize`` if `Wire` has already sent one.

        The first message that the SDK sends is the answer to ``initialize``, because the SDK does
        not read another request earlier.
        """
        if self._wire.greeting is not None:
            self._wire.greeting = None
            return
        await self._inner.send(item)

    async def aclose(self) -> None:
        """Close the stream."""
        await self._inner.aclose()

    async def __aenter__(self) -> _WithoutGreeting:
        """Return this stream."""
        await self._inner.__aenter__()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> bool | None:
        """Close the stream at the end of a block."""
        return cast("bool | None", await self._inner.__aexit__(kind, error, trace))


def _file_of(stream: TextIO) -> int | None:
    """Return the file descriptor of a stream; None if the stream has none, as in a notebook."""
    try:
        return stream.fileno()
    except OSError:
        return None


def _can_be_waited_for(file: int) -> bool:
    """Whether the event loop can wait until there is something to read from a file.

    The event loop cannot wait for a regular file or ``/dev/null``.
    """
    if os.name != "posix":
        return False
    mode = os.fstat(file).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(file)


async def _lines(reader: asyncio.StreamReader) -> AsyncIterator[str]:
    """Yield the lines of stdin. A line that is too long is cut off, and so becomes invalid JSON."""
    held = bytearray()
    while chunk := await reader.read(CHUNK):
        *lines, rest = chunk.split(b"\n")
        for line in lines:
            yield (held + line).decode(errors="replace")
            held.clear()
        held += rest[: max(0, LONGEST - len(held))]
