"""What does a fleet cost on one router, and which costs grow faster than the fleet?

Robots are nodes with one action server each, in at most ten processes, because a process costs more
memory than a node. Their clients are nodes in ten other processes. There is one client per server,
or one server for all clients. Peers talk to each other directly after the router has introduced
them; clients talk only through the router. A goal publishes ten feedback messages of ten ints. It
is sent with ``async with``, so its client also follows the status topic.

In each row, all nodes declare their endpoints at once. "Met" is the time until each client can
reach its server. Then another process joins; "joined" is the time until it knows everybody. Then
100 goals are sent one after another, by the clients in turn, and 1,000 at once. CPU and bytes are
measured for the 1,000 goals: of all processes together, per goal. Bytes are counted on the loopback
device of a separate network, with all headers, once for each hop.

Needs Linux, and root or user namespaces for that network. Run ``python -m benchmarks.bench_fleet``.
"""

from __future__ import annotations

import asyncio
import ctypes
import multiprocessing
import os
import platform
import resource
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from importlib.metadata import version
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import turtleact
from turtleact import Action, ActionClient, Message
from turtleact.interfaces import int32
from turtleact.transports import open_zenoh

AT = "tcp/127.0.0.1:7447"
PROCESSES = 10
IN_TURN = 100
AT_ONCE = 1_000
FEEDBACK = 10
KEPT = 60.0
"""How long results are kept (s). A hundred clients with a thousand goals ask for results late."""
NUMBERS = list(range(10))

CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000

Mode: TypeAlias = Literal["peer", "client"]


class Count(Action, type_name="bench_msgs/action/Count"):
    class Goal(Message):
        feedback: int32 = 0

    class Result(Message):
        total: int32 = 0

    class Feedback(Message):
        numbers: list[int32] = []


Client: TypeAlias = ActionClient[Count.Goal, Count.Result, Count.Feedback]


class Fleet(NamedTuple):
    """The fleet of one row: the numbers of robots and clients, and how they talk."""

    mode: Mode
    servers: int
    clients: int


FLEETS = [
    Fleet(mode, servers, clients)
    for mode in ("peer", "client")
    for servers, clients in ((1, 1), (10, 10), (100, 100), (1, 10), (1, 100))
]


# --- processes ------------------------------------------------------------------------------


async def count(goal: Count.Goal) -> AsyncGenerator[Count.Feedback | Count.Result, None]:
    for _ in range(goal.feedback):
        yield Count.Feedback(numbers=NUMBERS)
    yield Count.Result(total=goal.feedback)


async def use(client: Client) -> float:
    began = time.perf_counter()
    async with client.send_goal(Count.Goal(feedback=FEEDBACK)) as handle:
        seen = [each async for each in handle]
        await handle.result()
    assert len(seen) == FEEDBACK, f"{FEEDBACK - len(seen)} feedback messages were lost"
    return time.perf_counter() - began


async def told(pipe: Connection) -> object:
    """Wait for the next message of the benchmark."""
    loop = asyncio.get_running_loop()
    came = asyncio.Event()
    loop.add_reader(pipe.fileno(), came.set)
    try:
        while not pipe.poll():
            came.clear()
            await came.wait()
    finally:
        loop.remove_reader(pipe.fileno())
    return pipe.recv()


async def serve(pipe: Connection, mode: Mode, names: list[str]) -> None:
    async with AsyncExitStack() as stack:
        transport = await stack.enter_async_context(open_zenoh([AT], mode=mode))
        pipe.send("open")
        await told(pipe)
        for name in names:
            node = turtleact.open_node(f"robot_{name}", transport=transport)
            opened = await stack.enter_async_context(node)
            opened.action_server(Count, f"/{name}/count", count, result_timeout=KEPT)
        await transport.flush()
        pipe.send("met")
        while await told(pipe) is not None:
            pipe.send(usage())


