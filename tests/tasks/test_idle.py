"""Being idle."""

from __future__ import annotations

from contextlib import aclosing

import anyio
import anyio.lowlevel
import pytest

from turtleact.tasks import Background, wait_until_idle
from turtleact.tasks.clock import VirtualClock

from ..lab import running


async def test_one_is_idle_once_all_others_wait():
    async def work() -> None:
        for _ in range(100):
            await anyio.lowlevel.checkpoint()

    async with running(work) as worker:
        assert not worker.done.is_set()
        await wait_until_idle()
        assert worker.done.is_set()


async def test_one_who_no_longer_waits_for_idleness_is_not_counted():
    busy = anyio.Event()

    async def work() -> None:
        while not busy.is_set():
            await anyio.lowlevel.checkpoint()

    async with running(work) as worker:
        async with running(wait_until_idle) as canceled, running(wait_until_idle) as watcher:
            canceled.scope.cancel()
            await canceled.done.wait()
            for _ in range(20):
                await anyio.lowlevel.checkpoint()
            assert not watcher.done.is_set()
            busy.set()
            await watcher.done.wait()
        assert worker.done.is_set()


@pytest.mark.loops("uvloop")
async def test_virtual_time_goes_on_where_the_loop_hides_its_callbacks(caplog):
    clock = VirtualClock()
    async with aclosing(Background(clock.run(), "the clock")):
        for _ in range(2):
            await clock.sleep(60)
    assert clock.time() == 120
    assert [record.getMessage()[:20] for record in caplog.records] == ["virtual time is slow"]
