"""What does it cost to keep goals on disk?

The minimum is a bare commit of SQLite that waits for the disk (WAL, ``synchronous=FULL``), made in
a thread as any server must. Accepting a goal needs one, and a whole goal two. The peer is DBOS on
SQLite, if it is installed (``pip install dbos``): its workflow is durable when it has started and
when it has ended.

The contenders take turns. A ratio is the median of the rounds' ratios. Then 100 goals are in
flight. Last, the benchmark opens and reads a journal with a million ended goals.

Run it as ``python -m benchmarks.bench_journal``. The journals are in the current folder's file
system, not in memory.
"""

from __future__ import annotations

import asyncio
import gc
import importlib.util
import logging
import os
import platform
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import turtleact
from turtleact import Action, Message
from turtleact.interfaces import int32

ROUNDS = 15
IN_A_ROUND = 20
IN_FLIGHT = 100
BURST = 5_000
MANY = 1_000_000
HOUR_NS = 3600 * 10**9


class Count(Action, type_name="bench_msgs/action/Count"):
    class Goal(Message):
        target: int32 = 0

    class Result(Message):
        total: int32 = 0


class Cost(NamedTuple):
    """The times of one job.

    Attributes:
        accepted: The time until its start is known to be on disk (s); 0 if only the whole is
            measured.
        ended: The time from the beginning until its end is known to be on disk (s).
    """

    accepted: float
    ended: float


Measure = Callable[[], Awaitable[Cost]]


# --- the peers ------------------------------------------------------------------------------------


@asynccontextmanager
async def bare(folder: Path) -> AsyncIterator[Measure]:
    """One commit of about as many bytes as a goal, in a thread."""
    thread = ThreadPoolExecutor(1)
    loop = asyncio.get_running_loop()

    def begin() -> sqlite3.Connection:
        connection = sqlite3.connect(folder / "bare.db", isolation_level=None)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("CREATE TABLE goal (id BLOB PRIMARY KEY, content BLOB)")
        return connection

    connection = await loop.run_in_executor(thread, begin)
    insert = partial(connection.execute, "INSERT INTO goal VALUES (?, ?)")

    async def commit() -> Cost:
        began = time.perf_counter()
        await loop.run_in_executor(thread, insert, (os.urandom(16), bytes(200)))
        took = time.perf_counter() - began
        return Cost(took, took)

    yield commit
    await loop.run_in_executor(thread, connection.close)
    thread.shutdown()


@asynccontextmanager
async def goals(folder: Path) -> AsyncIterator[Measure]:
    """A goal with a body that ends on a signal."""
    gates = list[asyncio.Future[None]]()

    async def body(goal: Count.Goal) -> Count.Result:
        await gates[-1]
        return Count.Result(total=goal.target)

    async with (
        turtleact.open_journal(folder / "goals.db") as journal,
        turtleact.open_node("bench") as node,
    ):
        node.action_server(Count, "count", body, journal=journal, result_timeout=1.0)
        client = node.action_client(Count, "count")

        async def run() -> Cost:
            gates.append(asyncio.get_running_loop().create_future())
            began = time.perf_counter()
            async with client.send_goal(Count.Goal(target=1)) as handle:
                accepted = time.perf_counter()
                gates[-1].set_result(None)
                await handle.result()
                ended = time.perf_counter()
            gates.clear()
            return Cost(accepted - began, ended - began)

        yield run


@asynccontextmanager
async def dbos(folder: Path) -> AsyncIterator[Measure]:
    """A workflow that does nothing."""
    module: Any = importlib.import_module("dbos")
    config = {
        "name": "bench",
        "system_database_url": f"sqlite:///{folder / 'dbos.db'}",
        "log_level": "ERROR",
        "run_admin_server": False,
    }
    module.DBOS(config=config)

    @module.DBOS.workflow()
    async def work(number: int) -> int:
        return number

    module.DBOS.launch()

    async def run() -> Cost:
        began = time.perf_counter()
        handle = await module.DBOS.start_workflow_async(work, 1)
        accepted = time.perf_counter()
        await handle.get_result()
        return Cost(accepted - began, time.perf_counter() - began)

    yield run
    module.DBOS.destroy()


# --- one at a time --------------------------------------------------------------------------------


async def compare(folder: Path) -> None:
    """Let all contenders take turns, and print their times and ratios."""
    peers = {"bare commit": bare, "goal": goals}
    if importlib.util.find_spec("dbos"):
        peers["DBOS workflow"] = dbos
    costs: dict[str, list[Cost]] = {name: [] for name in peers}
    async with AsyncExitStack() as stack:
        runs = {name: await stack.enter_async_context(each(folder)) for name, each in peers.items()}
        for run in runs.values():
            await run()
        for _ in range(ROUNDS):
            for name, run in runs.items():
                taken = [await run() for _ in range(IN_A_ROUND)]
                costs[name].append(
                    Cost(*(statistics.median(part) for part in zip(*taken, strict=True)))
                )
    print(f"{'':16}{'accepted':>12}{'ratio':>8}{'ended':>12}{'ratio':>8}")
    for name, rounds in costs.items():
        cells = ""
        for part in range(2):
            took = statistics.median(each[part] for each in rounds)
            pairs = zip(rounds, costs["bare commit"], strict=True)
            ratio = statistics.median(each[part] / least.ended for each, least in pairs)
            cells += f"{took * 1e3:9.2f} ms{ratio:8.2f}"
        print(f"{name:16}{cells}")


