"""What is offered for tests: virtual time, a goal run to its end, a bad link."""

from __future__ import annotations

import asyncio
import math
import re
import socket
import subprocess
import sys
import threading
import time
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

import anyio
import anyio.from_thread
import anyio.lowlevel
import anyio.to_thread
import pytest
import trio

import turtleact
from turtleact import open_world, testing
from turtleact.actions.patrol import Patrol
from turtleact.errors import SimError
from turtleact.interfaces.standard import Fibonacci, Point, Twist, Vector3
from turtleact.tasks.clock import EPOCH
from turtleact.testing import FaultyTransport, run_goal, virtual_backend, wait_until_idle
from turtleact.testing.plugin import anyio_backend  # noqa: F401  # all of this module is virtual
from turtleact.transports import MemoryTransport, QoS

from .lab import Count, count, feedback, goal, lab, other_tasks, result, running

TARGETS = [(9.0, 7.0), (5.0, 1.0), (1.0, 7.0), (2.0, 9.0)]
BACKENDS = pytest.mark.parametrize("backend", ["asyncio", "trio"])
SECOND = 1_000_000_000


# --- virtual time ---------------------------------------------------------------------------


async def add(one: int, other: int) -> int:
    return one + other


@BACKENDS
def test_a_run_gives_what_its_function_returns(backend):
    assert testing.run(add, 2, 3, backend=backend) == 5


@BACKENDS
def test_a_run_raises_what_its_function_raises(backend):
    async def fail() -> None:
        raise LookupError("lost")

    with pytest.raises(LookupError, match="lost"):
        testing.run(fail, backend=backend)


@pytest.mark.parametrize("backend", ["uvloop", "curio", "", None])
def test_a_backend_without_virtual_time_is_refused(backend):
    with pytest.raises(SimError, match=f"on asyncio and on trio, not on {backend!r}"):
        virtual_backend(backend)


@pytest.mark.parametrize("patience", [-1, -0.001, math.nan])
def test_a_patience_below_zero_is_refused(patience):
    with pytest.raises(SimError, match="patience must be 0 or more seconds, not"):
        virtual_backend(patience=patience)


async def test_a_day_of_sleep_takes_no_time():
    begun = time.monotonic()
    await anyio.sleep(86_400 * 3)
    assert anyio.current_time() == 86_400 * 3
    assert time.monotonic() - begun < 30


async def test_time_stands_still_while_anything_can_run():
    async with running(partial(anyio.sleep, 1)) as sleeper:
        for _ in range(100):
            await anyio.lowlevel.checkpoint()
            assert anyio.current_time() == 0
        await sleeper.done.wait()
    assert anyio.current_time() == 1


# --- the clocks of turtleact ----------------------------------------------------------------


async def test_the_clock_of_a_node_has_the_time_of_the_loop():
    async with turtleact.open_node("lab") as node:
        await anyio.sleep(5)
        assert (node.clock.time(), node.clock.now()) == (5, EPOCH + 5 * SECOND)
        await node.clock.sleep(10)
        assert (node.clock.time(), anyio.current_time()) == (15, 15)
        await node.clock.sleep_until(20)
        assert (node.clock.now(), anyio.current_time()) == (EPOCH + 20 * SECOND, 20)


async def patrol() -> tuple[list[int], Patrol.Result]:
    """The patrol of the README: which targets were reached, and the result."""
    async with open_world() as node:
        client = node.action_client(Patrol, "patrol")
        targets = [Point(x=x, y=y) for x, y in TARGETS]
        async with client.send_goal(Patrol.Goal(targets=targets)) as handle:
            reached = [each.index async for each in handle if each.is_reached]
            return reached, await handle.result()


@BACKENDS
def test_two_runs_of_the_patrol_of_the_readme_are_the_same_to_the_last_bit(backend):
    reached, ended = testing.run(patrol, backend=backend)
    assert (reached, ended.reached, round(ended.duration, 1)) == ([0, 1, 2, 3], 4, 10.7)
    assert testing.run(patrol, backend=backend) == (reached, ended)


# --- what is real ---------------------------------------------------------------------------

ROUNDS = 20


async def note_when(seconds: float, log: list[str]) -> None:
    await anyio.sleep(seconds)
    log.append("slept")


