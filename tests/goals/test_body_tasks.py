"""A body runs in a task of its own: how its client waits never changes what the body sees.

Each claim is tested for every way to wait for a goal, with the server in the client's process and
behind Zenoh. A client that is cancelled has its own tests, in ``goals/test_cancelling.py``.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from typing import Any, TypeAlias

import anyio
import anyio.lowlevel
import pytest

import turtleact
from turtleact import GoalStatus, Outcome
from turtleact.errors import GoalAborted, GoalCanceled
from turtleact.tasks import current_tasks
from turtleact.testing import virtual_backend

from ..conftest import INSTALLED, LOOPS
from ..lab import (
    ON_EVERY_LOOP,
    Count,
    Running,
    goal,
    result,
    running,
    settle,
)
from .test_cancelling import (
    Cleaning,
    address,
    in_process,
    over_zenoh,
    serving,
)

pytestmark = ON_EVERY_LOOP

__all__ = ["address"]  # a fixture

Send: TypeAlias = Callable[[], Any]

IN_TIME = 10.0
"""A limit that is never reached (s)."""


# --- ways to wait for a goal ----------------------------------------------------------------


async def awaited(send: Send) -> object:
    return await send()


async def entered(send: Send) -> object:
    async with send() as handle:
        return await handle.result()


async def inside_move_on_after(send: Send) -> object:
    with anyio.move_on_after(IN_TIME):
        return await send()
    raise AssertionError


async def inside_a_task_group(send: Send) -> object:
    call: Running[Any] = Running(lambda: awaited(send))
    async with anyio.create_task_group() as group:
        group.start_soon(call.run)
    if call.error is not None:
        raise call.error
    return call.value


async def inside_a_timeout_of_asyncio(send: Send) -> object:
    async with asyncio.timeout(IN_TIME):
        return await send()


async def inside_a_task_group_of_asyncio(send: Send) -> object:
    call: Running[Any] = Running(lambda: awaited(send))
    async with asyncio.TaskGroup() as group:
        group.create_task(call.run())
    if call.error is not None:
        raise call.error
    return call.value


async def given_to_a_task(send: Send) -> object:
    return await asyncio.create_task(send())


WAYS = [awaited, entered, inside_move_on_after, inside_a_task_group]
WAYS_OF_ASYNCIO = [inside_a_timeout_of_asyncio, inside_a_task_group_of_asyncio, given_to_a_task]

LOOPS_AND_WAYS = [
    (loop, wait)
    for loop in INSTALLED
    for wait in (WAYS if loop == "trio" else [*WAYS, *WAYS_OF_ASYNCIO])
]
EVERY_WAY = pytest.mark.parametrize(
    ("anyio_backend", "wait"),
    [
        pytest.param(LOOPS[loop], wait, id=f"{loop}-{wait.__name__}")
        for loop, wait in LOOPS_AND_WAYS
    ],
)


# --- the clean-up of a body that is cancelled -----------------------------------------------


BODIES = pytest.mark.parametrize(
    ("where", "style"),
    [(in_process, "coroutine"), (in_process, "generator"), (over_zenoh, "coroutine")],
)


@EVERY_WAY
@BODIES
async def test_a_body_whose_goal_is_canceled_by_others_ends_its_clean_up(
    where, address, style, wait
):
    cleaning = Cleaning()
    async with serving(where, address, getattr(cleaning, style)) as client:
        async with running(lambda: wait(lambda: client.send_goal(goal()))) as call:
            await cleaning.started.wait()
            await client.cancel_all()
        assert isinstance(call.error, GoalCanceled)
        assert cleaning.log == ["cleaned"]


# --- task groups inside a body --------------------------------------------------------------


async def fail() -> None:
    await anyio.lowlevel.checkpoint()
    raise ValueError("a child failed")


async def in_asyncios_group(linger: Callable[[], Awaitable[object]]) -> None:
    async with asyncio.TaskGroup() as group:
        group.create_task(fail())
        await linger()


async def in_anyios_group(linger: Callable[[], Awaitable[object]]) -> None:
    async with anyio.create_task_group() as group:
        group.start_soon(fail)
        await linger()


async def leave() -> None:
    """Let the child fail while its parent is leaving the group."""


EVERY_WAY_AND_GROUP = pytest.mark.parametrize(
    ("anyio_backend", "wait", "fail_in_group"),
    [
        pytest.param(LOOPS[loop], wait, group, id=f"{loop}-{wait.__name__}-{group.__name__}")
        for loop, wait in LOOPS_AND_WAYS
        for group in ([in_anyios_group] if loop == "trio" else [in_asyncios_group, in_anyios_group])
    ],
)
PARENTS = pytest.mark.parametrize(
    ("where", "linger"),
    [(in_process, leave), (in_process, anyio.sleep_forever), (over_zenoh, leave)],
)


@EVERY_WAY_AND_GROUP
@PARENTS
async def test_a_body_that_handles_the_failure_of_a_child_succeeds(
    where, address, wait, fail_in_group, linger
):
    async def body(request: Count.Goal) -> Count.Result:
        handled: list[int] = []
        try:
            await fail_in_group(linger)
        except* ValueError:
            await anyio.sleep(0)  # nothing of the group's cancellation is left
            handled.append(1)
        return result(*handled)

    async with serving(where, address, body) as client:
        assert await wait(lambda: client.send_goal(goal())) == result(1)


@EVERY_WAY_AND_GROUP
@PARENTS
async def test_a_body_that_does_not_handle_the_failure_of_a_child_is_aborted(
    where, address, wait, fail_in_group, linger
):
    async def body(request: Count.Goal) -> Count.Result:
        await fail_in_group(linger)
        return result()

    async with serving(where, address, body) as client:
        with pytest.raises(GoalAborted, match="a child failed"):
            await wait(lambda: client.send_goal(goal()))


# --- a body that exits ----------------------------------------------------------------------


@pytest.mark.parametrize(("loop", "wait"), LOOPS_AND_WAYS)
@pytest.mark.parametrize(
    ("where", "when"),
    [(in_process, "at once"), (in_process, "after a wait"), (over_zenoh, "after a wait")],
)
def test_a_body_that_exits_ends_its_goal_and_then_the_program(loop, wait, where, address, when):
    async def body(request: Count.Goal) -> Count.Result:
        if when == "after a wait":
            await anyio.lowlevel.checkpoint()
        sys.exit(3)

    async def main() -> None:
        async with where(address) as place:
            place.far.action_server(Count, "count", body)
            place.far.on_transition(lambda handle, _, new: states.append((new, handle.reason)))
            client = place.near.action_client(Count, "count")
            assert await client.wait_for_server(IN_TIME)
            try:
                await wait(lambda: client.send_goal(goal()))
            except GoalAborted as error:  # unless the program ends before the client hears of it
                states.append((GoalStatus.ABORTED, error.reason))
            await anyio.sleep_forever()

    states: list[object] = []
    backend, options = LOOPS[loop]
    with pytest.raises(SystemExit) as caught:
        anyio.run(main, backend=backend, backend_options=options)
    assert caught.value.code == 3
    assert states[-1] == (GoalStatus.ABORTED, "the program was stopped")


@pytest.mark.parametrize("loop", INSTALLED)
def test_a_body_that_exits_ends_the_program_from_within_a_task_group(loop):
    async def body(request: Count.Goal) -> Count.Result:
        sys.exit(3)

    async def call(client: Any) -> None:
        await client.send_goal(goal())

    async def inner(group: Any) -> None:
        async with in_process("") as place:
            place.far.action_server(Count, "count", body)
            group.start_soon(call, place.near.action_client(Count, "count"))
            await anyio.sleep_forever()

    async def main() -> None:
        async with turtleact.open_node("outer"), anyio.create_task_group() as group:
            group.start_soon(inner, group)
            await anyio.sleep_forever()

    backend, options = LOOPS[loop]
    with pytest.raises(SystemExit) as caught:
        anyio.run(main, backend=backend, backend_options=options)
    assert caught.value.code == 3


@pytest.mark.parametrize("loop", INSTALLED)
def test_a_child_of_a_body_that_exits_ends_the_goal_and_the_program(loop):
    async def leave() -> None:
        await anyio.lowlevel.checkpoint()
        sys.exit(3)

    async def body(request: Count.Goal) -> Count.Result:
        async with anyio.create_task_group() as group:
            group.start_soon(leave)
        return result()

    async def main() -> None:
        async with in_process("") as place:
            place.far.action_server(Count, "count", body)
            async with place.near.action_client(Count, "count").send_goal(goal()):
                await anyio.sleep_forever()

    backend, options = LOOPS[loop]
    with pytest.raises(SystemExit) as caught:
        anyio.run(main, backend=backend, backend_options=options)
    assert caught.value.code == 3


# --- closing --------------------------------------------------------------------------------

IN_VIRTUAL_TIME = pytest.mark.parametrize(
    "anyio_backend",
    [
        pytest.param(virtual_backend("asyncio"), id="asyncio"),
        pytest.param(virtual_backend("trio"), id="trio"),
    ],
)

SHUTDOWN = Outcome(GoalStatus.ABORTED, result(), "shutdown")
STUBBORN = 100.0
"""How long a body ignores its cancellation (s)."""


class Body:
    """A body whose clean-up takes a while.

    Attributes:
        seconds: How long.
        log: What has become of it.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.log: list[str] = []

    async def __call__(self, request: Count.Goal) -> Count.Result:
        try:
            await anyio.sleep_forever()
        finally:
            with anyio.CancelScope(shield=True):
                await anyio.sleep(self.seconds)
            self.log.append("over")
        return result()


