"""Does a goal cost more time or memory when there are more goals?

All goals start, are active at the same time, and end. Meanwhile other goals run one after another.
The minimum is a waiting task. For memory, the peer is an anyio version that follows the
documentation: a task in a task group, and for each goal an event, a cancel scope and a memory
object stream.

Rounds are interleaved. A ratio is the median of the rounds' ratios, and a time is the median. The
garbage collector is off during measurements.
"""

from __future__ import annotations

import asyncio
import gc
import importlib.util
import os
import platform
import statistics
import sys
import time
import tracemalloc
from collections.abc import Awaitable, Callable
from importlib.metadata import version
from typing import NamedTuple, cast

import anyio
from anyio.abc import TaskGroup

import turtleact
from turtleact import Action, ActionClient, Message
from turtleact.goals.client import SendGoal
from turtleact.interfaces import int32

IDLE = 10_000
LIVE = [1_000, 10_000, 100_000]
ROUNDS = 5
BESIDE = 2_000
"""This many goals run one after another while the others live."""


class Count(Action, type_name="bench_msgs/action/Count"):
    class Goal(Message):
        target: int32 = 0

    class Result(Message):
        total: int32 = 0


Client = ActionClient[Count.Goal, Count.Result, Message]
Sending = SendGoal[Count.Goal, Count.Result, Message]
Start = Callable[[Count.Goal], Awaitable[object]]
Release = Callable[[list[object]], Awaitable[None]]


class Gate:
    """A server. Its body waits until the gate is opened, but a goal with a target ends at once."""

    def __init__(self) -> None:
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def body(self, goal: Count.Goal) -> Count.Result:
        if not goal.target:
            await self.opened
        return Count.Result(total=goal.target)


class Holder(NamedTuple):
    """Starts goals, and forgets them after they have ended."""

    start: Start
    release: Release


def hold_tasks(gate: Gate) -> Holder:
    async def start(goal: Count.Goal) -> object:
        return asyncio.create_task(gate.body(goal))

    async def release(tasks: list[object]) -> None:
        for task in cast("list[asyncio.Task[Count.Result]]", tasks):
            await task

    return Holder(start, release)


class AnyioGoal:
    def __init__(self, request: Count.Goal) -> None:
        self.request = request
        self.result: Count.Result | None = None
        self.ended = anyio.Event()
        self.scope = anyio.CancelScope()
        self.writer, self.reader = anyio.create_memory_object_stream[Message](16)

    async def run(self, gate: Gate) -> None:
        with self.scope, self.writer:
            self.result = await gate.body(self.request)
        self.ended.set()


def hold_anyio(gate: Gate, group: TaskGroup) -> Holder:
    async def start(request: Count.Goal) -> object:
        goal = AnyioGoal(request)
        group.start_soon(goal.run, gate)
        return goal

    async def release(goals: list[object]) -> None:
        for goal in cast("list[AnyioGoal]", goals):
            await goal.ended.wait()
            goal.reader.close()

    return Holder(start, release)


def hold_goals(client: Client) -> Holder:
    """A holder that keeps what ``async with`` keeps: the entered object, and with it the handle."""

    async def start(goal: Count.Goal) -> object:
        sending = client.send_goal(goal)
        await sending.__aenter__()
        return sending

    async def release(sendings: list[object]) -> None:
        for sending in cast("list[Sending]", sendings):
            await sending.__aexit__(None, None, None)

    return Holder(start, release)


async def let_all_run() -> None:
    await asyncio.sleep(0)
    await asyncio.sleep(0)


# --- memory ---------------------------------------------------------------------------------


async def bytes_each(gate: Gate, holder: Holder) -> float:
    """The memory of a waiting goal."""
    gc.collect()
    tracemalloc.start()
    held = [await holder.start(Count.Goal()) for _ in range(IDLE)]
    await let_all_run()
    taken, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    gate.opened.set_result(None)
    await let_all_run()
    await holder.release(held)
    return taken / IDLE


