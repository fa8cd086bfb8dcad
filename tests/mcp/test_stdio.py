"""A server on stdin and stdout; here both are pipes of this process."""

from __future__ import annotations

import json
import os
import sys
from contextlib import contextmanager
from typing import Any

import anyio
import pytest

from turtleact.mcp.serving import serve_stdio

from .line import open_lab


class Pipes:
    """The other ends of stdin and stdout."""

    def __init__(self) -> None:
        reads, self._ours = os.pipe()
        self._answers, writes = os.pipe()
        self.inner = os.fdopen(reads), os.fdopen(writes, "w")
        self._held = b""

    @contextmanager
    def in_place(self):
        """A block in which they are this process's; pytest sets its own before each test."""
        before = sys.stdin, sys.stdout
        sys.stdin, sys.stdout = self.inner
        try:
            yield
        finally:
            sys.stdin, sys.stdout = before

    def send(self, line) -> None:
        os.write(self._ours, json.dumps({"jsonrpc": "2.0", **line}).encode() + b"\n")

    async def answer(self):
        while b"\n" not in self._held:
            await anyio.wait_readable(self._answers)
            self._held += os.read(self._answers, 2**16)
        line, self._held = self._held.split(b"\n", 1)
        return json.loads(line)

    def hang_up(self) -> None:
        os.close(self._ours)
        self._ours = -1

    def close(self) -> None:
        if self._ours >= 0:
            os.close(self._ours)
        os.close(self._answers)
        for end in self.inner:
            end.close()


@pytest.fixture
def pipes():
    made = Pipes()
    yield made
    made.close()


async def serve(pipes, server):
    """Serve until the other side hangs up."""
    with pipes.in_place():
        await serve_stdio(server)


HELLO: dict[str, Any] = {
    "id": 0,
    "method": "initialize",
    "params": {
        "protocolVersion": "2024-11-05",
        "capabilities": {},
        "clientInfo": {"name": "test", "version": "1"},
    },
}


async def test_a_client_that_hangs_up_cancels_its_goal_and_ends_the_server(pipes):
    async with open_lab() as (lab, _, server), anyio.create_task_group() as serving:
        serving.start_soon(serve, pipes, server)
        pipes.send(HELLO)
        hello = await pipes.answer()
        assert hello["result"]["protocolVersion"] == "2024-11-05"
        assert hello["result"]["capabilities"]["tools"] == {"listChanged": True}
        pipes.send({"method": "notifications/initialized"})
        call = {"name": "count", "arguments": {"order": 0}}
        pipes.send({"id": 1, "method": "tools/call", "params": call})
        await lab.started.wait()
        pipes.hang_up()
    assert lab.ended == ["cancelled"]


async def test_a_signal_ends_a_server_whose_client_says_nothing(pipes):
    async with open_lab() as (_, _, server):
        with anyio.move_on_after(0.05) as scope:
            await serve(pipes, server)
    assert scope.cancelled_caught