async def ask(pipe: Connection, mode: Mode, names: list[str]) -> None:
    async with AsyncExitStack() as stack:
        transport = await stack.enter_async_context(open_zenoh([AT], mode=mode))
        pipe.send("open")
        await told(pipe)
        clients = []
        for number, name in enumerate(names):
            opening = turtleact.open_node(f"client_{os.getpid()}_{number}", transport=transport)
            node = await stack.enter_async_context(opening)
            clients.append(node.action_client(Count, f"/{name}/count"))
        for client in clients:
            assert await client.wait_for_server(60)
        pipe.send("met")
        while (goals := await told(pipe)) is not None:
            if goals == "usage":
                pipe.send(usage())
            elif isinstance(goals, int):  # one after another
                pipe.send([await use(clients[number % len(clients)]) for number in range(goals)])
            elif isinstance(goals, str):
                each = range(int(goals))
                sent = [use(clients[number % len(clients)]) for number in each]
                pipe.send(await asyncio.gather(*sent))


async def route(pipe: Connection, _mode: Mode, _names: list[str]) -> None:
    async with open_zenoh(mode="router", listen=[AT]):
        pipe.send("open")
        while await told(pipe) is not None:
            pipe.send(usage())


ROLES = {"router": route, "server": serve, "client": ask}


def run(role: str, pipe: Connection, mode: Mode, names: list[str]) -> None:
    asyncio.run(ROLES[role](pipe, mode, names))


class Usage(NamedTuple):
    """The usage of a process: CPU (s) since its start, and memory (bytes) now."""

    cpu: float
    memory: int


def usage() -> Usage:
    used = resource.getrusage(resource.RUSAGE_SELF)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return Usage(used.ru_utime + used.ru_stime, pages * resource.getpagesize())


class Process:
    """A process of the fleet."""

    def __init__(self, role: str, mode: Mode, names: list[str]) -> None:
        self.role = role
        self.count = len(names)
        self.pipe, theirs = multiprocessing.Pipe()
        arguments = (role, theirs, mode, names)
        self._process = multiprocessing.get_context("spawn").Process(target=run, args=arguments)
        self._process.start()

    def ask(self, what: object) -> None:
        self.pipe.send(what)

    def answer(self) -> object:
        assert self.pipe.poll(120), f"a {self.role} says nothing"
        return self.pipe.recv()

    def usage(self) -> Usage:
        self.ask("usage")
        used = self.answer()
        assert isinstance(used, Usage)
        return used

    def end(self) -> None:
        with suppress(OSError):  # it has failed
            self.ask(None)
        self._process.join(30)
        if self._process.is_alive():
            self._process.kill()


@contextmanager
def started(fleet: Fleet) -> Iterator[list[Process]]:
    """Give a block the router, the servers and the clients, each with a session."""
    robots = [f"r{number}" for number in range(fleet.servers)]
    wanted = [robots[number % fleet.servers] for number in range(fleet.clients)]
    processes = [Process("router", fleet.mode, [])]
    try:
        assert processes[0].answer() == "open"
        for role, names in (("server", robots), ("client", wanted)):
            several = min(PROCESSES, len(names))
            begun = [Process(role, fleet.mode, names[first::several]) for first in range(several)]
            processes += begun
        for each in processes[1:]:
            assert each.answer() == "open"
        yield processes
    finally:
        for each in reversed(processes):
            each.end()


# --- figures --------------------------------------------------------------------------------


def sent_bytes() -> int:
    """How many bytes have gone over the loopback device so far."""
    lines = Path("/proc/self/net/dev").read_text().splitlines()
    [line] = [each for each in lines if each.strip().startswith("lo:")]
    return int(line.split()[1])


async def join(fleet: Fleet) -> tuple[float, int]:
    """How long a new process takes to know all tokens, and how many there are."""
    began = time.perf_counter()
    async with open_zenoh([AT], mode="client") as transport:
        await transport.explore()
        while len(transport.nodes()) < fleet.servers + fleet.clients:
            await transport.wait_for_change()
        took = time.perf_counter() - began
        return took, len(transport.nodes()) + len(transport.endpoints())