async def print_memory(node: turtleact.Node, group: TaskGroup) -> None:
    gates = [Gate(), Gate(), Gate()]
    server = node.action_server(Count, "idle", gates[2].body)
    floor = await bytes_each(gates[0], hold_tasks(gates[0]))
    peer = await bytes_each(gates[1], hold_anyio(gates[1], group))
    ours = await bytes_each(gates[2], hold_goals(node.action_client(Count, "idle")))
    await server.aclose()
    print(
        f"an idle goal: a task {floor:,.0f} bytes, anyio {peer:,.0f} ({peer / floor:.2f}x),"
        f" turtleact {ours:,.0f} ({ours / floor:.2f}x, {verdict(ours / floor, 2.5)})"
    )


def verdict(ratio: float, goal: float) -> str:
    return f"<= {goal:.2f}x {'met' if ratio <= goal else 'MISSED'}"


# --- time -----------------------------------------------------------------------------------


class Live(NamedTuple):
    """The seconds per goal, for goals that live together and for goals beside them.

    The last field is how many memory blocks per goal are left when all is over.
    """

    together: float
    beside: float
    left: float


async def measure(gate: Gate, holder: Holder, number: int) -> Live:
    gc.collect()
    gc.disable()
    blocks = sys.getallocatedblocks()
    start = time.perf_counter()
    held = [await holder.start(Count.Goal()) for _ in range(number)]
    started = time.perf_counter()
    for target in range(1, BESIDE + 1):
        await holder.release([await holder.start(Count.Goal(target=target))])
    beside = time.perf_counter() - started
    gate.opened.set_result(None)
    await let_all_run()
    await holder.release(held)
    together = time.perf_counter() - start - beside
    gc.enable()
    held.clear()
    gc.collect()
    left = sys.getallocatedblocks() - blocks
    return Live(together / number, beside / BESIDE, left / number)


async def measure_both(node: turtleact.Node, number: int) -> tuple[Live, Live]:
    gate = Gate()
    floor = await measure(gate, hold_tasks(gate), number)
    gate = Gate()
    server = node.action_server(Count, "live", gate.body)
    client = node.action_client(Count, "live")
    ours = await measure(gate, hold_goals(client), number)
    await client.aclose()
    await server.aclose()
    return floor, ours


async def print_growth(node: turtleact.Node) -> None:
    print(
        f"{'live at once':>12} {'task (us)':>10} {'turtleact':>10} {'ratio':>7} {'to 1,000':>9}"
        f" {'goal':>16} {'beside (us)':>12} {'to 1,000':>9} {'blocks left':>12}"
    )
    rounds = [[await measure_both(node, number) for number in LIVE] for _ in range(ROUNDS)]
    for index, number in enumerate(LIVE):
        floors, ours, firsts = zip(*[(*each[index], each[0][1]) for each in rounds], strict=True)
        floor = statistics.median(live.together for live in floors)
        mine = statistics.median(live.together for live in ours)
        ratio = median_ratio([live.together for live in ours], [live.together for live in floors])
        growth = median_ratio([live.together for live in ours], [live.together for live in firsts])
        beside = statistics.median(live.beside for live in ours)
        slower = median_ratio([live.beside for live in ours], [live.beside for live in firsts])
        left = min(live.left for live in ours)
        print(
            f"{number:>12,} {floor * 1e6:>10.1f} {mine * 1e6:>10.1f} {ratio:>6.2f}x"
            f" {growth:>8.2f}x {verdict(growth, 1.5):>16} {beside * 1e6:>12.1f}"
            f" {slower:>8.2f}x {left:>12.3f}"
        )


def median_ratio(values: list[float], bases: list[float]) -> float:
    return statistics.median(v / base for v, base in zip(values, bases, strict=True))


async def print_tables(loop: str) -> None:
    print(f"\n{loop}")
    async with turtleact.open_node("bench") as node, anyio.create_task_group() as group:
        await print_memory(node, group)
        await print_growth(node)


def main() -> None:
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{os.cpu_count()} cores, {platform.machine()}, load {load}")
    print(f"Python {platform.python_version()}, anyio {version('anyio')}")
    asyncio.run(print_tables("asyncio"))
    if not importlib.util.find_spec("uvloop"):
        print("\nuvloop is skipped: it is not installed (pip install uvloop)")
        return
    import uvloop

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(print_tables(f"uvloop {version('uvloop')}"))


if __name__ == "__main__":
    main()
