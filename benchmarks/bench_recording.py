"""What does it cost to record, and what does recording cost the goals?

1. The writers: the same feedback messages, as bytes, to MCAP by turtleact, by rosbags and by the
   SDK of Foxglove, in turn. A ratio is the median of the rounds' ratios. turtleact's time includes
   its queue and thread.
2. A body that yields feedback as fast as it can, over Zenoh, with `bag record` in another process:
   how much is recorded a second, and whether anything is lost.
3. A goal with 0, 10 and 50 feedback messages over Zenoh: alone, with its feedback read by another
   process that drops it inside Zenoh, and recorded by another process with all contents
   (introspection). The three take turns, a few goals each. Then the same within one process.
4. An hour of poses at 62.5 Hz in virtual time: how the memory grows.
5. ``bag info`` of a file of 1 GB, as a command and in Python.

Run it as ``python -m benchmarks.bench_recording``. It writes 1 GB to the current folder's file
system, and deletes it at the end.
"""

from __future__ import annotations

import asyncio
import os
import platform
import resource
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TypeAlias

import zenoh
from zenoh.handlers import RingChannel

import turtleact
from benchmarks.bench_rclpy import installed
from turtleact import open_world, recording
from turtleact.goals.service_server import Introspection
from turtleact.interfaces import encode, get_message, type_hash
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.recording.bag_writer import BagWriter, Split
from turtleact.recording.metadata import Offer
from turtleact.recording.schemas import schema_of
from turtleact.recording.storage import Channel
from turtleact.recording.writer_thread import WriterThread

ROUNDS = 3
MESSAGES = 50_000
FEEDBACK_SECONDS = 3
GOALS = 20
BLOCKS = 30
FEEDBACK_OF_A_GOAL = (0, 10, 50)
SHOWN: dict[str, Introspection] = {"alone": "off", "heard": "off", "recorded": "contents"}
"""The actions whose goals are compared, and their introspection."""
HOUR = 3600
GIGABYTE = 10**9
Client: TypeAlias = turtleact.ActionClient[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]
Body: TypeAlias = AsyncIterator[Fibonacci.Feedback | Fibonacci.Result]

TOPIC = "/bench/_action/feedback"

FEEDBACK = get_message("example_interfaces/action/Fibonacci_FeedbackMessage")


def a_message() -> bytes:
    value = FEEDBACK()
    value.feedback.sequence = list(range(10))
    return encode(value)


# --- 1. the writers -------------------------------------------------------------------------------


def by_turtleact(path: Path, data: bytes) -> None:
    channel = Channel(
        topic=TOPIC,
        schema=schema_of(FEEDBACK),
        offers=(Offer(),),
        type_hash=type_hash(FEEDBACK),
    )
    writer = WriterThread(BagWriter(path, Split()), is_patient=True)
    writer.start(lambda: None)
    number = writer.add(channel, None, is_there=True)
    for stamp in range(MESSAGES):
        writer.put(number, stamp, data)
    writer.close()
    assert writer.count == MESSAGES


def by_rosbags(path: Path, data: bytes) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        one = writer.add_connection(
            TOPIC,
            FEEDBACK.type_name,
            msgdef=schema_of(FEEDBACK).text,
            rihs01=type_hash(FEEDBACK),
        )
        for stamp in range(MESSAGES):
            writer.write(one, stamp, data)


def by_foxglove(path: Path, data: bytes) -> None:
    import foxglove

    schema = schema_of(FEEDBACK)
    context = foxglove.Context()
    with foxglove.open_mcap(path.with_suffix(".mcap"), context=context):
        one = foxglove.Channel(
            TOPIC,
            message_encoding="cdr",
            context=context,
            schema=foxglove.Schema(name=schema.name, encoding="ros2msg", data=schema.text.encode()),
        )
        for stamp in range(MESSAGES):
            one.log(data, log_time=stamp)


WRITERS: dict[str, Callable[[Path, bytes], None]] = {
    "turtleact": by_turtleact,
    "rosbags": by_rosbags,
    "foxglove-sdk": by_foxglove,
}