def look_in(log: list[str], token: anyio.lowlevel.EventLoopToken) -> None:
    """Work of a thread: see the loop idle a number of times, then be done."""
    for _ in range(ROUNDS):
        anyio.from_thread.run(wait_until_idle, token=token)
    log.append("worked")


async def in_a_thread_of_anyio(work):
    await anyio.to_thread.run_sync(work)


async def in_a_thread_of_asyncio(work):
    await asyncio.to_thread(work)


async def in_an_executor(work):
    await asyncio.get_running_loop().run_in_executor(None, work)


@pytest.mark.parametrize(
    ("backend", "go"),
    [
        ("asyncio", in_a_thread_of_anyio),
        ("asyncio", in_a_thread_of_asyncio),
        ("asyncio", in_an_executor),
        ("trio", in_a_thread_of_anyio),
    ],
)
def test_time_stands_still_while_a_thread_works(backend, go):
    async def main() -> list[str]:
        log: list[str] = []
        async with anyio.create_task_group() as group:
            group.start_soon(note_when, 1, log)
            await go(partial(look_in, log, anyio.lowlevel.current_token()))
            assert anyio.current_time() == 0
        assert anyio.current_time() == 1
        return log

    assert testing.run(main, backend=backend) == ["worked", "slept"]


@pytest.fixture
def sockets():
    one, other = socket.socketpair()
    with one, other:
        one.setblocking(False)
        yield one, other


@BACKENDS
def test_time_stands_still_for_as_long_as_a_peer_is_waited_for(sockets, backend):
    here, there = sockets

    def send(log: list[str], token: anyio.lowlevel.EventLoopToken) -> None:
        look_in(log, token)
        there.send(b"!")

    async def main() -> list[str]:
        log: list[str] = []
        peer = threading.Thread(target=send, args=(log, anyio.lowlevel.current_token()))
        async with anyio.create_task_group() as group:
            group.start_soon(note_when, 1, log)
            await wait_until_idle()
            async with running(partial(anyio.wait_readable, here)) as reading:
                peer.start()
                await reading.done.wait()
                log.append("read")
        peer.join()
        return log

    assert testing.run(main, backend=backend, patience=math.inf) == ["worked", "read", "slept"]


@BACKENDS
@pytest.mark.parametrize("patience", [0, 0.001])
def test_time_leaps_once_a_silent_peer_has_had_its_chance(sockets, backend, patience):
    async def main() -> float:
        with anyio.move_on_after(3600):
            await anyio.wait_readable(sockets[0])
        return anyio.current_time()

    assert testing.run(main, backend=backend, patience=patience) == 3600


@BACKENDS
def test_what_has_arrived_is_read_before_time_leaps(sockets, backend):
    here, there = sockets

    async def main() -> tuple[float, bytes]:
        async with anyio.create_task_group() as group:
            group.start_soon(anyio.sleep, 1)
            there.send(b"!")
            await anyio.wait_readable(here)
            seen = anyio.current_time(), here.recv(1)
        return seen

    assert testing.run(main, backend=backend, patience=0) == (0, b"!")


@BACKENDS
@pytest.mark.parametrize("command", [[sys.executable, "-c", "print(1)"], "echo 1"])
def test_time_waits_for_a_child_process(backend, command):
    async def main() -> tuple[float, bytes]:
        with anyio.fail_after(3600):
            process = await anyio.run_process(command)
            return anyio.current_time(), process.stdout

    assert testing.run(main, backend=backend, patience=math.inf) == (0, b"1\n")


# --- pytest ---------------------------------------------------------------------------------

TESTS = """
import anyio, pytest
from turtleact.tasks.clock import EPOCH, WallClock

@pytest.fixture
async def slept():
    await anyio.sleep(3600)

@pytest.mark.parametrize("number", [1, 2])
async def test_time_is_virtual(slept, number):
    await anyio.sleep(3600)
    assert anyio.current_time() == 7200
    assert WallClock().now() == EPOCH + 7200 * 10**9
"""


