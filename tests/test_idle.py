"""Being idle."""

from __future__ import annotations

import anyio
import anyio.lowlevel
import pytest

from turtleact.errors import SimError
from turtleact.tasks.idle import _queue, wait_until_idle

from .lab import running


async def test_one_is_idle_once_all_others_wait():
    async def work() -> None:
        for _ in range(100):
            await anyio.lowlevel.checkpoint()

    async with running(work) as worker:
        assert not worker.done.is_set()
        await wait_until_idle()
        assert worker.done.is_set()


async def test_all_who_wait_for_idleness_see_it():
    seen: list[int] = []

    async def watch(number: int) -> None:
        await wait_until_idle()
        seen.append(number)

    async with anyio.create_task_group() as group:
        for number in range(5):
            group.start_soon(watch, number)
    assert sorted(seen) == list(range(5))


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


class Opaque:
    """An event loop that does not show its queue."""


def test_a_loop_that_does_not_show_its_queue_is_refused():
    with pytest.raises(SimError, match=r"does not work on the event loop <.*Opaque"):
        _queue(Opaque())  # type: ignore[arg-type]  # it has no more than is asked of it
