"""What do actions as tools cost: a call, the list of tools, and the start of ``turtleact mcp``?

The peer is the SDK's own server with a tool that does nothing. Both are called in turn, in memory,
by the SDK's client, with the newest and the older version of the protocol. Everything in memory is
measured in processor time, which is the time that it takes on a machine that does nothing else.
A start is measured in both times, because the two programs are started one after the other. It
needs Linux.

Run: ``python -m benchmarks.bench_mcp``
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import anyio
from mcp import Client
from mcp.server.lowlevel import Server
from mcp.types import CallToolResult, ListToolsResult, TextContent, Tool

from turtleact import open_node
from turtleact.interfaces.standard import Fibonacci
from turtleact.mcp import open_mcp

CALLS = 300
ACTIONS = 100
LISTS = 10
STARTS = 3
HELLO = {
    "jsonrpc": "2.0",
    "id": 0,
    "method": "initialize",
    "params": {
        "protocolVersion": "2025-11-25",
        "capabilities": {},
        "clientInfo": {"name": "bench", "version": "1"},
    },
}
INITIALIZED = {"jsonrpc": "2.0", "method": "notifications/initialized"}
LIST = {"jsonrpc": "2.0", "id": 1, "method": "tools/list"}
BARE = """
import anyio
from mcp.server.lowlevel import Server
from mcp.server.stdio import stdio_server
from mcp.types import ListToolsResult

async def listed(ctx, params):
    return ListToolsResult(tools=[])

async def main():
    server = Server("empty", on_list_tools=listed)
    async with stdio_server() as (read, write):
        await server.run(read, write, server.create_initialization_options())

anyio.run(main)
"""
"""The smallest server on stdin and stdout that the SDK can make."""


def empty_server() -> Server[Any]:
    async def listed(_ctx: object, _params: object) -> ListToolsResult:
        return ListToolsResult(tools=[Tool(name="nothing", input_schema={"type": "object"})])

    async def called(_ctx: object, _params: object) -> CallToolResult:
        return CallToolResult(content=[TextContent(text="{}")])

    return Server("empty", on_list_tools=listed, on_call_tool=called)


async def count(_: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result([0, 1])


async def call_times(one: Client, two: Client) -> tuple[float, float]:
    """The medians (ms) of a call of the action and of the empty tool, in turn."""
    action: list[float] = []
    empty: list[float] = []
    for _ in range(CALLS):
        for times, client, name in ((action, one, "count_0"), (empty, two, "nothing")):
            begun = time.process_time()
            reply = await client.call_tool(name, {"order": 1})
            times.append((time.process_time() - begun) * 1e3)
            assert not reply.is_error
    return statistics.median(action), statistics.median(empty)


async def list_time(client: Client) -> float:
    """The median (ms) of listing the tools."""
    times = []
    for _ in range(LISTS):
        begun = time.process_time()
        listed = await client.list_tools(cache_mode="refresh")
        times.append((time.process_time() - begun) * 1e3)
        assert len(listed.tools) >= ACTIONS
    return statistics.median(times)


async def in_memory(mode: str) -> None:
    async with open_node("bench") as node:
        for number in range(ACTIONS):
            node.action_server(Fibonacci, f"/count_{number}", count)
        async with (
            open_mcp(node, actions="all") as server,
            Client(server.sdk, mode=mode) as one,
            Client(empty_server(), mode=mode) as two,
        ):
            await one.list_tools()
            await two.list_tools()
            action, empty = await call_times(one, two)
            listed = await list_time(one)
    print(f"| {mode} | {action:.2f} | {empty:.2f} | {action - empty:+.2f} | {listed:.1f} |")


class Start(NamedTuple):
    """The times of the first answers of a new server, and their costs.

    Attributes:
        greeted: The time until it had answered ``initialize`` (s).
        greeted_cpu: The processor time (user and system) until then (s).
        listed: The time until it had answered ``tools/list`` (s).
        listed_cpu: The processor time until then (s).
    """

    greeted: float
    greeted_cpu: float
    listed: float
    listed_cpu: float


def cpu_of(process: int) -> float:
    """The processor time of a process (s), as Linux reports it."""
    stat = Path(f"/proc/{process}/stat").read_text()
    times = stat.rpartition(")")[2].split()
    return (int(times[11]) + int(times[12])) / os.sysconf("SC_CLK_TCK")


def start(*arguments: str) -> Start:
    """Start a server as a client does."""
    begun = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as program:
        ask(program, HELLO)
        greeted, greeted_cpu = time.perf_counter() - begun, cpu_of(program.pid)
        ask(program, INITIALIZED, LIST)
        measured = Start(greeted, greeted_cpu, time.perf_counter() - begun, cpu_of(program.pid))
        program.communicate()
    return measured


def ask(program: subprocess.Popen[bytes], *messages: object) -> None:
    """Send messages to a server, and wait for an answer."""
    assert program.stdin is not None
    assert program.stdout is not None
    program.stdin.write(b"".join(json.dumps(each).encode() + b"\n" for each in messages))
    program.stdin.flush()
    assert b'"result"' in program.stdout.readline()


def best(*arguments: str) -> Start:
    """Start a server several times, and return the best of each figure."""
    starts = [start(*arguments) for _ in range(STARTS)]
    return Start(*map(min, zip(*starts, strict=True)))


def main() -> None:
    load = os.getloadavg()[0]
    print(f"{sys.version.split()[0]}, {os.cpu_count()} cores, load {load:.1f}\n")
    print("| protocol | call (ms) | empty call (ms) | difference | tools/list of 100 (ms) |")
    print("|---|---|---|---|---|")
    for mode in ("auto", "legacy"):
        anyio.run(in_memory, mode)
    print(f"\n| best of {STARTS} | initialize (s) | CPU (s) | tools/list (s) | CPU (s) |")
    print("|---|---|---|---|---|")
    ours = best("-m", "turtleact", "mcp", "--embedded", "--all")
    print("| turtleact mcp |", " | ".join(f"{each:.2f}" for each in ours), "|")
    bare = best("-c", BARE)
    print("| the SDK alone |", " | ".join(f"{each:.2f}" for each in bare), "|")


if __name__ == "__main__":
    main()
