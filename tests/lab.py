"""A laboratory for tests of actions: a small action, a node that serves it, and tools for time."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar, cast

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import GoalStatus, Outcome
from turtleact.errors import GoalAborted, GoalCanceled
from turtleact.goals.server import LocalActionServer
from turtleact.goals.state import Goal
from turtleact.interfaces import Action, Message, int32
from turtleact.tasks import current_tasks
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport

T = TypeVar("T")

ON_EVERY_LOOP = pytest.mark.loops("asyncio", "uvloop", "trio")
"""For tests that run all their cases on uvloop."""
ON_ASYNCIO = pytest.mark.parametrize(
    "anyio_backend",
    [
        pytest.param(("asyncio", {"use_uvloop": False}), id="asyncio"),
        pytest.param(("asyncio", {"use_uvloop": True}), id="uvloop"),
    ],
)
ON_A_LOOP_THAT_TELLS = pytest.mark.parametrize(
    "anyio_backend",
    [
        pytest.param(("asyncio", {"use_uvloop": False}), id="asyncio"),
        pytest.param(("trio", {}), id="trio"),
    ],
)
"""Loops that know exactly when they are idle; uvloop does not."""
ON_TRIO = pytest.mark.parametrize("anyio_backend", [pytest.param(("trio", {}), id="trio")])

TURNS = 30
"""More turns of the loop than any chain of wake-ups in these tests needs."""


class Count(Action, type_name="lab_interfaces/action/Count"):
    """Counts up to a number and reports every number on the way."""

    class Goal(Message):
        upto: int32 = 0

    class Result(Message):
        counted: list[int32] = []

    class Feedback(Message):
        so_far: list[int32] = []


class Other(Action, type_name="lab_interfaces/action/Other"):
    """Another action, with the same fields."""

    class Goal(Message):
        upto: int32 = 0

    class Result(Message):
        counted: list[int32] = []

    class Feedback(Message):
        so_far: list[int32] = []


def goal(upto: int = 3) -> Count.Goal:
    return Count.Goal(upto=upto)


def bare_goal(**facts: Any) -> Goal:
    """A goal of no server; nothing can wait for it."""
    return Goal(bytes(range(16)), None, cast("Any", None), **facts)


def feedback(*numbers: int) -> Count.Feedback:
    return Count.Feedback(so_far=list(numbers))


def result(*numbers: int) -> Count.Result:
    return Count.Result(counted=list(numbers))


async def take_turns() -> None:
    """Let all other tasks run for a while, even if some never wait."""
    tasks = current_tasks()
    for _ in range(TURNS):
        await tasks.checkpoint()


async def settle() -> None:
    """Let all other tasks run until none of them can continue by itself."""
    if anyio.get_cancelled_exc_class() is asyncio.CancelledError:
        await take_turns()
    else:
        await anyio.wait_all_tasks_blocked()


def other_tasks() -> set[asyncio.Task[Any]]:
    """The tasks of an asyncio loop, without the test's own."""
    return {task for task in asyncio.all_tasks() if task is not asyncio.current_task()}


class Running(Generic[T]):
    """A coroutine that runs in its own task, and its outcome.

    Attributes:
        scope: Cancel it to cancel the coroutine.
        value: The return value.
        error: The exception it raised, which may be a cancellation.
        done: Set when it has ended.
    """

    def __init__(self, call: Callable[[], Any]) -> None:
        self._call = call
        self.scope = anyio.CancelScope()
        self.value: Any = None
        self.error: BaseException | None = None
        self.done = anyio.Event()

    async def run(self) -> None:
        try:
            with self.scope:
                self.value = await self._call()
        except Exception as error:
            self.error = error
        finally:
            self.done.set()


@asynccontextmanager
async def running(call: Callable[[], Any]) -> AsyncIterator[Running[Any]]:
    """Run ``call()`` beside the block; under way at its start, awaited at its end."""
    beside: Running[Any] = Running(call)
    async with anyio.create_task_group() as group:
        group.start_soon(beside.run)
        await take_turns()
        yield beside


class Lab(NamedTuple):
    """The things that a test works with."""

    node: turtleact.Node
    server: turtleact.ActionServer[Any, Any, Any]
    client: turtleact.ActionClient[Any, Any, Any]
    local: LocalActionServer

    @property
    def active(self) -> list[Any]:
        """The goals that the server considers active."""
        return [goal for goal in self.local.held().values() if goal.status.is_active]


def local_server(server: turtleact.ActionServer[Any, Any, Any]) -> LocalActionServer:
    """The server object that clients in the same process use."""
    name, type_name = f"{server.name}/_action/send_goal", f"{server.action_type.type_name}_SendGoal"
    (offered,) = server.node.transport.local(name, type_name)
    return cast("LocalActionServer", offered.direct)


@asynccontextmanager
async def lab(
    execute: Any, *, transport: MemoryTransport | None = None, **options: Any
) -> AsyncIterator[Lab]:
    """Open a node that serves `Count` with this body, and a client of it."""
    async with turtleact.open_node("lab", transport=transport) as node:
        server = node.action_server(Count, "count", execute, **options)
        yield Lab(node, server, node.action_client(Count, "count"), local_server(server))