@pytest.mark.parametrize(
    "conftest",
    [
        "from turtleact.testing.plugin import anyio_backend",
        'pytest_plugins = ["turtleact.testing.plugin"]',
    ],
)
def test_the_fixture_gives_every_async_test_virtual_time(tmp_path, conftest):
    (tmp_path / "conftest.py").write_text(conftest, "utf-8")
    (tmp_path / "test_them.py").write_text(TESTS, "utf-8")
    outcome = subprocess.run(
        [sys.executable, "-m", "pytest", "-v", "-o", "anyio_mode=auto", tmp_path],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=50,
    )
    ran = sorted(re.findall(r"\[.*\] PASSED", outcome.stdout))
    names = ["asyncio-1", "asyncio-2", "trio-1", "trio-2"]
    assert ran == [f"[{name}] PASSED" for name in names], outcome.stdout + outcome.stderr


# --- run_goal -------------------------------------------------------------------------------

declared = turtleact.action(Count, "count")(count)


async def test_a_declared_body_is_served_and_run():
    feedbacks, outcome = await run_goal(declared, goal(3))
    assert feedbacks == [feedback(0), feedback(0, 1), feedback(0, 1, 2)]
    assert (outcome.status.name, outcome.result) == ("SUCCEEDED", result(0, 1, 2))


async def test_running_a_goal_leaves_the_graph_as_it_was():
    async with lab(count) as here:
        before = here.node.transport.endpoints()
        run = await run_goal(here.server, goal(2))
        assert run.feedbacks == [feedback(0), feedback(0, 1)]
        assert run.outcome.result == result(0, 1)
        assert here.node.transport.endpoints() == before


async def test_a_goal_that_fails_raises_nothing_and_says_why():
    @turtleact.action(Count, "fail")
    async def fail(goal):
        yield feedback(1)
        raise turtleact.Abort("no more")

    feedbacks, outcome = await run_goal(fail, goal())
    assert feedbacks == [feedback(1)]
    assert (outcome.status.name, outcome.reason) == ("ABORTED", "no more")


async def test_canceling_the_run_cancels_the_goal():
    ended: list[float] = []

    @turtleact.action(Count, "wait")
    async def wait(goal):
        try:
            await anyio.sleep_forever()
        finally:
            ended.append(anyio.current_time())
        yield result()

    with anyio.move_on_after(5) as scope:
        await run_goal(wait, goal())
    assert (scope.cancelled_caught, ended) == (True, [5])


async def test_a_body_that_sleeps_with_asyncio_fails_on_trio_as_the_page_says(anyio_backend_name):
    @turtleact.action(Fibonacci, "fibonacci")
    async def fibonacci(goal):
        await asyncio.sleep(1)
        yield Fibonacci.Result(sequence=[goal.order])

    _, outcome = await run_goal(fibonacci, Fibonacci.Goal(order=1))
    if anyio_backend_name == "trio":
        page = Path(__file__).parents[1].joinpath("docs", "testing.md").read_text("utf-8")
        assert f"`{outcome.reason}`" in page
    assert outcome.status.name == {"trio": "ABORTED"}.get(anyio_backend_name, "SUCCEEDED")


# --- a bad link -----------------------------------------------------------------------------


class Line:
    """One publisher and one subscription with faults between them."""

    def __init__(self, link: FaultyTransport, node: turtleact.Node, depth: int = 1000) -> None:
        self.link = link
        self.node = node
        self.twists = node.publisher(Twist, "twist")
        self.arrived = node.subscription(Twist, "twist", QoS(depth=depth))

    def send(self, *numbers: int) -> None:
        for number in numbers:
            self.twists.publish(Twist(linear=Vector3(x=float(number))))

    def take(self) -> list[int]:
        return [int(twist.linear.x) for twist in self.arrived.drain()]


@asynccontextmanager
async def line(**faults):
    async with (
        FaultyTransport(MemoryTransport(), **faults) as link,
        turtleact.open_node("lab", transport=link) as node,
    ):
        yield Line(link, node)


@pytest.mark.parametrize(
    ("faults", "taken", "counts"),
    [
        ({}, [1, 2], {"delivered": 2}),
        ({"drop": 1}, [], {"dropped": 2}),
        ({"repeat": 1}, [1, 1, 2, 2], {"delivered": 2, "repeated": 2}),
    ],
)
async def test_a_message_may_be_lost_or_arrive_twice(faults, taken, counts):
    async with line(**faults) as link:
        link.send(1, 2)
        assert link.take() == taken
        assert link.link.statistics() == testing.Faults(**counts)


