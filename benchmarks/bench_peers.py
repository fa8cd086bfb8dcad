"""What does a goal cost, compared with other ways to run a job from an asyncio program?

Each contender hands over a job and waits for its result: a goal of an action, a job of aiojobs, a
task of taskiq with its in-memory broker, or a function in a thread pool. None of the peers has a
goal's feedback, cancel and checked messages. In the second table, aiojobs and the threads therefore
get a queue for ten messages, written by hand.

Rounds are interleaved. A ratio is the median of the rounds' ratios, and a time is the median.
"""

from __future__ import annotations

import asyncio
import gc
import os
import platform
import queue
import statistics
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.metadata import version
from typing import Any, TypeAlias

import aiojobs
import taskiq

import turtleact
from turtleact import Action, ActionClient, Message
from turtleact.interfaces import int32

ROUNDS = 21
TIMES = 300
FEEDBACK = 10


class Count(Action, type_name="bench_msgs/action/Count"):
    class Goal(Message):
        target: int32 = 0

    class Result(Message):
        total: int32 = 0

    class Feedback(Message):
        value: int32 = 0


Client: TypeAlias = ActionClient[Count.Goal, Count.Result, Count.Feedback]
Contender: TypeAlias = Callable[[], Awaitable[object]]


async def answer(goal: Count.Goal) -> Count.Result:
    return Count.Result(total=goal.target)


async def count(goal: Count.Goal) -> AsyncGenerator[Count.Feedback | Count.Result, None]:
    for value in range(FEEDBACK):
        yield Count.Feedback(value=value)
    yield Count.Result(total=goal.target)


# --- the contenders: one job each -----------------------------------------------------------


async def call(client: Client) -> object:
    return await client.send_goal(Count.Goal(target=3))


async def send(client: Client) -> object:
    async with client.send_goal(Count.Goal(target=3)) as goal:
        return await goal.result()


async def read(client: Client) -> object:
    async with client.send_goal(Count.Goal(target=3)) as goal:
        messages = [feedback async for feedback in goal]
        await goal.result()
        return messages


async def spawn(scheduler: aiojobs.Scheduler) -> object:
    job = await scheduler.spawn(answer(Count.Goal(target=3)))
    return await job.wait()


async def spawn_and_read(scheduler: aiojobs.Scheduler) -> object:
    messages: asyncio.Queue[Count.Feedback] = asyncio.Queue()

    async def work(goal: Count.Goal) -> Count.Result:
        for value in range(FEEDBACK):
            messages.put_nowait(Count.Feedback(value=value))
        return Count.Result(total=goal.target)

    job = await scheduler.spawn(work(Count.Goal(target=3)))
    got = [await messages.get() for _ in range(FEEDBACK)]
    await job.wait()
    return got


async def kick(task: Any) -> object:  # noqa: ANN401  # a task of taskiq
    sent = await task.kiq(3)
    return (await sent.wait_result(check_interval=0)).return_value


async def submit(pool: ThreadPoolExecutor) -> object:
    def work(goal: Count.Goal) -> Count.Result:
        return Count.Result(total=goal.target)

    return await asyncio.get_running_loop().run_in_executor(pool, work, Count.Goal(target=3))


async def submit_and_read(pool: ThreadPoolExecutor) -> object:
    messages: queue.SimpleQueue[Count.Feedback] = queue.SimpleQueue()

    def work(goal: Count.Goal) -> Count.Result:
        for value in range(FEEDBACK):
            messages.put(Count.Feedback(value=value))
        return Count.Result(total=goal.target)

    await asyncio.get_running_loop().run_in_executor(pool, work, Count.Goal(target=3))
    return [messages.get_nowait() for _ in range(FEEDBACK)]


# --- measuring ------------------------------------------------------------------------------


async def seconds_each(contender: Contender) -> float:
    gc.collect()
    gc.disable()
    began = time.perf_counter()
    for _ in range(TIMES):
        await contender()
    gc.enable()
    return (time.perf_counter() - began) / TIMES


async def print_table(title: str, contenders: dict[str, Contender]) -> None:
    """Print a table. The other contenders are compared with the first."""
    rounds = [
        [await seconds_each(contender) for contender in contenders.values()] for _ in range(ROUNDS)
    ]
    print(f"\n{title:<34} {'us':>8} {'to the first':>13}")
    for number, name in enumerate(contenders):
        median = statistics.median(times[number] for times in rounds)
        ratio = statistics.median(times[number] / times[0] for times in rounds)
        print(f"{name:<34} {median * 1e6:>8,.1f} {ratio:>12.1f}x", flush=True)


async def main() -> None:
    packages = ", ".join(f"{name} {version(name)}" for name in ("aiojobs", "taskiq"))
    print(f"{os.cpu_count()} cores, Python {platform.python_version()}, {packages}")
    broker = taskiq.InMemoryBroker(await_inplace=False)

    @broker.task
    async def triple(target: int) -> int:
        return target

    async with turtleact.open_node("bench") as node, aiojobs.Scheduler() as scheduler:
        node.action_server(Count, "answer", answer)
        node.action_server(Count, "count", count)
        one, ten = node.action_client(Count, "answer"), node.action_client(Count, "count")
        await broker.startup()
        with ThreadPoolExecutor(1) as pool:
            results: dict[str, Contender] = {
                "turtleact, awaited": partial(call, one),
                "turtleact, entered": partial(send, one),
                "aiojobs": partial(spawn, scheduler),
                "thread pool": partial(submit, pool),
                "taskiq, in memory": partial(kick, triple),
            }
            await print_table("a result", results)
            messages: dict[str, Contender] = {
                "turtleact, read": partial(read, ten),
                "aiojobs and a queue": partial(spawn_and_read, scheduler),
                "thread pool and a queue": partial(submit_and_read, pool),
            }
            await print_table("a result and ten messages", messages)
        await broker.shutdown()


if __name__ == "__main__":
    asyncio.run(main())
