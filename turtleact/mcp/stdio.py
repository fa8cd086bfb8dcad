"""Serves MCP on stdin and stdout, for a client that has started the server as a child process.

The SDK reads stdin in a thread that cannot be interrupted. Because of that thread, a program that
gets a signal could not end until the client sent its next message. So the event loop reads stdin
instead, where it can: on a POSIX system, if stdin is a pipe, a socket or a terminal. The SDK
answers every message.

Source: MCP 2026-07-28, "Transports", for the framing: one JSON message per line.
"""

from __future__ import annotations

import asyncio
import os
import stat
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Final, TextIO, cast

from mcp.server.stdio import stdio_server

if TYPE_CHECKING:
    import anyio

    from turtleact.mcp.server import McpServer

__all__ = ["serve_stdio"]

LONGEST: Final = 2**24
"""The maximum length of a message (bytes). A longer message ends the server with an error."""


async def serve_stdio(server: McpServer) -> None:
    """Serve one client until it closes stdin. Then cancel the client's calls.

    Nothing else may write to stdout while this function runs. The SDK redirects prints of user code
    to stderr.
    """
    sdk = server.sdk
    async with _open_stdin() as lines, stdio_server(lines) as (read, write):
        await sdk.run(read, write, sdk.create_initialization_options())


@asynccontextmanager
async def _open_stdin() -> AsyncIterator[anyio.AsyncFile[str] | None]:
    """Read stdin in the event loop; None if the SDK has to read it in a thread."""
    file = _file_of(sys.stdin)
    if file is None or not _can_be_waited_for(file):
        yield None
        return
    reader = asyncio.StreamReader(LONGEST)
    loop = asyncio.get_running_loop()
    own = os.fdopen(os.dup(file), "rb", buffering=0)
    transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), own)
    try:
        yield cast("anyio.AsyncFile[str]", _lines(reader))  # the SDK only iterates
    finally:
        transport.close()


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
    """Yield the lines of stdin."""
    async for line in reader:
        yield line.decode(errors="replace")
