"""What actions cost as tools: a call, the list of tools, and the start of ``turtleact mcp``.

The peer is the SDK's own server with a tool that does nothing. Both are called in turn, in memory,
by the SDK's client, with the newest and the older version of the protocol. Everything in memory is
measured in processor time, which is the time that it takes on a machine that does nothing else.

Run: ``python -m benchmarks.bench_mcp``
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from typing import Any

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


def start_time(*code: str) -> float:
    """Until a server that was started has answered ``initialize`` (s), or a program has ended."""
    begun = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, *code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as program:
        assert program.stdin is not None
        assert program.stdout is not None
        if "-m" in code:
            program.stdin.write(json.dumps(HELLO) + "\n")
            program.stdin.flush()
            assert "result" in program.stdout.readline()
        else:
            program.wait()
        taken = time.perf_counter() - begun
        program.stdin.close()
    return taken


def main() -> None:
    load = os.getloadavg()[0]
    print(f"{sys.version.split()[0]}, {os.cpu_count()} cores, load {load:.1f}\n")
    print("| protocol | call (ms) | empty call (ms) | difference | tools/list of 100 (ms) |")
    print("|---|---|---|---|---|")
    for mode in ("auto", "legacy"):
        anyio.run(in_memory, mode)
    served = min(start_time("-m", "turtleact", "mcp", "--embedded", "--all") for _ in range(STARTS))
    sdk = min(start_time("-c", "import mcp.server.stdio") for _ in range(STARTS))
    print(f"\nready after {served:.2f} s; the SDK alone takes {sdk:.2f} s (best of {STARTS})")


if __name__ == "__main__":
    main()
