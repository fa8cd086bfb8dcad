"""What do other web clients notice when some clients do not read, or send nonsense?

A world and its web server run in one process. 40 clients read a turtle's pose at 62.5 Hz. Ten more
subscribe to the pose, and to 100 kB at the same rate, and never read. Then one client in another
process sends 100,000 frames that do not fit their topic, as fast as the server takes them.

"Gap" is the longest time between two poses at any of the 40 clients. "Late" is how much a pose is
behind its place in the 16 ms schedule, measured inside the server.

Run ``python -m benchmarks.bench_readers``.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import platform
import socket
import statistics
import struct
from contextlib import AsyncExitStack
from importlib.metadata import version
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path
from time import perf_counter
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.sync.client import connect as connect_patiently

from turtleact import open_world
from turtleact.interfaces import get_interface
from turtleact.web import open_web

READERS = 40
DEAF = 10
SECONDS = 10.0
TICK = 0.016
MALFORMED = 100_000

Pose: Any = get_interface("turtlesim/msg/Pose")
String: Any = get_interface("std_msgs/msg/String")
NONSENSE = '{"op":"publish","topic":"/turtle1/cmd_vel","msg":{"linear":{"w":1}}}'
HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


# the server's process


def serve(line: Connection) -> None:
    asyncio.run(_serve(line))


async def _serve(line: Connection) -> None:
    """Run the server.

    It sends its port and, for each word it gets, the lateness of poses since then.
    """
    came: list[float] = []
    loop = asyncio.get_running_loop()
    over = asyncio.Event()

    def answer() -> None:
        if line.recv() == "end":
            over.set()
        places = [at - TICK * number for number, at in enumerate(came)]
        line.send(([place - min(places) for place in places], _memory()))
        came.clear()

    async with open_world() as node, open_web(node, port=0) as web:
        large = node.publisher(String, "/large")
        loop.add_reader(line.fileno(), answer)
        line.send(web.port)

        async def watch() -> None:
            async for _ in node.subscription(Pose, "/turtle1/pose"):
                came.append(perf_counter())
                large.publish(String(data="x" * 100_000))

        watching = asyncio.create_task(watch())
        await over.wait()
        watching.cancel()


def _memory() -> float:
    """The memory of the process (MB)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


# the clients


async def read(client: ClientConnection, came: list[float]) -> None:
    async for _ in client:
        came.append(perf_counter())


def talk(port: int, line: Connection) -> None:
    """Run a client that sends wrong frames as fast as possible, and report how long it took."""
    with connect_patiently(f"ws://127.0.0.1:{port}", ping_interval=None) as client:
        begun = perf_counter()
        for _ in range(MALFORMED):
            client.send(NONSENSE)
        client.send(json.dumps({"op": "call_service", "service": "/rosapi/get_time"}))
        client.recv()
        line.send(perf_counter() - begun)


def deafen(port: int) -> socket.socket:
    """Open a client that asks for much and reads nothing."""
    deaf = socket.create_connection(("127.0.0.1", port))
    deaf.sendall(HANDSHAKE)
    for topic in ("/turtle1/pose", "/large"):
        said = json.dumps({"op": "subscribe", "topic": topic}).encode()
        deaf.sendall(struct.pack(">BBI", 0x81, 0x80 | len(said), 0) + said)
    return deaf


async def measure(name: str, line: Connection, came: list[list[float]], seconds: float) -> None:
    """Wait for some seconds, and print what has happened in them."""
    line.send("begin")
    await asyncio.to_thread(line.recv)
    for each in came:
        each.clear()
    await asyncio.sleep(seconds)
    line.send("so far")
    late, memory = await asyncio.to_thread(line.recv)
    tell(name, came, late, memory)


def tell(name: str, came: list[list[float]], late: list[float], memory: float) -> None:
    gap = max((b - a for each in came for a, b in pairwise(each)), default=0.0)
    late_99 = statistics.quantiles(late, n=100)[-1] if len(late) > 1 else 0.0
    print(
        f"{name:36} {gap * 1e3:6.0f} ms {late_99 * 1e3:7.1f} ms {max(late) * 1e3:7.1f} ms"
        f" {memory:6.0f} MB"
    )


async def main() -> None:
    line, far = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=serve, args=(far,))
    process.start()
    port = await asyncio.to_thread(line.recv)
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{os.cpu_count()} cores, {platform.machine()}, load {load}")
    packages = ", ".join(f"{name} {version(name)}" for name in ("uvicorn", "websockets"))
    print(f"Python {platform.python_version()}, {packages}")
    print(f"{'':36} {'gap':>9} {'late 99 %':>10} {'latest':>10} {'memory':>9}")
    async with AsyncExitStack() as stack:
        came: list[list[float]] = []
        tasks = []
        for _ in range(READERS):
            client = await stack.enter_async_context(connect(f"ws://127.0.0.1:{port}"))
            await client.send(json.dumps({"op": "subscribe", "topic": "/turtle1/pose"}))
            came.append([])
            tasks.append(asyncio.create_task(read(client, came[-1])))
        await measure(f"{READERS} readers", line, came, SECONDS)
        deaf = [deafen(port) for _ in range(DEAF)]
        await measure(f"{READERS} readers, {DEAF} that never read", line, came, SECONDS)
        for each in deaf:
            each.close()

        line.send("begin")
        await asyncio.to_thread(line.recv)
        for times in came:
            times.clear()
        ours, theirs = multiprocessing.Pipe()
        talker = multiprocessing.get_context("spawn").Process(target=talk, args=(port, theirs))
        talker.start()
        took = await asyncio.to_thread(ours.recv)
        talker.join()
        line.send("so far")
        late, memory = await asyncio.to_thread(line.recv)
        tell(f"{READERS} readers, {MALFORMED:,} wrong frames", came, late, memory)
        print(f"{MALFORMED / took:,.0f} wrong frames/s")
        line.send("end")
        await asyncio.to_thread(line.recv)
        for task in tasks:
            task.cancel()
    process.join()


if __name__ == "__main__":
    asyncio.run(main())
