"""What does a goal cost between two processes, compared with a bare socket and other RPC?

The minimum is msgpack over a unix socket: two calls per goal, one message per feedback, no checks,
no discovery, no status. grpc.aio and websockets with JSON do the same over TCP, if installed.
turtleact is a node in each process, with Zenoh over TCP between them. "Awaited" is
``await client.send_goal``. "Entered" is ``async with``, which also follows the status of all goals.
Everywhere a goal is two calls: one sends it, one waits for its result. A cancel is the time from
the request to the end of the goal.

Rounds are interleaved. A ratio is the median of the rounds' ratios, and a time is the median. A
feedback message that is lost, or arrives after its result, is an error.

With ``--soak``, goals run one after another and many at once, and leftovers are counted.
Run it as ``python -m benchmarks.bench_wire``.
"""

from __future__ import annotations

import asyncio
import gc
import importlib.util
import multiprocessing
import os
import platform
import socket
import statistics
import sys
import tempfile
import time
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from importlib.metadata import version
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple, TypeAlias

import turtleact
from benchmarks import wire_peers as peers
from benchmarks.wire_peers import Contender, Open, Serve
from turtleact import Action, ActionClient, GoalStatus, Message
from turtleact.goals.remote import RemoteGoal
from turtleact.interfaces import int32
from turtleact.transports import open_zenoh

ROUNDS = 7
GOALS = 200
AT_ONCE = 100
SMALL, LARGE = 20_000, 2_000
"""The numbers of feedback messages of ten ints and of 4 kB."""

IN_A_ROW, TOGETHER = 10_000, 1_000
"""The numbers of goals of the soak: one after another, and at the same time."""

KEPT = 10.0
"""How long a server keeps a result (s)."""


class Count(Action, type_name="bench_msgs/action/Count"):
    class Goal(Message):
        feedback: int32 = 0
        is_large: bool = False
        is_endless: bool = False

    class Result(Message):
        total: int32 = 0

    class Feedback(Message):
        numbers: list[int32] = []
        text: str = ""


Client: TypeAlias = ActionClient[Count.Goal, Count.Result, Count.Feedback]


# --- turtleact ------------------------------------------------------------------------------


async def count(goal: Count.Goal) -> AsyncGenerator[Count.Feedback | Count.Result, None]:
    feedback = (
        Count.Feedback(text=peers.TEXT) if goal.is_large else Count.Feedback(numbers=peers.NUMBERS)
    )
    for _ in range(goal.feedback):
        yield feedback
    if goal.is_endless:
        await asyncio.get_running_loop().create_future()
    yield Count.Result(total=goal.feedback)


class Awaited:
    """Sends goals with ``await``."""

    def __init__(self, client: Client) -> None:
        self._client = client

    async def goal(self) -> None:
        await self._client.send_goal(Count.Goal())

    async def feedback(self, count: int, *, is_large: bool) -> int:
        seen: list[Count.Feedback] = []
        goal = Count.Goal(feedback=count, is_large=is_large)
        await self._client.send_goal(goal, feedback_callback=seen.append)
        in_time = len(seen)
        await self._client.send_goal(Count.Goal(feedback=1))  # what is late has come before this
        assert len(seen) == in_time, f"{len(seen) - in_time} messages came after the result"
        return in_time

    async def cancel(self) -> float:
        started = asyncio.Event()
        goal = Count.Goal(feedback=1, is_endless=True)
        sent = self._client.send_goal(goal, feedback_callback=lambda _: started.set())
        running = asyncio.create_task(sent)
        await started.wait()
        began = time.perf_counter()
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running
        return time.perf_counter() - began


class Entered:
    """Sends goals with ``async with``."""

    def __init__(self, client: Client) -> None:
        self._client = client

    async def goal(self) -> None:
        async with self._client.send_goal(Count.Goal()) as goal:
            await goal.result()

    async def feedback(self, count: int, *, is_large: bool) -> int:
        sent = Count.Goal(feedback=count, is_large=is_large)
        async with self._client.send_goal(sent) as goal:
            return len([feedback async for feedback in goal])

    async def cancel(self) -> float:
        async with self._client.send_goal(Count.Goal(is_endless=True)) as goal:
            began = time.perf_counter()
            await goal.cancel()
            outcome = await goal.outcome()
        assert outcome.status is GoalStatus.CANCELED
        return time.perf_counter() - began


