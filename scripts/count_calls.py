"""Counts the calls, functions and modules that one goal passes on its way over Zenoh.

Server and client each have an event loop, in two threads of one process. A warm goal is sent again
and again. The script counts the calls of turtleact's Python functions in all threads, and divides
them by the number of goals. ``python scripts/count_calls.py -v`` lists the functions too.
"""

from __future__ import annotations

import asyncio
import sys
import threading
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import turtleact
from turtleact.interfaces.standard import Fibonacci
from turtleact.transports import open_zenoh

WARM, GOALS = 200, 200
WHERE = str(Path(turtleact.__file__).parent)
ENDPOINT = "tcp/127.0.0.1:17455"


class Calls:
    """Counts calls by the code that is called.

    Attributes:
        counted: How often each function was called.
        is_counting: Whether calls count now.
    """

    def __init__(self) -> None:
        self.counted: Counter[CodeType] = Counter()
        self.is_counting = False

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """Called by `sys.setprofile`. A coroutine that goes on counts as another call."""
        if self.is_counting and event == "call":
            self.counted[frame.f_code] += 1

    def of_turtleact(self) -> dict[CodeType, int]:
        """The calls of turtleact's functions, without those of generated codecs."""
        return {c: n for c, n in self.counted.items() if c.co_filename.startswith(WHERE)}


async def count_to(goal: Fibonacci.Goal) -> Any:  # noqa: ANN401  # an async generator
    """The shortest body: it has a result and no feedback."""
    yield Fibonacci.Result(sequence=[goal.order])


async def serve(ready: threading.Event, done: threading.Event) -> None:
    """Serve the action until all is counted."""
    async with (
        open_zenoh(listen=[ENDPOINT], mode="router") as graph,
        turtleact.open_node("server", transport=graph) as node,
    ):
        node.action_server(Fibonacci, "count", count_to)
        ready.set()
        while not done.is_set():
            await asyncio.sleep(0.05)


async def send(calls: Calls) -> None:
    """Send the goals, and count."""
    async with (
        open_zenoh([ENDPOINT]) as graph,
        turtleact.open_node("client", transport=graph) as node,
    ):
        client = node.action_client(Fibonacci, "count")
        if not await client.wait_for_server(10):
            raise SystemExit("the server is not seen")
        for number in range(WARM + GOALS):
            calls.is_counting = number >= WARM
            await client.send_goal(Fibonacci.Goal(order=number))
        await asyncio.sleep(0.05)
        calls.is_counting = False


def main() -> None:
    """Count, and print."""
    calls = Calls()
    ready, done = threading.Event(), threading.Event()
    threading.setprofile(calls)
    sys.setprofile(calls)
    server = threading.Thread(target=asyncio.run, args=(serve(ready, done),))
    server.start()
    try:
        ready.wait(10)
        asyncio.run(send(calls))
    finally:
        done.set()
        sys.setprofile(None)
        threading.setprofile(None)
        server.join()
    ours = calls.of_turtleact()
    steady = {code: count for code, count in ours.items() if count >= GOALS // 2}
    total, everything = (round(sum(each.values()) / GOALS) for each in (ours, calls.counted))
    modules = {code.co_filename for code in steady}
    print(f"{total} calls, {len(steady)} functions, {len(modules)} modules of turtleact")
    print(f"{everything} calls with those of asyncio and of generated code")
    if "-v" in sys.argv:
        for code, count in sorted(steady.items(), key=lambda each: each[0].co_filename):
            where = Path(code.co_filename).relative_to(WHERE)
            print(f"{count / GOALS:6.2f}  {where}  {code.co_qualname}")


if __name__ == "__main__":
    main()
