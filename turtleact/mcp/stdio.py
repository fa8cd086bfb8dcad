"""A server on stdin and stdout, for a client that starts it as its child.

The SDK reads stdin in a thread, which cannot be interrupted: a signal would not end the program
before the client's next message. So stdin is read by the event loop where it can be, that is, if it
is a pipe, a socket or a terminal of a POSIX system.

Source: MCP 2026-07-28, "Transports", for the framing: one JSON message a line.
"""

from __future__ import annotations

import asyncio
import os
import stat
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Final, cast

import anyio

if TYPE_CHECKING:
    from turtleact.mcp.server import McpServer

__all__ = ["serve_stdio"]

CHUNK: Final = 2**16

LONGEST: Final = 2**24
"""The longest message that is read (bytes)."""


async def serve_stdio(server: McpServer) -> None:
    """Serve one client until it closes stdin; its calls are cancelled then.

    Nothing else may write to stdout meanwhile. The SDK leads prints of user code to stderr.
    """
    from mcp.server.stdio import stdio_server  # needs modules of the system's own

    sdk = server.sdk
    async with _stdin() as lines:
        stdin = cast("anyio.AsyncFile[str] | None", lines)  # it is only iterated over
        async with stdio_server(stdin) as (read, write):
            await sdk.run(read, write, sdk.create_initialization_options())


@asynccontextmanager
async def _stdin() -> AsyncIterator[AsyncIterator[str] | None]:
    """The lines of stdin; None if the event loop cannot read it."""
    if os.name != "posix" or not _can_be_waited_for(sys.stdin.fileno()):
        yield None
        return
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    own = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
    transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), own)
    try:
        yield _lines(reader)
    finally:
        transport.close()


def _can_be_waited_for(file: int) -> bool:
    """Whether the system can wait for a file; it cannot for a regular file or ``/dev/null``."""
    mode = os.fstat(file).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(file)


async def _lines(reader: asyncio.StreamReader) -> AsyncIterator[str]:
    """The lines; in place of one that is too long comes its beginning, which is no JSON."""
    held = bytearray()
    while chunk := await reader.read(CHUNK):
        *lines, rest = chunk.split(b"\n")
        for line in lines:
            yield (held + line).decode(errors="replace")
            held.clear()
        held += rest[: max(0, LONGEST - len(held))]
