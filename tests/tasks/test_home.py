"""What is used elsewhere than in its event loop says so."""

from __future__ import annotations

import asyncio

import anyio
import anyio.to_thread
import pytest

from turtleact.errors import TurtleactError
from turtleact.tasks import LoopGuard

SAID = "node '/lab' belongs to another event loop: use it there, or call it from another thread"


async def test_a_thread_without_an_event_loop_is_not_home():
    home = LoopGuard("node '/lab'")
    with pytest.raises(TurtleactError, match=SAID):
        await anyio.to_thread.run_sync(home.check)


async def test_the_thread_that_is_sent_home_is_heard():
    home = LoopGuard("node '/lab'")
    await anyio.to_thread.run_sync(anyio.from_thread.run_sync, home.check)


@pytest.mark.parametrize("backend", ["asyncio", "trio"])
async def test_another_event_loop_is_not_home(backend):
    home = LoopGuard("node '/lab'")

    async def check() -> None:
        home.check()

    with pytest.raises(TurtleactError, match=SAID):
        await anyio.to_thread.run_sync(lambda: anyio.run(check, backend=backend))


def test_between_two_runs_the_event_loop_is_home():
    async def make() -> LoopGuard:
        return LoopGuard("node '/lab'")

    with asyncio.Runner() as runner:
        home = runner.run(make())
        home.check()
        home.of("a client of it").check()
    with pytest.raises(TurtleactError, match=SAID):
        home.check()  # it is closed