async def test_the_shares_are_about_what_was_asked_for():
    async with line(drop=0.3, repeat=0.1) as link:
        link.send(*range(2000))
        faults = link.link.statistics()
        assert faults.dropped == pytest.approx(600, abs=100)
        assert faults.repeated == pytest.approx(140, abs=50)
        assert faults.delivered == 2000 - faults.dropped


async def test_a_message_may_be_late():
    async with line(delay=2.5) as link:
        link.send(1)
        await anyio.sleep(2)
        link.send(2)
        assert (link.take(), link.link.statistics().on_their_way) == ([], 2)
        await anext(link.arrived)
        assert anyio.current_time() == 2.5
        await anext(link.arrived)
        assert anyio.current_time() == 4.5


async def test_messages_of_different_delays_keep_their_order():
    async with line(delay=(0, 1), repeat=0.2) as link:
        for number in range(100):
            link.send(number)
            await anyio.sleep(0.01)
        await anyio.sleep(1)
        taken = link.take()
        assert taken == sorted(taken)
        assert set(taken) == set(range(100))


async def struck(seed, **faults):
    async with line(seed=seed, **faults) as link:
        link.send(*range(200))
        await anyio.sleep(1)
        return link.take()


async def test_the_seed_decides_which_messages_are_struck():
    faults = {"drop": 0.3, "repeat": 0.3, "delay": (0, 0.5)}
    assert await struck(7, **faults) == await struck(7, **faults)
    assert await struck(7, drop=0.3) != await struck(8, drop=0.3)


@pytest.mark.parametrize("delay", [0, 1])
async def test_what_is_sent_or_on_its_way_while_the_link_is_cut_is_lost(delay):
    async with line(delay=delay) as link:
        with link.link.cut_off():
            link.send(1)
            await anyio.sleep(2)
        link.send(2)
        await anyio.sleep(2)
        assert link.take() == [2]
        assert link.link.statistics() == testing.Faults(delivered=1, cut=1)


async def test_what_is_published_to_others_is_not_struck():
    inner = MemoryTransport()
    async with (
        turtleact.open_node("ill", transport=FaultyTransport(inner, drop=1)) as ill,
        turtleact.open_node("well", transport=inner) as well,
    ):
        ends = [node.subscription(Twist, "twist") for node in (ill, well)]
        ill.publisher(Twist, "twist").publish(Twist())
        assert [len(end.drain()) for end in ends] == [0, 1]


def count_tasks() -> int:
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        return len(other_tasks())
    return trio.lowlevel.current_statistics().tasks_living


async def test_a_faulty_transport_that_is_closed_leaves_nothing_running():
    link = FaultyTransport(MemoryTransport(), delay=10)
    async with turtleact.open_node("lab", transport=link) as node:
        here, before = Line(link, node), count_tasks()
        here.send(1)
        assert (count_tasks(), link.statistics().on_their_way) == (before + 1, 1)
        await link.aclose()
        assert (count_tasks(), link.statistics().on_their_way) == (before, 0)
        await anyio.sleep(20)
        assert here.take() == []


async def test_actions_and_services_are_not_touched():
    link = FaultyTransport(MemoryTransport(), drop=1, delay=5)
    link.cut()
    async with turtleact.open_node("lab", transport=link) as node:
        client = node.action_client(Count, "count")
        node.serve(declared)
        assert await client.wait_for_server(1)
        assert await client.send_goal(goal(2)) == result(0, 1)
        assert anyio.current_time() == 0


@pytest.mark.parametrize("name", ["drop", "repeat"])
@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan])
def test_a_share_that_is_none_is_refused(name, share):
    with pytest.raises(
        SimError, match=f"{name} must be a share of messages, from 0 to 1, not {share}"
    ):
        FaultyTransport(MemoryTransport(), **{name: share})


@pytest.mark.parametrize("delay", [-1, math.nan, math.inf, (2, 1), (-1, 1), (0, math.inf)])
def test_a_delay_that_is_none_is_refused(delay):
    with pytest.raises(SimError, match="delay must be 0 or more seconds, or an ordered pair"):
        FaultyTransport(MemoryTransport(), delay=delay)
