"""Is anything lost, and does anything grow, over very many goals?

Goals run one after another, then very many at once. Each publishes feedback, which its sender
reads. Every fifth goal is canceled midway. All answers and all feedback are counted.

For goals in a row, the cost of a goal is compared between the first and the last tenth. For goals
at once, it is compared between a tenth of them and all. Costs are CPU time, because nothing waits
for anything else. Memory is measured in separate runs, because tracemalloc, which reports what
Python holds, slows everything down. The garbage collector is on.
"""

from __future__ import annotations

import gc
import importlib.util
import os
import platform
import statistics
import time
import tracemalloc
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib.metadata import version
from typing import NamedTuple

import anyio
import anyio.lowlevel

import turtleact
from turtleact import Action, ActionClient, GoalStatus, Message
from turtleact.interfaces import int32

IN_A_ROW = 100_000
AT_ONCE = 20_000
CANCELED = 5
"""One in this many goals is canceled."""

FEEDBACK = 3
"""A goal publishes this many feedback messages before it waits to be canceled, or goes on."""


class Count(Action, type_name="bench_msgs/action/Count"):
    class Goal(Message):
        number: int32 = 0

    class Result(Message):
        number: int32 = 0

    class Feedback(Message):
        count: int32 = 0


Client = ActionClient[Count.Goal, Count.Result, Count.Feedback]
Tally = Counter[str]
Way = Callable[[Client, int, Tally], Awaitable[None]]


async def body(goal: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
    for count in range(FEEDBACK):
        yield Count.Feedback(count=count)
    if is_canceled(goal.number):
        await anyio.sleep_forever()
    await anyio.lowlevel.checkpoint()
    yield Count.Result(number=goal.number)


def is_canceled(number: int) -> bool:
    return number % CANCELED == 0


async def send(client: Client, number: int, tally: Tally) -> None:
    """Send one goal, follow it to its end, and count its outcome."""
    async with client.send_goal(Count.Goal(number=number)) as handle:
        expected = 0
        async for feedback in handle:
            assert feedback.count == expected
            expected += 1
            if expected == FEEDBACK and is_canceled(number):
                handle.cancel_nowait()
        outcome = await handle.outcome()
    tally["feedback"] += expected
    tally[outcome.status.name] += 1
    if outcome.status is GoalStatus.SUCCEEDED:
        assert outcome.result.number == number


def check(tally: Tally, goals: int) -> None:
    """Check that nothing is lost, and that nothing has come that was not sent."""
    canceled = len(range(0, goals, CANCELED))
    assert tally == {
        "feedback": FEEDBACK * goals,
        "CANCELED": canceled,
        "SUCCEEDED": goals - canceled,
    }, tally


class Memory(NamedTuple):
    """The bytes that Python holds: before the goals, after them, and at most."""

    before: int
    after: int
    peak: int


async def in_a_row(client: Client, goals: int, tally: Tally) -> None:
    for number in range(goals):
        await send(client, number, tally)


async def at_once(client: Client, goals: int, tally: Tally) -> None:
    async with anyio.create_task_group() as group:
        for number in range(goals):
            group.start_soon(send, client, number, tally)


async def timed(way: Way, client: Client, goals: int) -> float:
    """The CPU seconds per goal."""
    tally = Tally()
    start = time.process_time()
    await way(client, goals, tally)
    took = time.process_time() - start
    check(tally, goals)
    return took / goals


async def measured(way: Way, client: Client, goals: int) -> Memory:
    gc.collect()
    tracemalloc.start()
    for _ in range(2):  # what is made once, and stays: tables grow to the size that they need
        await timed(way, client, goals if way is at_once else goals // 100)
    gc.collect()
    before, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    await timed(way, client, goals)
    _, peak = tracemalloc.get_traced_memory()
    gc.collect()
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return Memory(before, after, peak)


async def print_soak(way: Way, client: Client, goals: int) -> None:
    """Run goals in ten parts one after another, or first a tenth at once and then all."""
    await timed(way, client, goals // 10)
    if way is in_a_row:
        tenths = [await timed(way, client, goals // 10) for _ in range(10)]
    else:
        tenths = [await timed(way, client, goals // 10), await timed(way, client, goals)]
    each = statistics.fmean(tenths) if way is in_a_row else tenths[-1]
    memory = await measured(way, client, goals)
    left = (memory.after - memory.before) / goals
    before, after, peak = (size / 1024 for size in memory)
    first, last = tenths[0] * 1e6, tenths[-1] * 1e6
    print(
        f"{way.__name__.replace('_', ' '):>8} {goals:>8,} {each * 1e6:>8.1f} {first:>8.1f}"
        f" {last:>8.1f} {last / first:>6.2f}x {before:>11,.1f} {after:>11,.1f} {left:>9.3f}"
        f" {peak:>11,.1f}"
    )


async def print_all(loop: str, share: int) -> None:
    """Run a share of all goals on one event loop."""
    print(
        f"\n{loop}\n{'':>8} {'goals':>8} {'us each':>8} {'tenth':>8} {'last':>8} {'ratio':>7}"
        f" {'KiB before':>11} {'KiB after':>11} {'B a goal':>9} {'KiB peak':>11}"
    )
    async with turtleact.open_node("bench") as node:
        node.action_server(Count, "count", body)
        client = node.action_client(Count, "count")
        await print_soak(in_a_row, client, IN_A_ROW // share)
        await print_soak(at_once, client, AT_ONCE // share)


def main() -> None:
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{os.cpu_count()} cores, {platform.machine()}, load {load}")
    print(f"Python {platform.python_version()}, anyio {version('anyio')}")
    print(f"nothing lost: {FEEDBACK} messages and one end a goal, every {CANCELED}th CANCELED")
    anyio.run(print_all, "asyncio", 1)
    for name, backend, options, share in [
        ("uvloop", "asyncio", {"use_uvloop": True}, 1),
        ("trio", "trio", {}, 10),
    ]:
        if importlib.util.find_spec(name):
            loop = f"{name} {version(name)}"
            anyio.run(print_all, loop, share, backend=backend, backend_options=options)
        else:
            print(f"\n{name} is skipped: it is not installed (pip install {name})")


if __name__ == "__main__":
    main()