def compare_writers(folder: Path) -> None:
    data, took = a_message(), {name: list[float]() for name in WRITERS}
    for number in range(ROUNDS):
        for name, write in WRITERS.items():
            begun = time.perf_counter()
            write(folder / f"{name}{number}", data)
            took[name].append((time.perf_counter() - begun) / MESSAGES)
    print(f"writing {MESSAGES:,} messages of {len(data)} bytes, {ROUNDS} rounds")
    ours = took["turtleact"]
    for name, each in took.items():
        mean = statistics.median(each)
        ratio = statistics.median(one / own for one, own in zip(each, ours, strict=True))
        print(
            f"  {name:13} {mean * 1e6:6.1f} us a message {1 / mean:10,.0f} a second  x{ratio:.2f}"
        )


# --- 2. and 3. over Zenoh -------------------------------------------------------------------------


async def fast(goal: Fibonacci.Goal) -> Body:
    """Yield feedback for some seconds, as fast as it can be sent."""
    begun, count = time.monotonic(), 0
    sequence = list(range(10))
    while time.monotonic() - begun < goal.order:
        for _ in range(100):
            yield Fibonacci.Feedback(sequence)
        count += 100
    yield Fibonacci.Result([count, round((time.monotonic() - begun) * 1000)])


async def short(goal: Fibonacci.Goal) -> Body:
    for number in range(goal.order):
        yield Fibonacci.Feedback([number])
        await asyncio.sleep(0)
    yield Fibonacci.Result([goal.order])


def free_endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


async def serve(at: str) -> None:
    """Serve both actions on a router of one's own, until killed."""
    async with (
        turtleact.open_zenoh([], listen=[at], mode="router", config={}) as graph,
        turtleact.open_node("bench", transport=graph) as node,
    ):
        node.action_server(Fibonacci, "fast", fast)
        for name, shown in SHOWN.items():
            node.action_server(Fibonacci, name, short, introspection=shown)
        print("ready", flush=True)
        await asyncio.sleep(300)


async def hear(at: str) -> None:
    """Read the feedback of an action, and drop it before it reaches Python."""
    settings = zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{at}"]}}}}')
    with zenoh.open(settings) as session:
        session.declare_subscriber("*/heard/_action/feedback/**", RingChannel(1))
        print("ready", flush=True)
        await asyncio.sleep(300)


