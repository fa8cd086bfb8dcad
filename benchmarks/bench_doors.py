"""What does a goal cost inside the process, over Zenoh and over rosbridge, in one run?

A goal is sent, publishes three feedback messages and succeeds. The time runs from sending it to
having the result. Both ends are in this process, so only the connection between them differs. The
machine may have other work: compare ratios, not figures.

Run ``python -m benchmarks.bench_doors``.
"""

from __future__ import annotations

import asyncio
import json
import socket
import statistics
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from time import perf_counter
from typing import TypeAlias

from websockets.asyncio.client import connect

import turtleact
from turtleact.interfaces.standard import Fibonacci
from turtleact.transports import open_zenoh
from turtleact.web import open_web

Fibonaccis: TypeAlias = turtleact.ActionClient[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]

GOALS = 500
ORDER = 4


async def fibonacci(goal: Fibonacci.Goal) -> AsyncIterator[Fibonacci.Feedback | Fibonacci.Result]:
    """The body: feedback for each number, and no waiting."""
    numbers = [0, 1]
    for _ in range(1, goal.order):
        numbers.append(numbers[-1] + numbers[-2])
        yield Fibonacci.Feedback(partial_sequence=numbers)
    yield Fibonacci.Result(sequence=numbers)


async def main() -> None:
    """Measure each way, in turns, and print the medians."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    async with AsyncExitStack() as stack:
        enter = stack.enter_async_context
        far = await enter(open_zenoh([], listen=[address], mode="router", config={}))
        near = await enter(open_zenoh([address], mode="client", config={}))
        server = await enter(turtleact.open_node("server", transport=far))
        guest = await enter(turtleact.open_node("guest", transport=near))
        server.action_server(Fibonacci, "/fibonacci", fibonacci)
        inside = server.action_client(Fibonacci, "/fibonacci")
        outside = guest.action_client(Fibonacci, "/fibonacci")
        await outside.wait_for_server()
        web = await enter(open_web(server, port=0))
        bridge = await enter(connect(web.url.replace("http:", "ws:")))

        async def by_handle(client: Fibonaccis) -> None:
            async with client.send_goal(Fibonacci.Goal(order=ORDER)) as handle:
                assert len([each async for each in handle]) == ORDER - 1
                await handle.result()

        async def by_bridge() -> None:
            goal = {
                "op": "send_action_goal",
                "id": "goal",
                "action": "/fibonacci",
                "action_type": Fibonacci.type_name,
                "args": {"order": ORDER},
                "feedback": True,
            }
            await bridge.send(json.dumps(goal))
            heard = 0
            while json.loads(await bridge.recv())["op"] != "action_result":
                heard += 1
            assert heard == ORDER - 1

        ways: dict[str, Callable[[], Awaitable[None]]] = {
            "in the process": lambda: by_handle(inside),
            "by Zenoh": lambda: by_handle(outside),
            "by rosbridge": by_bridge,
        }
        took: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(GOALS):
            for name, send in ways.items():
                began = perf_counter()
                await send()
                took[name].append(perf_counter() - began)
    least = statistics.median(took["in the process"])
    for name, seconds in took.items():
        median, worst = statistics.median(seconds), statistics.quantiles(seconds, n=100)[-1]
        print(
            f"{name:16} {median * 1e6:7.0f} us {median / least:6.1f}x   p99 {worst * 1e6:7.0f} us"
        )


if __name__ == "__main__":
    asyncio.run(main())
