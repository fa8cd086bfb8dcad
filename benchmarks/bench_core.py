"""What does a goal cost, compared with bare asyncio and with an idiomatic anyio version?

The minimum ("floor") does the same work with only tasks (eager ones from Python 3.12 on) and
queues. It creates the same messages but checks none of them. turtleact checks and copies each
message, because a bad value must raise where it is sent and a body may change what it has
published. The rows "of that, snapshots" show how much of the row above is due to this. The anyio
version follows the documentation: one task group, and for each goal an event, a cancel scope and a
memory object stream. It checks nothing either.

Rounds are interleaved. A ratio is the median of the rounds' ratios, and a time is the median. The
garbage collector is off during measurements, which hides the cost of reference cycles. Therefore
the line below each table tells how many objects a goal leaves to the collector.

A goal has one public reader, its sender. The other readers of the fan-out are handles made by hand
for the sender's goal. "One by one" means that each message is read before the next is published.
"""

from __future__ import annotations

import asyncio
import gc
import importlib.util
import inspect
import math
import os
import platform
import statistics
import sys
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple, TypeVar, cast

import anyio
import anyio.lowlevel
from anyio.abc import TaskGroup

import turtleact
from turtleact import Action, ActionClient, ClientGoalHandle, Message
from turtleact.interfaces import int32, snapshotter

ROUNDS = 31
FEEDBACK = 10
WATCHERS = 1_000


class Count(Action, type_name="bench_msgs/action/Count"):
    class Goal(Message):
        target: int32 = 0

    class Result(Message):
        total: int32 = 0

    class Feedback(Message):
        value: int32 = 0


T = TypeVar("T")

Contender = Callable[[int], Awaitable[None]]
Body = Callable[[Count.Goal], Coroutine[object, object, Count.Result]]
Client = ActionClient[Count.Goal, Count.Result, Count.Feedback]
Handle = ClientGoalHandle[Count.Result, Count.Feedback]


# --- what is done for a goal ----------------------------------------------------------------


async def answer(goal: Count.Goal) -> Count.Result:
    return Count.Result(total=goal.target)


async def wait_once(goal: Count.Goal) -> Count.Result:
    await asyncio.sleep(0)
    return Count.Result(total=goal.target)


async def wait_for_ever(goal: Count.Goal) -> Count.Result:
    await asyncio.get_running_loop().create_future()
    return Count.Result(total=goal.target)


async def count(goal: Count.Goal) -> AsyncGenerator[Count.Feedback | Count.Result, None]:
    for value in range(goal.target):
        yield Count.Feedback(value=value)
    yield Count.Result(total=goal.target)


async def count_in_step(goal: Count.Goal) -> AsyncGenerator[Count.Feedback | Count.Result, None]:
    for value in range(goal.target):
        yield Count.Feedback(value=value)
        await asyncio.sleep(0)  # all who wait read it now
    yield Count.Result(total=goal.target)


# --- bare asyncio ---------------------------------------------------------------------------

Queue = asyncio.Queue[Count.Feedback | None]


async def count_into(queues: list[Queue], goal: Count.Goal, *, in_step: bool) -> Count.Result:
    for value in range(goal.target):
        feedback = Count.Feedback(value=value)
        for queue in queues:
            queue.put_nowait(feedback)
        if in_step:
            await asyncio.sleep(0)
    for queue in queues:
        queue.put_nowait(None)
    return Count.Result(total=goal.target)


async def read_queue(queue: Queue) -> int:
    seen = 0
    while await queue.get() is not None:
        seen += 1
    return seen


def start(body: Coroutine[object, object, T]) -> asyncio.Task[T]:
    """Start a plain task, eagerly where Python can."""
    if sys.version_info >= (3, 12):
        return asyncio.Task(body, loop=asyncio.get_running_loop(), eager_start=True)
    return asyncio.create_task(body)


async def floor_goals(body: Body, times: int) -> None:
    for number in range(times):
        await start(body(Count.Goal(target=number)))


async def floor_feedback(watchers: int, in_step: bool, times: int) -> None:
    for _ in range(times):
        queues: list[Queue] = [asyncio.Queue() for _ in range(watchers)]
        others = [start(read_queue(queue)) for queue in queues[1:]]
        body = count_into(queues, Count.Goal(target=FEEDBACK), in_step=in_step)
        task = start(body)
        assert await read_queue(queues[0]) == FEEDBACK
        assert all([await other == FEEDBACK for other in others])
        await task


async def floor_cancel(times: int) -> None:
    for _ in range(times):
        task = start(wait_for_ever(Count.Goal()))
        await asyncio.sleep(0)
        task.cancel()
        try:
            await task
        except asyncio.CancelledError:
            continue


# --- anyio by the book ----------------------------------------------------------------------


