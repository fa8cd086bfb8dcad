"""Clients that wait for a server to return, and go on with their goals."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import anyio
import anyio.to_thread
import pytest

import turtleact
from turtleact import GoalStatus
from turtleact.errors import InvalidOption, ServerUnavailable, UnknownGoal
from turtleact.goals.observers import GoalObserver
from turtleact.transports import MemoryTransport, open_zenoh

from .. import warm
from ..lab import Apart, Count, Gate, Running, feedback, goal, result, running, settle

PROGRAM = Path(__file__).with_name("durable_server.py")


class Server:
    """A server in a process of its own."""

    def __init__(self, address: str, path: Path) -> None:
        self._command = [sys.executable, "-m", "tests.journal.durable_server", address, str(path)]
        self._process: subprocess.Popen[str] | None = None

    async def start(self) -> None:
        self._process = warm.start(self._command, stdout=subprocess.PIPE, text=True)
        stdout = self._process.stdout
        assert stdout is not None
        assert await anyio.to_thread.run_sync(stdout.readline) == "ready\n"

    def kill(self, number: int = signal.SIGKILL) -> None:
        process = self._process
        assert process is not None
        process.send_signal(number)
        process.communicate()


@asynccontextmanager
async def remote(
    tmp_path: Path,
) -> AsyncIterator[tuple[Server, turtleact.ActionClient[Any, Any, Any]]]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    server = Server(address, tmp_path / "goals.db")
    await server.start()
    quick = {"connect/retry": {"period_init_ms": 50, "period_max_ms": 50}}
    try:
        async with (
            open_zenoh([address], listen=[], config=quick) as transport,
            turtleact.open_node("client", transport=transport) as node,
        ):
            yield server, node.action_client(Count, "count")
    finally:
        server.kill()


@pytest.mark.loops("asyncio")
async def test_goals_go_on_when_their_server_is_killed_and_started_again(tmp_path):
    async with remote(tmp_path) as (server, client):
        seen = list[int]()
        is_back = anyio.Event()

        async def follow() -> Count.Result:
            async with client.send_goal(goal(150), reattach=30.0) as handle:
                async for feedback in handle:
                    seen.append(len(feedback.so_far))
                    if len(seen) == 10:
                        is_back.set()
                done: Count.Result = await handle.result()
                return done

        async with (
            running(follow) as followed,
            running(lambda: client.send_goal(goal(150), reattach=30.0)) as awaited,
        ):
            await is_back.wait()
            server.kill()
            await server.start()
        everything = result(*range(150))
        assert (followed.error, awaited.error) == (None, None)
        assert (followed.value, awaited.value) == (everything, everything)
        assert seen == sorted(set(seen))  # in order, without repeats


# --- servers in the same process, or seen by messages alone -------------------------------------


class Restarted:
    """A node that serves with a journal, and that can be restarted."""

    def __init__(self, transport: MemoryTransport, path: Path, execute: Any) -> None:
        self._transport = transport
        self._path = path
        self._execute = execute

    @asynccontextmanager
    async def serving(self, **options: Any) -> AsyncIterator[None]:
        options = {"on_restart": "resume", **options}
        async with (
            turtleact.open_journal(self._path) as journal,
            turtleact.open_node("far", transport=self._transport) as node,
        ):
            node.action_server(Count, "count", self._execute, journal=journal, **options)
            yield


@pytest.mark.parametrize("see", [lambda graph: graph, Apart], ids=["in process", "by messages"])
async def test_an_awaited_goal_survives_a_restart(tmp_path, see: Callable[[MemoryTransport], Any]):
    gate, transport = Gate(), MemoryTransport()
    restarted = Restarted(transport, tmp_path / "goals.db", gate.stream)
    async with turtleact.open_node("near", transport=see(transport)) as node:
        client = node.action_client(Count, "count")
        seen = list[object]()
        sending = client.send_goal(goal(), reattach=30.0, feedback_callback=seen.append)
        async with running(lambda: sending) as sent:
            async with restarted.serving():
                await gate.started.wait()
            async with restarted.serving():
                gate.opened.set()
                await sent.done.wait()
        assert sent.value == result(3)
        if see is Apart:  # the new server has published before a client in its process can attach
            assert seen == [feedback(0), feedback(0)]


WHO = ContextVar[str]("WHO")


class Ends(GoalObserver):
    """Writes down in which states goals end."""

    def __init__(self) -> None:
        self.states: list[GoalStatus] = []

    def goal_changed(self, goal: Any, before: GoalStatus, after: GoalStatus) -> None:
        if after.is_terminal:
            self.states.append(after)


async def test_after_a_restart_feedback_and_observers_are_served_as_before(tmp_path):
    gate, ends, transport = Gate(), Ends(), MemoryTransport()
    heard = list[tuple[str, Count.Feedback]]()

    async def act(request: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
        WHO.set("the body")
        gate.log.append("begun")
        gate.started.set()
        await gate.opened.wait()
        yield feedback(1)
        yield result(3)

    def hear(message: Count.Feedback) -> None:
        heard.append((WHO.get(), message))

    async def send() -> Count.Result:
        WHO.set("the sender")
        got: Count.Result = await client.send_goal(goal(), reattach=30.0, feedback_callback=hear)
        return got

    restarted = Restarted(transport, tmp_path / "goals.db", act)
    async with turtleact.open_node("near", transport=transport) as node:
        client = node.action_client(Count, "count")
        client.observers.add(ends)
        async with running(send) as sent:
            async with restarted.serving():
                await gate.started.wait()
            async with restarted.serving():
                while gate.log != ["begun"] * 2:
                    await settle()
                await settle()  # the client has attached to the goal again
                gate.opened.set()
                await sent.done.wait()
    assert sent.value == result(3)
    assert heard == [("the sender", feedback(1))]
    assert ends.states == [GoalStatus.SUCCEEDED]


async def test_a_server_that_stays_away_is_given_up(tmp_path):
    gate, transport = Gate(), MemoryTransport()
    restarted = Restarted(transport, tmp_path / "goals.db", gate.wait)
    near: Any = Apart(transport)
    async with turtleact.open_node("near", transport=near) as node:
        client = node.action_client(Count, "count")
        async with running(lambda: client.send_goal(goal(), reattach=0.01)) as sent:
            pass
        assert isinstance(sent.error, ServerUnavailable)
        left: Running[Any] = Running(lambda: client.send_goal(goal(), reattach=0.01))
        async with anyio.create_task_group() as group, restarted.serving():
            group.start_soon(left.run)
            await gate.started.wait()
        assert isinstance(left.error, ServerUnavailable)


@pytest.mark.parametrize("see", [lambda graph: graph, Apart], ids=["in process", "by messages"])
async def test_a_server_that_returns_without_the_goal_is_told(tmp_path, see, monkeypatch):
    gate, transport = Gate(), MemoryTransport()
    first = Restarted(transport, tmp_path / "goals.db", gate.wait)
    second = Restarted(transport, tmp_path / "others.db", gate.wait)
    async with turtleact.open_node("near", transport=see(transport)) as node:
        client = node.action_client(Count, "count")
        async with running(lambda: client.send_goal(goal(), reattach=30.0)) as sent:
            async with first.serving():
                await gate.started.wait()
            async with second.serving():
                await sent.done.wait()
        assert isinstance(sent.error, UnknownGoal)


async def test_a_goal_that_a_closing_server_rejects_is_sent_to_the_next_one(tmp_path):
    gate, transport, asked = Gate(), MemoryTransport(), list[int]()
    gate.opened.set()

    async def ask(request: Count.Goal) -> turtleact.GoalResponse:
        asked.append(request.upto)
        await anyio.sleep_forever()
        raise AssertionError

    restarted = Restarted(transport, tmp_path / "goals.db", gate.wait)
    near: Any = Apart(transport)
    async with turtleact.open_node("near", transport=near) as node:
        client = node.action_client(Count, "count")
        async with running(lambda: client.send_goal(goal(1), reattach=30.0)) as patient:
            async with restarted.serving(goal_callback=ask):
                while not asked:
                    await settle()
            async with restarted.serving():
                await patient.done.wait()
    assert (patient.error, patient.value) == (None, result(1))


@pytest.mark.parametrize("is_heard", [True, False], ids=["with feedback", "without"])
async def test_feedback_ends_the_absence_of_a_server_that_is_killed_again_and_again(
    tmp_path, monkeypatch, is_heard
):
    later, now = [0.0], anyio.current_time
    monkeypatch.setattr(anyio, "current_time", lambda: now() + later[0])
    monkeypatch.setattr("turtleact.goals.remote.SETTLED", 1e9)  # no server lives that long
    gate, transport = Gate(), MemoryTransport()
    restarted = Restarted(transport, tmp_path / "goals.db", gate.stream if is_heard else gate.wait)
    near: Any = Apart(transport)
    async with turtleact.open_node("near", transport=near) as node:
        client = node.action_client(Count, "count")
        heard = list[object]()
        sending = client.send_goal(goal(), reattach=30.0, feedback_callback=heard.append)
        async with running(lambda: sending) as sent:
            for times in range(1, 5):
                async with restarted.serving():
                    while gate.log.count("begun") < times or len(heard) < times * is_heard:
                        if sent.done.is_set():
                            break
                        await settle()
                    if times == 4:
                        gate.opened.set()
                        await sent.done.wait()
                later[0] += 20.0
    if is_heard:
        assert (sent.error, sent.value) == (None, result(3))
    else:
        assert isinstance(sent.error, ServerUnavailable)


async def test_reattach_is_a_number():
    async with turtleact.open_node("near") as node:
        client = node.action_client(Count, "count")
        with pytest.raises(InvalidOption, match="'reattach'"):
            client.send_goal(goal(), reattach="long")  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def quick(monkeypatch) -> None:
    monkeypatch.setattr("turtleact.goals.remote.PAUSE", 0.001)
