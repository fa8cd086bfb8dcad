"""A server on stdin and stdout; here both are pipes of this process."""

from __future__ import annotations

import json
import os
import sys
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import anyio
import pytest

from turtleact.mcp import stdio
from turtleact.mcp.greeting import VERSIONS, greet
from turtleact.mcp.stdio import Wire, open_wire, serve_stdio

from .line import open_lab


class Pipes:
    """The other ends of stdin and stdout."""

    def __init__(self) -> None:
        reads, self._ours = os.pipe()
        self._answers, writes = os.pipe()
        self.inner = self._ends = os.fdopen(reads), os.fdopen(writes, "w")
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

    async def send(self, line) -> None:
        data = line if isinstance(line, bytes) else json.dumps({"jsonrpc": "2.0", **line}).encode()
        await anyio.to_thread.run_sync(self._write, data + b"\n")

    def _write(self, data: bytes) -> None:
        while data:
            data = data[os.write(self._ours, data) :]

    async def answer(self):
        while b"\n" not in self._held:
            await anyio.wait_readable(self._answers)
            self._held += os.read(self._answers, 2**16)
        line, self._held = self._held.split(b"\n", 1)
        return json.loads(line)

    def hang_up(self) -> None:
        os.close(self._ours)
        self._ours = -1

    def stop_listening(self) -> None:
        os.close(self._answers)
        self._answers = -1

    def close(self) -> None:
        if self._ours >= 0:
            os.close(self._ours)
        if self._answers >= 0:
            os.close(self._answers)
        for end in self._ends:
            end.close()


@pytest.fixture
def pipes():
    made = Pipes()
    yield made
    made.close()


async def serve(pipes, server):
    """Serve until the other side hangs up."""
    with pipes.in_place():
        async with open_wire() as wire:
            await serve_stdio(server, wire)


HELLO: dict[str, Any] = {
    "id": 0,
    "method": "initialize",
    "params": {
        "protocolVersion": "2024-11-05",
        "capabilities": {},
        "clientInfo": {"name": "test", "version": "1"},
    },
}


def hello(wanted, **others):
    """The first message of a client that wants a version of the protocol."""
    params = HELLO["params"] | {"protocolVersion": wanted} | others
    return {"jsonrpc": "2.0"} | HELLO | {"params": params}


@pytest.mark.parametrize("wanted", [*VERSIONS, "2026-07-28", "nonsense"])
async def test_the_client_is_greeted_with_what_the_sdk_would_answer(pipes, wanted):
    ours = greet(json.dumps(hello(wanted)), version("turtleact"))
    async with open_lab() as (_, _, server), anyio.create_task_group() as serving:
        with pipes.in_place():
            serving.start_soon(serve_stdio, server, Wire(None))
            await anyio.wait_all_tasks_blocked()
        await pipes.send(hello(wanted))
        theirs = await pipes.answer()
        pipes.hang_up()
    assert ours is not None
    assert json.loads(ours.line) == theirs


@pytest.mark.parametrize(
    "line",
    [
        "{",
        json.dumps({"jsonrpc": "2.0", "id": 1, "method": "ping"}),
        json.dumps(hello("2025-11-25") | {"id": None}),
        json.dumps(hello("2025-11-25", clientInfo={"name": "no version"})),
        json.dumps(hello("2025-11-25", capabilities=[])),
    ],
)
def test_the_sdk_answers_what_is_no_plain_greeting(line):
    assert greet(line, "1") is None


async def test_a_client_is_greeted_once_and_before_the_server_is_there(pipes):
    with pipes.in_place():
        async with open_wire() as wire:
            await pipes.send(HELLO)
            assert (await pipes.answer())["id"] == 0
            async with open_lab() as (_, _, server), anyio.create_task_group() as serving:
                serving.start_soon(serve_stdio, server, wire)
                await pipes.send({"method": "notifications/initialized"})
                await pipes.send({"id": 0, "method": "ping"})
                assert (await pipes.answer())["result"] == {}
                pipes.hang_up()


async def test_a_server_does_not_wait_for_a_client_that_has_gone_before_its_greeting(pipes):
    pipes.stop_listening()
    with pipes.in_place():
        async with open_wire() as wire:
            await pipes.send(HELLO)
            pipes.hang_up()
            lines = [line async for line in wire]
    assert len(lines) == 1  # and then the end of stdin
    with suppress(BrokenPipeError):  # the greeting is still in the buffer
        pipes.inner[1].close()


async def test_a_client_that_says_hello_late_is_answered_by_the_sdk(pipes):
    with pipes.in_place():
        async with (
            open_lab() as (_, _, server),
            open_wire() as wire,
            anyio.create_task_group() as serving,
        ):
            serving.start_soon(serve_stdio, server, wire)
            await anyio.wait_all_tasks_blocked()
            await pipes.send(HELLO)
            assert (await pipes.answer())["id"] == 0
            assert wire.greeting is None
            pipes.hang_up()


async def test_a_client_that_hangs_up_cancels_its_goal_and_ends_the_server(pipes):
    async with open_lab() as (lab, _, server), anyio.create_task_group() as serving:
        serving.start_soon(serve, pipes, server)
        await pipes.send(HELLO)
        hello = await pipes.answer()
        assert hello["result"]["protocolVersion"] == "2024-11-05"
        assert hello["result"]["capabilities"]["tools"] == {"listChanged": True}
        await pipes.send({"method": "notifications/initialized"})
        call = {"name": "count", "arguments": {"order": 0}}
        await pipes.send({"id": 1, "method": "tools/call", "params": call})
        await lab.started.wait()
        pipes.hang_up()
    assert lab.ended == ["cancelled"]


async def test_a_signal_ends_a_server_whose_client_says_nothing(pipes):
    async with open_lab() as (_, _, server):
        with anyio.move_on_after(0.05) as scope:
            await serve(pipes, server)
    assert scope.cancelled_caught


async def test_an_empty_file_for_stdin_ends_the_server(pipes):
    async with open_lab() as (_, _, server):
        with Path(os.devnull).open() as nothing:
            pipes.inner = nothing, pipes.inner[1]
            await serve(pipes, server)


@pytest.mark.parametrize("line", [b"{", b"x" * 5000], ids=["malformed", "too long"])
async def test_a_line_that_is_no_message_is_answered_and_the_next_is_read(pipes, monkeypatch, line):
    monkeypatch.setattr(stdio, "LONGEST", 1000)
    async with open_lab() as (_, _, server), anyio.create_task_group() as serving:
        serving.start_soon(serve, pipes, server)
        await pipes.send(line)
        await pipes.send(HELLO)
        while "result" not in (answer := await pipes.answer()):
            assert answer["error"]["code"] == -32700
        pipes.hang_up()