class Apart:
    """A graph whose servers are all elsewhere: nobody is handed the server itself."""

    def __init__(self, transport: MemoryTransport) -> None:
        self._transport = transport

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def local(self, name: str, type_name: str) -> Any:
        """There is none in this process to which goals could be given."""
        return () if name.endswith("/send_goal") else self._transport.local(name, type_name)


@asynccontextmanager
async def far_and_near(
    transport: MemoryTransport | None = None, near: Callable[[MemoryTransport], Any] = Apart
) -> AsyncIterator[tuple[turtleact.Node, turtleact.Node]]:
    """Two nodes that reach each other by messages alone."""
    shared = transport or MemoryTransport()
    async with (
        turtleact.open_node("far", transport=shared) as far,
        turtleact.open_node("near", transport=near(shared)) as node,
    ):
        yield far, node


@asynccontextmanager
async def apart(
    execute: Any, *, transport: MemoryTransport | None = None, **options: Any
) -> AsyncIterator[Lab]:
    """A node that serves `Count`, and the client of another that reaches it by messages alone."""
    async with far_and_near(transport) as (far, node):
        server = far.action_server(Count, "count", execute, **options)
        yield Lab(node, server, node.action_client(Count, "count"), local_server(server))


async def count(goal: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
    """A plain body: a generator that never waits."""
    numbers: list[int] = []
    for number in range(goal.upto):
        numbers.append(number)
        yield Count.Feedback(so_far=numbers)
    yield Count.Result(counted=numbers)


class Gate:
    """A body that waits until the test lets it continue, and records what happens to it.

    Attributes:
        started: Set when a body has begun.
        opened: Set it to let the bodies continue.
        ended: Set when `wait` is about to return its result.
        log: What has happened, in order.
    """

    def __init__(self) -> None:
        self.started = anyio.Event()
        self.opened = anyio.Event()
        self.ended = anyio.Event()
        self.log: list[str] = []

    async def wait(self, goal: Count.Goal) -> Count.Result:
        """A coroutine body."""
        self.log.append("begun")
        self.started.set()
        try:
            await self.opened.wait()
        except anyio.get_cancelled_exc_class():
            self.log.append("canceled")
            raise
        finally:
            self.log.append("over")
        self.ended.set()
        return Count.Result(counted=[goal.upto])

    async def stream(self, goal: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
        """A generator body."""
        self.log.append("begun")
        self.started.set()
        try:
            yield Count.Feedback(so_far=[0])
            await self.opened.wait()
        except anyio.get_cancelled_exc_class():
            self.log.append("canceled")
            raise
        finally:
            self.log.append("over")
        yield Count.Result(counted=[goal.upto])

    async def tidy(self, goal: Count.Goal) -> Count.Result:
        """A coroutine body that ends when it is canceled, once its clean-up may continue."""
        self.log.append("begun")
        self.started.set()
        try:
            await anyio.sleep_forever()
        finally:
            with anyio.CancelScope(shield=True):
                await self.opened.wait()
            self.log.append("cleaned up")
        raise AssertionError


def once_canceled(end: object) -> Callable[..., Any]:
    """A coroutine body that waits to be canceled, and then returns or raises this."""

    async def wait(request: object = None) -> object:
        try:
            await anyio.sleep_forever()
        except anyio.get_cancelled_exc_class():
            if isinstance(end, BaseException):
                raise end from None
        return end

    return wait


def free_endpoint() -> str:
    """A place to listen at."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


def answering(answer: object, *, waits: bool = False) -> Callable[[object], Any]:
    """A callback, or a coroutine function, that returns or raises this."""

    def call(_: object) -> object:
        if isinstance(answer, BaseException):
            raise answer
        return answer

    async def wait(subject: object) -> object:
        await anyio.lowlevel.checkpoint()
        return call(subject)

    return wait if waits else call


class HandClock(VirtualClock):
    """A clock that a test sets by hand."""

    def advance(self, seconds: float) -> None:
        self._time += seconds


def hand_lab(execute: Callable[..., object], **options: Any) -> tuple[HandClock, Any]:
    """A laboratory whose clock the test sets by hand."""
    clock = HandClock()
    return clock, lab(execute, transport=MemoryTransport(clock), **options)


# The two ways to wait for a goal: they must not differ in how it ends.


async def awaited(served: Lab, request: Count.Goal, **options: Any) -> Outcome[Count.Result]:
    """Await a goal, and tell how it ended."""
    try:
        return Outcome(GoalStatus.SUCCEEDED, await served.client.send_goal(request, **options))
    except GoalCanceled as end:
        return Outcome(GoalStatus.CANCELED, end.result, end.reason)
    except GoalAborted as end:
        return Outcome(GoalStatus.ABORTED, end.result, end.reason)


async def entered(served: Lab, request: Count.Goal, **options: Any) -> Outcome[Count.Result]:
    """Enter the block of a goal, and tell how it ended."""
    async with served.client.send_goal(request, **options) as handle:
        return await handle.outcome()


Send: TypeAlias = Callable[..., Awaitable[Outcome[Count.Result]]]