async def serve_node(at: str, pipe: Connection) -> None:
    """Serve both actions. Each word on the pipe is answered with what the server still holds."""
    async with (
        open_zenoh([], mode="router", listen=[f"tcp/{at}"]) as transport,
        turtleact.open_node("server", transport=transport) as node,
    ):
        servers = [
            node.action_server(Count, name, count, result_timeout=KEPT)
            for name in ("awaited", "entered")
        ]
        await transport.flush()
        pipe.send("ready")
        with suppress(EOFError):
            while await asyncio.to_thread(pipe.recv) == "look":
                held = sum(not server.is_idle for server in servers)
                pipe.send(State.now(held, len(transport.context.crew.running)))


@asynccontextmanager
async def open_client(at: str, name: str) -> AsyncIterator[Client]:
    async with (
        open_zenoh([f"tcp/{at}"], listen=[]) as transport,
        turtleact.open_node("client", transport=transport) as node,
    ):
        client = node.action_client(Count, name)
        assert await client.wait_for_server(10)
        yield client


@asynccontextmanager
async def open_awaited(at: str) -> AsyncIterator[Contender]:
    async with open_client(at, "awaited") as client:
        yield Awaited(client)


@asynccontextmanager
async def open_entered(at: str) -> AsyncIterator[Contender]:
    async with open_client(at, "entered") as client:
        yield Entered(client)


# --- processes ------------------------------------------------------------------------------


class Kind(NamedTuple):
    """A contender.

    Attributes:
        needs: Its packages: their names for import and for installation.
    """

    name: str
    serve: Serve
    open: Open
    needs: tuple[str, str] | None = None


KINDS = [
    Kind("bare socket", peers.serve_socket, peers.open_socket),
    Kind("awaited", serve_node, open_awaited),
    Kind("entered", serve_node, open_entered),
    Kind("grpc.aio", peers.serve_grpc, peers.open_grpc, ("grpc", "grpcio")),
    Kind("websockets", peers.serve_websockets, peers.open_websockets, ("websockets", "websockets")),
]


def serve(number: int, at: str, pipe: Connection) -> None:
    """Run a server's process."""
    asyncio.run(KINDS[number].serve(at, pipe))


@asynccontextmanager
async def serving(kind: Kind, folder: Path) -> AsyncIterator[tuple[str, Connection]]:
    """Run a server in its own process. The block gets its address and a connection for commands."""
    if kind.serve is peers.serve_socket:
        at = str(folder / "socket")
    else:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            at = f"127.0.0.1:{free.getsockname()[1]}"
    ours, theirs = multiprocessing.Pipe()
    spawning = multiprocessing.get_context("spawn")
    process = spawning.Process(target=serve, args=(KINDS.index(kind), at, theirs))
    process.start()
    theirs.close()
    try:
        assert await asyncio.to_thread(ours.recv) == "ready"
        yield at, ours
    finally:
        ours.close()
        await asyncio.to_thread(process.join, 30)
        process.kill()


# --- one table ------------------------------------------------------------------------------


async def goals(contender: Contender) -> list[float]:
    taken = []
    for _ in range(GOALS):
        began = time.perf_counter()
        await contender.goal()
        taken.append(time.perf_counter() - began)
    return taken


async def in_flight(contender: Contender) -> float:
    """The seconds per goal."""
    left = iter(range(10 * AT_ONCE))

    async def work() -> None:
        for _ in left:
            await contender.goal()

    began = time.perf_counter()
    async with asyncio.TaskGroup() as group:
        for _ in range(AT_ONCE):
            group.create_task(work())
    return (time.perf_counter() - began) / (10 * AT_ONCE)


async def feedback(contender: Contender, count: int, *, is_large: bool) -> float:
    """The seconds per message."""
    began = time.perf_counter()
    seen = await contender.feedback(count, is_large=is_large)
    assert seen == count, f"{count - seen} of {count} messages were lost"
    return (time.perf_counter() - began) / count


