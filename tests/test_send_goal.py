"""A goal about to be sent, given to what wants a coroutine."""

from __future__ import annotations

import asyncio

import anyio
import pytest

from turtleact.goal import GoalStatus

from .lab import ON_ASYNCIO, Gate, count, goal, lab, result, settle


@ON_ASYNCIO
@pytest.mark.parametrize("waits", [False, True])
async def test_a_task_can_be_made_of_it(waits):
    gate = Gate()
    async with lab(gate.wait if waits else count) as served:
        task = asyncio.create_task(served.client.send_goal(goal(1)))
        await settle()
        gate.opened.set()
        assert await task == (result(1) if waits else result(0))


@ON_ASYNCIO
async def test_a_task_group_takes_it():
    async with lab(count) as served, asyncio.TaskGroup() as group:
        tasks = [group.create_task(served.client.send_goal(goal(upto))) for upto in range(3)]
    assert [task.result() for task in tasks] == [result(), result(0), result(0, 1)]


@ON_ASYNCIO
async def test_canceling_the_task_cancels_the_goal():
    gate = Gate()
    async with lab(gate.wait) as served:
        task = asyncio.create_task(served.client.send_goal(goal()))
        await settle()
        (active,) = served.active
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert (active.status, gate.log) == (GoalStatus.CANCELED, ["begun", "canceled", "over"])


@ON_ASYNCIO
async def test_canceling_the_task_before_its_first_step_sends_nothing():
    async with lab(count) as served:
        task = asyncio.create_task(served.client.send_goal(goal()))
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert served.active == []


async def test_it_can_be_started_in_a_task_group_of_anyio():
    gate = Gate()
    async with lab(gate.wait) as served:
        async with anyio.create_task_group() as group:
            group.start_soon(served.client.send_goal, goal())
            await gate.started.wait()
            gate.opened.set()
        assert gate.log == ["begun", "over"]


async def test_what_was_never_begun_can_be_closed():
    async with lab(count) as served:
        served.client.send_goal(goal()).close()
        assert served.active == []