# --- many at once ---------------------------------------------------------------------------------


async def rush(folder: Path) -> None:
    """Print how many goals a second end with a hundred in flight, and whether memory grows."""

    async def body(goal: Count.Goal) -> Count.Result:
        return Count.Result(total=goal.target)

    async with (
        turtleact.open_journal(folder / "rush.db") as journal,
        turtleact.open_node("bench") as node,
    ):
        node.action_server(Count, "count", body, journal=journal, result_timeout=0.5)
        client = node.action_client(Count, "count")

        async def sender(count: int) -> None:
            for _ in range(count):
                await client.send_goal(Count.Goal(target=1))

        rates, sizes = list[float](), list[int]()
        for _ in range(5):
            began = time.perf_counter()
            senders = (sender(BURST // IN_FLIGHT) for _ in range(IN_FLIGHT))
            await asyncio.gather(*senders)
            rates.append(BURST / (time.perf_counter() - began))
            gc.collect()
            sizes.append(resident())
    rate = statistics.median(rates)
    print(f"{IN_FLIGHT} in flight: {rate:,.0f} durable goals/s (median of {len(rates)} bursts)")
    print(
        f"resident memory after each burst of {BURST:,} goals: "
        f"{', '.join(f'{size / 2**20:.1f}' for size in sizes)} MiB"
    )


def resident() -> int:
    """The memory of this process (bytes); 0 if the system does not report it."""
    try:
        pages = Path("/proc/self/statm").read_text("ascii").split()[1]
    except OSError:
        return 0
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


# --- a large file ---------------------------------------------------------------------------------


async def large(folder: Path) -> None:
    """Print how long a journal with a million ended goals takes to open and to read."""
    path = folder / "large.db"
    async with turtleact.open_journal(path):
        pass
    fill(path, MANY)
    before = resident()
    began = time.perf_counter()
    async with turtleact.open_journal(path):
        opened = time.perf_counter() - began
        grown = (resident() - before) / 2**20
        command = [sys.executable, "-m", "turtleact", "goals", "--journal", str(path)]
        began = time.perf_counter()
        listed = await asyncio.to_thread(
            subprocess.run, [*command, "--since", "1h"], capture_output=True, check=True
        )
        took = time.perf_counter() - began
    began = time.perf_counter()
    subprocess.run([*command[:3], "--version"], capture_output=True, check=True)
    empty = time.perf_counter() - began
    lines = listed.stdout.count(b"\n") - 1
    size = sum(part.stat().st_size for part in folder.glob("large.db*")) / 2**20
    print(
        f"{MANY:,} ended goals ({size:.0f} MiB): opened in {opened:.3f} s with {grown:.1f} MiB; "
        f"'goals --since 1h' prints {lines} goals in {took:.2f} s "
        f"('turtleact --version' takes {empty:.2f} s)"
    )


def fill(path: Path, count: int) -> None:
    """Write ended goals into a journal, one a minute up to now."""
    now = time.time_ns()
    connection = sqlite3.connect(path)
    columns = [row[1] for row in connection.execute("PRAGMA table_info(goal)")]
    values: dict[str, object] = {
        "action": "/count",
        "type_name": Count.type_name,
        "type_hash": "RIHS01_" + "0" * 64,
        "status": 4,
        "request": bytes(64),
        "result": bytes(64),
        "feedback": bytes(64),
        "sender": bytes(16),
        "partial_result": b"",
        "reason": "",
    }

    def row(number: int) -> tuple[object, ...]:
        accepted = now - (count - number) * 60 * 10**9
        own = {
            "number": number + 1,
            "id": number.to_bytes(16),
            "stamp": accepted,
            "accepted": accepted,
            "ended": accepted + 10**9,
            "expires": accepted + 11 * 10**9,
        }
        return tuple({**values, **own}.get(name, 0) for name in columns)

    marks = ", ".join("?" * len(columns))
    with connection:
        connection.executemany(f"INSERT INTO goal VALUES ({marks})", map(row, range(count)))  # noqa: S608  # our own names
    connection.close()


def main() -> None:
    logging.disable(logging.WARNING)
    peer = f", DBOS {version('dbos')}" if importlib.util.find_spec("dbos") else ""
    print(
        f"Python {platform.python_version()}, SQLite {sqlite3.sqlite_version}{peer}, "
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    )
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        for part in (compare, rush, large):
            asyncio.run(part(Path(folder)))


if __name__ == "__main__":
    main()
