"""The task of a body watches how long each step takes. ``test_body_tasks.py`` has the rest."""

from __future__ import annotations

import gc

import anyio
import anyio.lowlevel
import pytest

from ..lab import Count, goal, lab

pytestmark = pytest.mark.loops("asyncio")


async def count(request: Count.Goal) -> Count.Result:
    await anyio.lowlevel.checkpoint()
    return Count.Result()


@pytest.mark.parametrize(("limit", "is_logged"), [(-1.0, True), (60.0, False)])
async def test_a_step_that_blocks_the_event_loop_is_logged(monkeypatch, caplog, limit, is_logged):
    monkeypatch.setattr("turtleact.goals.running.BLOCKING", limit)
    async with lab(count) as served:
        await served.client.send_goal(goal())
    assert (
        "the body of /count blocked the event loop for 0.0 s (goal " in caplog.text
    ) == is_logged


async def wait_for_ever(request: Count.Goal) -> Count.Result:
    await anyio.sleep_forever()
    raise AssertionError


async def call(client):
    await client.send_goal(goal())


async def enter(client):
    async with client.send_goal(goal()) as handle:
        await handle.result()


async def cancel(client):
    async with client.send_goal(goal()) as handle:
        await handle.cancel()
        await handle.outcome()


@pytest.mark.parametrize(("body", "send"), [(count, call), (count, enter), (wait_for_ever, cancel)])
async def test_a_goal_that_has_ended_leaves_nothing_to_the_garbage_collector(body, send):
    async with lab(body) as served:
        await send(served.client)
        gc.collect()
        gc.disable()
        try:
            for _ in range(20):
                await send(served.client)
            assert gc.collect() < 20  # not one object for each goal
        finally:
            gc.enable()