class AnyioGoal:
    def __init__(self, request: Count.Goal, watchers: int) -> None:
        self.request = request
        self.result: Count.Result | None = None
        self.ended = anyio.Event()
        self.scope = anyio.CancelScope()
        streams = [anyio.create_memory_object_stream[Message](math.inf) for _ in range(watchers)]
        self.writers = [send for send, _ in streams]
        self.readers = [receive for _, receive in streams]


class AnyioServer:
    def __init__(self, group: TaskGroup, body: Callable[[Count.Goal], object]) -> None:
        self.group = group
        self.body = body
        self.is_generator = inspect.isasyncgenfunction(body)

    def begin(self, request: Count.Goal, watchers: int = 1) -> AnyioGoal:
        goal = AnyioGoal(request, watchers)
        self.group.start_soon(self.run, goal)
        return goal

    async def run(self, goal: AnyioGoal) -> None:
        try:
            with goal.scope:
                if self.is_generator:
                    await self.drive(goal)
                else:
                    goal.result = await cast("Body", self.body)(goal.request)
        finally:
            for writer in goal.writers:
                writer.close()
            goal.ended.set()

    async def drive(self, goal: AnyioGoal) -> None:
        async for item in cast("AsyncGenerator[Message, None]", self.body(goal.request)):
            if isinstance(item, Count.Result):
                goal.result = item
            else:
                for writer in goal.writers:
                    await writer.send(item)

    async def goals(self, times: int) -> None:
        for number in range(times):
            goal = self.begin(Count.Goal(target=number))
            await goal.ended.wait()
            goal.readers[0].close()

    async def feedback(self, watchers: int, times: int) -> None:
        for _ in range(times):
            goal = self.begin(Count.Goal(target=FEEDBACK), watchers)
            async with anyio.create_task_group() as readers:
                for number in range(1, watchers):
                    readers.start_soon(self.read, goal, number)
                await self.read(goal, 0)
            await goal.ended.wait()

    async def read(self, goal: AnyioGoal, number: int) -> None:
        async with goal.readers[number] as reader:
            assert len([feedback async for feedback in reader]) == FEEDBACK

    async def cancel(self, times: int) -> None:
        for _ in range(times):
            goal = self.begin(Count.Goal())
            await anyio.lowlevel.checkpoint()
            goal.scope.cancel()
            await goal.ended.wait()
            goal.readers[0].close()


# --- turtleact ------------------------------------------------------------------------------


async def call(client: Client, times: int) -> None:
    for number in range(times):
        await client.send_goal(Count.Goal(target=number))


async def send(client: Client, times: int) -> None:
    for number in range(times):
        async with client.send_goal(Count.Goal(target=number)) as goal:
            await goal.result()


async def call_with_feedback(client: Client, times: int) -> None:
    for _ in range(times):
        seen: list[Count.Feedback] = []
        await client.send_goal(Count.Goal(target=FEEDBACK), feedback_callback=seen.append)
        assert len(seen) == FEEDBACK


async def send_with_feedback(watchers: int, client: Client, times: int) -> None:
    for _ in range(times):
        async with client.send_goal(Count.Goal(target=FEEDBACK)) as goal:
            others = [
                asyncio.create_task(read_handle(await client.attach(goal.goal_id)))
                for _ in range(1, watchers)
            ]
            assert await read_handle(goal) == FEEDBACK
            assert all([await other == FEEDBACK for other in others])
            await goal.result()


async def read_handle(handle: Handle) -> int:
    seen = 0
    async for _ in handle:
        seen += 1
    return seen


async def cancel(client: Client, times: int) -> None:
    for _ in range(times):
        async with client.send_goal(Count.Goal()) as goal:
            await goal.cancel()
            await goal.outcome()


async def leave(client: Client, times: int) -> None:
    for _ in range(times):
        async with client.send_goal(Count.Goal()):
            pass


def snapshots(feedback: int) -> Contender:
    """Make only the checked copies that a goal needs."""
    goal, result, message = Count.Goal(), Count.Result(), Count.Feedback()
    copy_goal, copy_result = snapshotter(Count.Goal), snapshotter(Count.Result)
    copy_feedback = snapshotter(Count.Feedback)

    async def run(times: int) -> None:
        for _ in range(times):
            copy_goal(goal)
            for _ in range(feedback):
                copy_feedback(message)
            copy_result(result)

    return run


# --- measuring ------------------------------------------------------------------------------


class Row(NamedTuple):
    name: str
    times: int
    floor: Contender
    anyio: Contender | None
    turtleact: Contender
    goal: float | None = None


async def seconds_each(contender: Contender, times: int) -> float:
    start = time.perf_counter()
    await contender(times)
    return (time.perf_counter() - start) / times


async def garbage_each(contender: Contender) -> int:
    """How many objects each goal leaves to the garbage collector."""
    times = 20
    await contender(1)
    gc.collect()
    gc.disable()
    await contender(times)
    found = gc.collect()
    gc.enable()
    return found // times