class Closing:
    """How long a node takes to close whose bodies are slow to end.

    Attributes:
        took: How long ``aclose`` took (s).
        ended: When the goal of each server, by its number, ended after ``aclose`` was called (s).
    """

    def __init__(self) -> None:
        self.took = 0.0
        self.ended: dict[int, float] = {}

    async def run(self, *servers: tuple[Body, float]) -> None:
        """Open a server for each body with its ``grace``, send it a goal, and close the node."""
        async with turtleact.open_node("lab") as node, anyio.create_task_group() as group:
            for number, (body, grace) in enumerate(servers):
                node.action_server(Count, f"count{number}", body, grace=grace)
                client = node.action_client(Count, f"count{number}")
                handle = await client.send_goal(goal()).__aenter__()
                group.start_soon(self._note_the_end, number, handle)
            await settle()
            self._began = anyio.current_time()
            await node.aclose()
            self.took = anyio.current_time() - self._began

    async def _note_the_end(self, number: int, handle: Any) -> None:
        assert await handle.outcome() == SHUTDOWN
        self.ended[number] = anyio.current_time() - self._began


@IN_VIRTUAL_TIME
async def test_closing_a_node_takes_one_grace_for_all_bodies():
    closing = Closing()
    await closing.run((Body(STUBBORN), 2.0), (Body(STUBBORN), 3.0), (Body(1.0), 5.0))
    assert closing.ended == pytest.approx({2: 1.0, 0: 2.0, 1: 3.0})
    can_let_go = current_tasks().can_let_go
    assert closing.took == pytest.approx(3.0 if can_let_go else STUBBORN)
    await anyio.sleep(STUBBORN)