async def measure(contender: Contender) -> dict[str, float]:
    """Measure one round."""
    gc.collect()
    each = await goals(contender)
    return {
        "goal to result, p50": statistics.median(each),
        "goal to result, p99": statistics.quantiles(each, n=100)[98],
        f"{AT_ONCE} goals in flight": await in_flight(contender),
        "feedback, 10 ints": await feedback(contender, SMALL, is_large=False),
        "feedback, 4 kB": await feedback(contender, LARGE, is_large=True),
        "cancel": statistics.median([await contender.cancel() for _ in range(GOALS // 4)]),
    }


def print_table(rounds: list[list[dict[str, float]]], kinds: list[Kind]) -> None:
    print(
        f"\n{'us each':<22} {kinds[0].name:>12}" + "".join(f"{kind.name:>20}" for kind in kinds[1:])
    )
    for row in rounds[0][0]:
        floor = statistics.median(each[0][row] for each in rounds)
        cells = f"{row:<22} {floor * 1e6:>12,.1f}"
        for number in range(1, len(kinds)):
            median = statistics.median(each[number][row] for each in rounds)
            ratio = statistics.median(each[number][row] / each[0][row] for each in rounds)
            cells += f"{median * 1e6:>11,.1f} {ratio:>7.1f}x"
        print(cells)


async def compare(kinds: list[Kind], folder: Path) -> None:
    async with AsyncExitStack() as stack:
        contenders = []
        for kind in kinds:
            at, _ = await stack.enter_async_context(serving(kind, folder))
            contenders.append(await stack.enter_async_context(kind.open(at)))
        for contender in contenders:
            await goals(contender)
        rounds = [[await measure(contender) for contender in contenders] for _ in range(ROUNDS)]
    print_table(rounds, kinds)


# --- the soak -------------------------------------------------------------------------------


class State(NamedTuple):
    """The resources that a process holds.

    Attributes:
        goals: Goals that its tables hold.
        tasks: What runs for them.
        objects: The objects that Python's garbage collector knows.
        memory: The memory of the process (KiB).
    """

    goals: int
    tasks: int
    objects: int
    memory: int

    @classmethod
    def now(cls, goals: int, tasks: int) -> State:
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return cls(goals, tasks, len(gc.get_objects()), pages * os.sysconf("SC_PAGE_SIZE") // 1024)


async def look(pipe: Connection) -> tuple[State, State]:
    """The resources that server and client hold once results are no longer kept."""
    await asyncio.sleep(KEPT + 0.5)
    pipe.send("look")
    theirs = await asyncio.to_thread(pipe.recv)
    followed = [each for each in gc.get_objects() if type(each) is RemoteGoal]
    return theirs, State.now(len(followed), len(asyncio.all_tasks()) - 1)


async def soak(kind: Kind, folder: Path) -> None:
    async with serving(kind, folder) as (at, pipe), open_client(at, kind.name) as client:
        contender: Contender = Awaited(client) if kind.open is open_awaited else Entered(client)
        for title, count, is_together in (
            ("in a row", IN_A_ROW, False),
            ("at once", TOGETHER, True),
            ("at once", TOGETHER, True),
        ):
            await goals(contender)
            before = await look(pipe)
            began = time.perf_counter()
            async with asyncio.timeout(600):
                if is_together:
                    await asyncio.gather(*(contender.goal() for _ in range(count)))
                else:
                    for _ in range(count):
                        await contender.goal()
            each = (time.perf_counter() - began) / count * 1e6
            after = await look(pipe)
            for side, old, new in zip(("server", "client"), before, after, strict=True):
                print(
                    f"{kind.name:<9}{title:<9}{count:>7,}{each:>8,.0f} {side:<7}{new.goals:>6}"
                    f"{new.tasks:>6}{old.objects:>9,}{new.objects:>9,}{old.memory:>9,}"
                    f"{new.memory:>9,}",
                    flush=True,
                )


def main() -> None:
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{os.cpu_count()} cores, {platform.machine()}, load {load}")
    print(f"Python {platform.python_version()}, eclipse-zenoh {version('eclipse-zenoh')}")
    kinds = []
    for kind in KINDS:
        if kind.needs is None:
            kinds.append(kind)
        elif importlib.util.find_spec(kind.needs[0]):
            kinds.append(kind)
            print(f"{kind.needs[1]} {version(kind.needs[1])}")
        else:
            print(f"{kind.name} is skipped: it is not installed (pip install {kind.needs[1]})")
    with tempfile.TemporaryDirectory() as name:
        if "--soak" not in sys.argv[1:]:
            asyncio.run(compare(kinds, Path(name)))
            return
        print(
            f"\n{'':<18}{'goals':>7}{'us each':>8} {'held by':<7}{'goals':>6}{'tasks':>6}"
            f"{'objects':>9}{'after':>9}{'KiB':>9}{'after':>9}"
        )
        for kind in KINDS[1:3]:
            asyncio.run(soak(kind, Path(name)))


if __name__ == "__main__":
    main()