def at_once(clients: list[Process]) -> list[float]:
    for each in clients:
        each.ask(str(AT_ONCE // len(clients)))
    return [took for each in clients for took in each.answer()]  # type: ignore[attr-defined]  # floats


def in_turn(clients: list[Process]) -> list[float]:
    times: list[float] = []
    for number in range(IN_TURN):
        client = clients[number % len(clients)]
        client.ask(1)
        times += client.answer()  # type: ignore[arg-type]  # floats
    return times


def measure(fleet: Fleet) -> str:
    with started(fleet) as processes:
        before = sent_bytes()
        began = time.perf_counter()
        for each in processes[1:]:
            each.ask("go")
        for each in processes[1:]:
            assert each.answer() == "met"
        met = time.perf_counter() - began
        joined, tokens = asyncio.run(join(fleet))
        discovery = sent_bytes() - before
        clients = [each for each in processes if each.role == "client"]
        one = in_turn(clients)
        used = [each.usage() for each in processes]
        before, began = sent_bytes(), time.perf_counter()
        at_once(clients)
        took = time.perf_counter() - began
        bytes_each = (sent_bytes() - before) / AT_ONCE
        more = [each.usage() for each in processes]
    cpu = dict.fromkeys(ROLES, 0.0)
    memory: dict[str, list[float]] = {role: [] for role in ROLES}
    for each, then, now in zip(processes, used, more, strict=True):
        cpu[each.role] += (now.cpu - then.cpu) / AT_ONCE
        memory[each.role].append(then.memory / 2**20)
    cpus = " ".join(f"{seconds * 1e3:>6.2f}" for seconds in cpu.values())
    sizes = " ".join(f"{statistics.mean(each):>6.0f}" for each in memory.values())
    slow = statistics.quantiles(one, n=20)[-1]
    return (
        f"{fleet.mode:7} {fleet.servers:>7} {fleet.clients:>7} {tokens:>7} {met * 1e3:>7.0f}"
        f" {joined * 1e3:>7.0f} {discovery / 1e3:>9.0f} {sizes}"
        f" {statistics.median(one) * 1e3:>7.1f} {slow * 1e3:>7.1f} {took:>7.1f}"
        f" {cpus} {bytes_each / 1e3:>9.1f}"
    )


def isolate() -> None:
    """Move to a separate network that has only a loopback device."""
    libc = ctypes.CDLL(None, use_errno=True)
    flags = CLONE_NEWNET if os.geteuid() == 0 else CLONE_NEWNET | CLONE_NEWUSER
    if libc.unshare(flags):
        print(f"no network of its own: {os.strerror(ctypes.get_errno())}", file=sys.stderr)
        sys.exit(1)
    subprocess.run([shutil.which("ip") or "ip", "link", "set", "lo", "up"], check=True)


def main() -> None:
    isolate()
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"{os.cpu_count()} cores, {platform.machine()}, load {load}")
    print(f"Python {platform.python_version()}, eclipse-zenoh {version('eclipse-zenoh')}\n")
    print(
        f"{'':47} {'MB a process':^20} {'a goal (ms)':^15} {'1,000':>7}"
        f" {'CPU ms a goal':^20} {'kB':>9}\n"
        f"{'mode':7} {'servers':>7} {'clients':>7} {'tokens':>7} {'met ms':>7} {'joined':>7}"
        f" {'kB':>9} {'router':>6} {'server':>6} {'client':>6} {'median':>7} {'p95':>7}"
        f" {'in s':>7} {'router':>6} {'server':>6} {'client':>6} {'a goal':>9}"
    )
    for fleet in FLEETS:
        print(measure(fleet), flush=True)


if __name__ == "__main__":
    main()