@contextmanager
def program(*arguments: str, ready: str) -> Iterator[subprocess.Popen[str]]:
    """Run a Python program for a block, once it has printed a word. It gets SIGTERM at the end."""
    process = subprocess.Popen(
        [sys.executable, "-u", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert process.stdout is not None
    try:
        while ready not in (line := process.stdout.readline()):
            assert line, "it has ended"
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        said = process.communicate(timeout=30)[0]
        print("".join(f"    {line}\n" for line in said.splitlines() if "message" in line), end="")


def recorder(at: str, path: Path, *names: str) -> AbstractContextManager[subprocess.Popen[str]]:
    line = ["-m", "turtleact", "bag", "record", "--actions", *names, "-o", str(path)]
    return program(*line, "--connect", at, ready="feedback")


async def record_fast(at: str, path: Path) -> None:
    async with (
        turtleact.open_zenoh([at], mode="client", config={}) as graph,
        turtleact.open_node("client", transport=graph) as node,
    ):
        client = node.action_client(Fibonacci, "/fast")
        with recorder(at, path, "/fast"):
            await client.wait_for_server()
            async with client.send_goal(Fibonacci.Goal(order=FEEDBACK_SECONDS)) as goal:
                outcome = await goal.outcome()
            await asyncio.sleep(2)
    count, milliseconds = outcome.result.sequence
    bag = recording.Bag(path)
    recorded = sum(each.count for each in bag.info.topics if each.name.endswith("feedback"))
    print(
        f"feedback over Zenoh, recorded by another process: {count:,} published, "
        f"{recorded:,} recorded, {recorded / milliseconds * 1000:,.0f} a second, "
        f"{count - recorded} lost"
    )


async def time_goals(client: Client, feedback: int) -> float:
    """The median time of a goal (s)."""
    took = []
    for _ in range(GOALS):
        begun = time.perf_counter()
        await client.send_goal(Fibonacci.Goal(order=feedback))
        took.append(time.perf_counter() - begun)
    return statistics.median(took)


async def compare_goals(at: str, folder: Path) -> None:
    async with (
        turtleact.open_zenoh([at], mode="client", config={}) as graph,
        turtleact.open_node("client", transport=graph) as node,
    ):
        clients = {name: node.action_client(Fibonacci, f"/{name}") for name in SHOWN}
        for each in clients.values():
            await each.wait_for_server()
        with (
            program("-m", "benchmarks.bench_recording", "hear", at, ready="ready"),
            recorder(at, folder / "goals", "/recorded"),
        ):
            for feedback in FEEDBACK_OF_A_GOAL:
                took = {name: list[float]() for name in clients}
                for number in range(BLOCKS * len(clients)):
                    name = list(clients)[number % len(clients)]
                    took[name].append(await time_goals(clients[name], feedback))
                    await asyncio.sleep(0.04)  # what is still on its way must not count for others
                tell_goals("over Zenoh", feedback, took)


async def compare_goals_here(folder: Path) -> None:
    async with turtleact.open_node("bench") as node:
        node.action_server(Fibonacci, "short", short)
        client = node.action_client(Fibonacci, "/short")
        for feedback in FEEDBACK_OF_A_GOAL:
            took: dict[str, list[float]] = {"alone": [], "recorded": []}
            for number in range(BLOCKS):
                took["alone"].append(await time_goals(client, feedback))
                path = folder / f"own{feedback}-{number}"
                async with recording.record(node, path, actions=["/short"]):
                    took["recorded"].append(await time_goals(client, feedback))
            tell_goals("in one process", feedback, took)


def tell_goals(where: str, feedback: int, took: dict[str, list[float]]) -> None:
    print(f"a goal with {feedback} feedback messages, {where}")
    for name, each in took.items():
        pairs = zip(each, took["alone"], strict=True)
        ratio = statistics.median(one / alone for one, alone in pairs)
        print(f"  {name:13} {statistics.median(each) * 1e6:7.0f} us  x{ratio:.3f}")


# --- 4. an hour -----------------------------------------------------------------------------------


async def record_an_hour(path: Path) -> None:
    async with (
        open_world(speed="max") as node,
        recording.record(node, path, topics=["/turtle1/pose"]) as run,
    ):
        sizes, begun = list[int](), time.perf_counter()
        for _ in range(6):
            await node.clock.sleep(HOUR / 6)
            sizes.append(resident())
        took = time.perf_counter() - begun
    grown = ", ".join(f"{(each - sizes[0]) / 2**20:+.1f}" for each in sizes)
    print(
        f"an hour of poses in {took:.0f} s: {run.count:,} messages, {run.lost} lost; memory after "
        f"10, 20 … 60 minutes (MiB): {grown}"
    )


def resident() -> int:
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return pages * os.sysconf("SC_PAGE_SIZE")


# --- 5. a large file ------------------------------------------------------------------------------


def look_at_a_large_file(folder: Path) -> None:
    path = folder / "large.mcap"
    writer = BagWriter(path, Split())
    for number in range(10):
        schema = schema_of(FEEDBACK)
        writer.add(number, Channel(topic=f"/{number}", schema=schema, offers=(Offer(),)))
    data = bytes(2_000)
    for stamp in range(GIGABYTE // (len(data) + 47)):
        writer.write(stamp % 10, stamp, stamp, data)
    writer.close({})
    command = [sys.executable, "-m", "turtleact", "bag", "info", str(path)]
    took = []
    for _ in range(5):
        begun = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, env=installed())
        took.append(time.perf_counter() - begun)
    inside = []
    for _ in range(5):
        begun = time.perf_counter()
        recording.Bag(path)
        inside.append(time.perf_counter() - begun)
    print(
        f"bag info of {path.stat().st_size / 1e9:.2f} GB: {statistics.median(took):.2f} s as a "
        f"command, {statistics.median(inside) * 1e3:.0f} ms in Python"
    )


def main() -> None:
    peers = ", ".join(f"{name} {version(name)}" for name in ("rosbags", "foxglove-sdk"))
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; {peers}")
    with tempfile.TemporaryDirectory(dir=".") as name:
        folder = Path(name)
        compare_writers(folder)
        at = free_endpoint()
        with program("-m", "benchmarks.bench_recording", "serve", at, ready="ready"):
            asyncio.run(record_fast(at, folder / "fast"))
            asyncio.run(compare_goals(at, folder))
        asyncio.run(compare_goals_here(folder))
        asyncio.run(record_an_hour(folder / "hour"))
        look_at_a_large_file(folder)


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        asyncio.run(serve(sys.argv[2]))
    elif sys.argv[1:2] == ["hear"]:
        asyncio.run(hear(sys.argv[2]))
    else:
        main()
