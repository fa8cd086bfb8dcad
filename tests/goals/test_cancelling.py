"""A client task that is cancelled ends cancelled, however it waits and whatever the server does."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, NamedTuple, TypeAlias

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import CancelResponse, GoalStatus
from turtleact.errors import InvalidOption
from turtleact.tasks import current_tasks
from turtleact.transports import open_zenoh

from ..lab import (
    ON_ASYNCIO,
    ON_EVERY_LOOP,
    Count,
    Gate,
    Running,
    far_and_near,
    feedback,
    goal,
    lab,
    result,
    running,
    settle,
)
from .test_remote_server import Cut

Call: TypeAlias = Callable[[], Awaitable[object]]

SHORT = 0.02
"""A ``cancel_timeout`` that is over at once (s)."""


# --- where the server is ------------------------------------------------------------------------


class Place(NamedTuple):
    """A server's node and a client's node.

    Attributes:
        far: The node of the server.
        near: The node of the client.
        kill: Lets the server die; in the client's own process it cannot.
    """

    far: turtleact.Node
    near: turtleact.Node
    kill: Callable[[], Awaitable[None]]


@asynccontextmanager
async def in_process(address: str) -> AsyncIterator[Place]:
    async with turtleact.open_node("lab") as node:
        yield Place(node, node, anyio.lowlevel.checkpoint)


@asynccontextmanager
async def by_messages(address: str) -> AsyncIterator[Place]:
    async with far_and_near(near=Cut) as (far, near):
        graph: Any = near.transport

        async def kill() -> None:
            graph.cut()

        yield Place(far, near, kill)


@asynccontextmanager
async def over_zenoh(address: str) -> AsyncIterator[Place]:
    async with (
        open_zenoh([], listen=[address]) as there,
        open_zenoh([address], listen=[]) as here,
        turtleact.open_node("far", transport=there) as far,
        turtleact.open_node("near", transport=here) as near,
    ):
        yield Place(far, near, there.aclose)


@asynccontextmanager
async def serving(
    where: Any, address: str, body: Any, **options: Any
) -> AsyncIterator[turtleact.ActionClient[Any, Any, Any]]:
    """A client that knows the server of a body."""
    async with where(address) as place:
        place.far.action_server(Count, "count", body)
        client = place.near.action_client(Count, "count", **options)
        assert await client.wait_for_server(10)
        yield client


@pytest.fixture
def address(tmp_path) -> str:
    return f"unixsock-stream/{tmp_path}/zenoh.sock"


pytestmark = ON_EVERY_LOOP
EVERYWHERE = pytest.mark.parametrize("where", [in_process, by_messages, over_zenoh])
ELSEWHERE = pytest.mark.parametrize("where", [by_messages, over_zenoh])


@pytest.fixture(autouse=True)
def no_patience(monkeypatch) -> None:
    """What a server that has died is waited for: nothing."""
    monkeypatch.setattr("turtleact.goals.remote.BACK_WITHIN", 0.0)


# --- how a client waits -------------------------------------------------------------------------


async def await_it(client: Any) -> None:
    await client.send_goal(goal())


async def wait_in_the_block(client: Any) -> None:
    async with client.send_goal(goal()) as handle:
        await handle.result()


async def read_in_the_block(client: Any) -> None:
    async with client.send_goal(goal()) as handle:
        async for _ in handle:
            pass


async def give_it_to_a_task(client: Any) -> None:
    await asyncio.create_task(client.send_goal(goal()))


WAYS = pytest.mark.parametrize("wait", [await_it, wait_in_the_block, read_in_the_block])


# --- how it is cancelled ------------------------------------------------------------------------


async def by_a_scope(call: Call, ready: Call) -> None:
    async with anyio.create_task_group() as group:
        beside: Running[Any] = Running(call)
        group.start_soon(beside.run)
        await ready()
        beside.scope.cancel()
    assert beside.scope.cancelled_caught
    assert beside.error is None


async def by_move_on_after(call: Call, ready: Call) -> None:
    async with anyio.create_task_group() as group:
        with anyio.move_on_after(1000) as scope:
            group.start_soon(end, ready, scope)
            await call()
        assert scope.cancelled_caught


async def end(ready: Call, scope: anyio.CancelScope) -> None:
    await ready()
    scope.deadline = anyio.current_time()


async def by_a_task_group(call: Call, ready: Call) -> None:
    ended: list[BaseException] = []

    async def run() -> None:
        try:
            await call()
        except BaseException as error:
            ended.append(error)
            raise

    async with anyio.create_task_group() as group:
        group.start_soon(run)
        await ready()
        group.cancel_scope.cancel()
    assert [type(error) for error in ended] == [anyio.get_cancelled_exc_class()]


async def by_its_task(call: Call, ready: Call) -> None:
    task = asyncio.ensure_future(call())
    await ready()
    task.cancel()
    await asyncio.wait([task])
    assert task.cancelled()


async def by_a_timeout_of_asyncio(call: Call, ready: Call) -> None:
    async def end(timeout: asyncio.Timeout) -> None:
        await ready()
        timeout.reschedule(asyncio.get_running_loop().time())

    async def run() -> None:
        async with asyncio.timeout(1000) as timeout:
            group.create_task(end(timeout))
            await call()

    async with asyncio.TaskGroup() as group:
        with pytest.raises(TimeoutError):
            await run()


async def by_a_task_group_of_asyncio(call: Call, ready: Call) -> None:
    async def fail() -> None:
        await ready()
        raise ValueError("mine")

    tasks: list[asyncio.Task[Any]] = []

    async def run() -> None:
        async with asyncio.TaskGroup() as group:
            tasks.append(group.create_task(call()))  # type: ignore[arg-type]  # a coroutine
            group.create_task(fail())

    with pytest.raises(ExceptionGroup) as caught:
        await run()
    assert [str(error) for error in caught.value.exceptions] == ["mine"]
    assert tasks[0].cancelled()


ANY_WAY = pytest.mark.parametrize("cancel", [by_a_scope, by_move_on_after, by_a_task_group])
ASYNCIOS_WAYS = pytest.mark.parametrize(
    "cancel", [by_its_task, by_a_timeout_of_asyncio, by_a_task_group_of_asyncio]
)

# --- what the server does -----------------------------------------------------------------------


class Cleaning:
    """Bodies that need a moment for their clean-up.

    Attributes:
        started: Set when the body has begun.
        log: What it has done.
    """

    def __init__(self) -> None:
        self.started = anyio.Event()
        self.log: list[str] = []

    async def coroutine(self, goal: Count.Goal) -> Count.Result:
        """A body that is cancelled at an await."""
        self.started.set()
        try:
            await anyio.sleep_forever()
        finally:
            await self._clean_up()
        return result()

    async def generator(self, goal: Count.Goal) -> AsyncIterator[Count.Feedback | Count.Result]:
        """A body that is cancelled at a yield."""
        self.started.set()
        try:
            while True:
                yield feedback()
        finally:
            await self._clean_up()

    async def _clean_up(self) -> None:
        # On asyncio a cancellation arrives once, so the clean-up may simply wait. On trio it
        # arrives at each await that is not shielded.
        on_trio = not current_tasks().can_let_go
        with anyio.CancelScope(shield=on_trio):
            await anyio.sleep(SHORT)
            self.log.append("cleaned")


class Asked:
    """A ``cancel_callback`` that never answers."""

    def __init__(self) -> None:
        self.event = anyio.Event()

    async def ask(self, handle: object) -> CancelResponse:
        self.event.set()
        await anyio.sleep_forever()
        raise AssertionError


BEHAVIOURS = pytest.mark.parametrize(
    ("where", "behaves"),
    [
        *itertools.product([in_process, by_messages, over_zenoh], ["well", "never answers"]),
        (in_process, "well at a yield"),
    ],
)


async def check(where, address, wait, cancel, *, behaves: str) -> None:
    gate, asked, cleaning = Gate(), Asked(), Cleaning()
    well = {"well": cleaning.coroutine, "well at a yield": cleaning.generator}
    body, started = well.get(behaves), cleaning.started if behaves in well else gate.started
    options: dict[str, Any] = {} if body else {"cancel_callback": asked.ask}
    async with where(address) as place, anyio.create_task_group() as group:
        place.far.action_server(Count, "count", body or gate.stream, **options)
        patience = 5.0 if behaves == "dies" else SHORT if options else 10.0
        client = place.near.action_client(Count, "count", cancel_timeout=patience)
        assert await client.wait_for_server(10)
        if behaves == "dies":

            async def kill() -> None:
                await asked.event.wait()
                await place.kill()

            group.start_soon(kill)
        await cancel(lambda: wait(client), started.wait)
        if body:
            assert cleaning.log == ["cleaned"]
        gate.opened.set()


@BEHAVIOURS
@WAYS
@ANY_WAY
async def test_a_cancelled_client_ends_cancelled(where, address, wait, cancel, behaves):
    await check(where, address, wait, cancel, behaves=behaves)


@ELSEWHERE
@WAYS
@ANY_WAY
async def test_a_cancelled_client_ends_cancelled_though_its_server_dies(
    where, address, wait, cancel
):
    await check(where, address, wait, cancel, behaves="dies")


@ON_ASYNCIO
@BEHAVIOURS
@pytest.mark.parametrize("wait", [await_it, wait_in_the_block, give_it_to_a_task])
@ASYNCIOS_WAYS
async def test_a_task_that_is_cancelled_ends_cancelled(where, address, wait, cancel, behaves):
    await check(where, address, wait, cancel, behaves=behaves)


@ON_ASYNCIO
@ELSEWHERE
@pytest.mark.parametrize("wait", [await_it, wait_in_the_block, give_it_to_a_task])
@ASYNCIOS_WAYS
async def test_a_task_that_is_cancelled_ends_cancelled_though_its_server_dies(
    where, address, wait, cancel
):
    await check(where, address, wait, cancel, behaves="dies")


@pytest.mark.parametrize("wait", [await_it, wait_in_the_block])
async def test_a_client_cancelled_before_its_goal_is_accepted_ends_cancelled_though_its_server_dies(
    wait,
):
    asked = anyio.Event()

    async def never(request: object) -> None:
        asked.set()
        await anyio.sleep_forever()

    async with by_messages("") as place:
        place.far.action_server(Count, "count", Gate().wait, goal_callback=never)  # type: ignore[arg-type]
        client = place.near.action_client(Count, "count")
        async with running(lambda: wait(client)) as beside:
            await asked.wait()
            beside.scope.cancel()
            await settle()
            await place.kill()
        assert beside.scope.cancelled_caught
        assert beside.error is None


# --- leaving the block --------------------------------------------------------------------------


@EVERYWHERE
async def test_leaving_the_block_waits_no_longer_than_the_cancel_timeout(where, address):
    gate = Gate()
    async with where(address) as place:
        place.far.action_server(Count, "count", gate.wait, cancel_callback=Asked().ask)
        client = place.near.action_client(Count, "count", cancel_timeout=SHORT)
        assert await client.wait_for_server(10)
        async with client.send_goal(goal()) as handle:
            await gate.started.wait()
        assert handle.status is GoalStatus.EXECUTING
        gate.opened.set()


async def test_a_cancellation_while_the_block_is_left_is_not_lost():
    gate = Gate()
    async with lab(gate.tidy) as served:

        async def call() -> None:
            async with served.client.send_goal(goal()):
                await gate.started.wait()

        async with running(call) as beside:
            await settle()
            beside.scope.cancel()
            await settle()
            assert not beside.done.is_set()
            gate.opened.set()
        assert beside.scope.cancelled_caught


@pytest.mark.parametrize("seconds", ["long", float("nan"), True])
async def test_a_cancel_timeout_is_a_number(seconds):
    async with turtleact.open_node("lab") as node:
        with pytest.raises(InvalidOption, match="option 'cancel_timeout': expected a number"):
            node.action_client(Count, "count", cancel_timeout=seconds)


async def test_without_a_cancel_timeout_the_end_is_waited_for():
    gate = Gate()
    async with lab(gate.wait) as served:
        client = served.node.action_client(Count, "count", cancel_timeout=None)
        async with client.send_goal(goal()) as handle:
            await gate.started.wait()
        assert handle.status is GoalStatus.CANCELED