async def garbage(rows: list[Row]) -> str:
    most = [
        max([await garbage_each(contender) for contender in contenders])
        for contenders in (
            [row.turtleact for row in rows if row.times > 1],
            [row.anyio for row in rows if row.times > 1 and row.anyio],
        )
    ]
    return f"a goal leaves to the garbage collector: turtleact {most[0]} objects, anyio {most[1]}"


async def compare(row: Row) -> str:
    contenders = [row.floor, row.turtleact] + ([row.anyio] if row.anyio else [])
    for contender in contenders:
        await contender(max(1, row.times // 10))
    rounds: list[list[float]] = []
    for _ in range(ROUNDS):
        gc.collect()
        gc.disable()
        rounds.append([await seconds_each(contender, row.times) for contender in contenders])
        gc.enable()
    floor = statistics.median(times[0] for times in rounds)
    ratio = statistics.median(times[1] / times[0] for times in rounds)
    cells = f"{row.name:<28} {floor * 1e6:>10,.1f}"
    if row.anyio is None:
        return f"{cells} {'':>7} {ratio:>9.2f}x"
    peer = statistics.median(times[2] / times[0] for times in rounds)
    ahead = statistics.median(times[2] / times[1] for times in rounds)
    return f"{cells} {peer:>6.1f}x {ratio:>9.2f}x {verdict(ratio, row.goal):>17} {ahead:>17.1f}x"


def goal(ratio: float) -> float:
    """The ratio to reach, against a plain task on 3.11 and an eager task from 3.12 on."""
    return ratio if sys.version_info < (3, 12) else 1.7


def verdict(ratio: float, goal: float | None) -> str:
    return "" if goal is None else f"<= {goal:.2f}x {'met' if ratio <= goal else 'MISSED'}"


def rows(node: turtleact.Node, group: TaskGroup) -> list[Row]:
    def peer(body: Callable[[Count.Goal], object]) -> AnyioServer:
        return AnyioServer(group, body)

    def ours(contender: Callable[[Client, int], Awaitable[None]], body: str) -> Contender:
        return partial(contender, node.action_client(Count, body))

    for body in (answer, wait_once, wait_for_ever, count, count_in_step):
        node.action_server(Count, body.__name__, body)
    one, ten = partial(floor_goals, answer), partial(floor_feedback, 1, False)
    one_peer, ten_peer = peer(answer).goals, partial(peer(count).feedback, 1)
    waiting, waiting_peer = partial(floor_goals, wait_once), peer(wait_once).goals
    read_one, read_all = partial(send_with_feedback, 1), partial(send_with_feedback, WATCHERS)
    step, step_peer = partial(floor_feedback, 1, True), partial(peer(count_in_step).feedback, 1)
    fan_out = partial(floor_feedback, WATCHERS, False)
    fan_out_peer = partial(peer(count).feedback, WATCHERS)
    fan_1 = partial(floor_feedback, WATCHERS, True)
    fan_1_peer = partial(peer(count_in_step).feedback, WATCHERS)
    stop, stop_peer = floor_cancel, peer(wait_for_ever).cancel
    return [
        Row("call", 500, one, one_peer, ours(call, "answer"), goal(3.0)),
        Row("send", 500, one, one_peer, ours(send, "answer"), goal(3.2)),
        Row("   of that, snapshots", 500, one, None, snapshots(0)),
        Row("call, the body waits", 300, waiting, waiting_peer, ours(call, "wait_once")),
        Row("send, the body waits", 300, waiting, waiting_peer, ours(send, "wait_once")),
        Row("10 feedback, call", 200, ten, ten_peer, ours(call_with_feedback, "count"), goal(2.0)),
        Row("10 feedback, send", 200, ten, ten_peer, ours(read_one, "count"), goal(2.4)),
        Row("   of that, snapshots", 200, ten, None, snapshots(FEEDBACK)),
        Row("10 feedback, one by one", 100, step, step_peer, ours(read_one, "count_in_step")),
        Row("1,000 watchers", 1, fan_out, fan_out_peer, ours(read_all, "count"), 1.0),
        Row("1,000 watchers, one by one", 1, fan_1, fan_1_peer, ours(read_all, "count_in_step")),
        Row("cancel", 200, stop, stop_peer, ours(cancel, "wait_for_ever"), goal(3.5)),
        Row("cancel by leaving the block", 200, stop, stop_peer, ours(leave, "wait_for_ever")),
    ]


# --- one table a loop -----------------------------------------------------------------------


async def print_tables(loop: str) -> None:
    print(
        f"\n{loop:<28} {'floor (us)':>10} {'anyio':>7} {'turtleact':>10} {'goal':>17}"
        f" {'anyio / turtleact':>18}"
    )
    async with turtleact.open_node("bench") as node, anyio.create_task_group() as group:
        table = rows(node, group)
        for row in table:
            print(await compare(row), flush=True)
        print(await garbage(table))


def machine() -> str:
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor() or platform.machine()
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    return f"{os.cpu_count()} cores, {model}, load {load}"


def main() -> None:
    print(machine())
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
