"""The task of a body watches how long each step takes. ``test_body_tasks.py`` has all the rest."""

from __future__ import annotations

import anyio.lowlevel
import pytest

from ..lab import Count, goal, lab

pytestmark = pytest.mark.loops("asyncio")


async def count(request: Count.Goal) -> Count.Result:
    await anyio.lowlevel.checkpoint()
    return Count.Result()


@pytest.mark.parametrize(("limit", "is_logged"), [(-1.0, True), (60.0, False)])
async def test_a_step_that_blocks_the_event_loop_is_logged(monkeypatch, caplog, limit, is_logged):
    monkeypatch.setattr("turtleact.server.body_task.BLOCKING", limit)
    async with lab(count) as served:
        await served.client.send_goal(goal())
    assert ("nothing else could run meanwhile" in caplog.text) == is_logged
