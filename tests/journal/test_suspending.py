"""Servers with a journal that are closed while goals wait for their turn."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import anyio
import pytest

import turtleact
from turtleact import GoalStatus, Journal, Node
from turtleact.errors import ServerUnavailable
from turtleact.goals.observers import GoalObserver
from turtleact.journal import read_goals

from ..lab import Count, goal, local_server, result, running, settle

FIRST, SECOND = bytes(range(16)), bytes(range(1, 17))


@asynccontextmanager
async def opened(path: Path) -> AsyncIterator[tuple[Journal, Node]]:
    async with turtleact.open_journal(path) as journal, turtleact.open_node("lab") as node:
        yield journal, node


class Changes(GoalObserver):
    """Tells when the second goal has been accepted."""

    def __init__(self) -> None:
        self.second_accepted = anyio.Event()

    def goal_changed(self, goal: Any, before: GoalStatus, after: GoalStatus) -> None:
        if after is GoalStatus.ACCEPTED and goal.id == SECOND:
            self.second_accepted.set()


@pytest.mark.loops("asyncio", "uvloop")  # trio sends the two goals in random order
async def test_a_goal_whose_turn_has_come_does_not_start_when_its_server_stops(tmp_path):
    path, changes, began = Path(tmp_path, "goals.db"), Changes(), list[int]()

    async def act(request: Count.Goal) -> Count.Result:
        began.append(request.upto)
        with suppress(anyio.get_cancelled_exc_class()):
            await anyio.sleep_forever()
        return result()

    async with opened(path) as (journal, node):
        options: Any = {"journal": journal, "on_restart": "resume", "policy": "queue"}
        server = node.action_server(Count, "count", act, **options)
        client = node.action_client(Count, "count")
        local_server(server).observers.add(changes)

        async with (
            running(lambda: client.send_goal(goal(1), goal_id=FIRST)),
            running(lambda: client.send_goal(goal(2), goal_id=SECOND)) as second,
        ):
            await changes.second_accepted.wait()  # a thread has written it to the journal
            await server.aclose()  # the first goal succeeds, so it is the second one's turn
        await settle()
        assert isinstance(second.error, ServerUnavailable)
        assert began == [1]
        left = {each.id: each.status for each in read_goals(path)}
        assert left[SECOND] is GoalStatus.ACCEPTED


@pytest.mark.parametrize("waiting", [[], [SECOND]], ids=["", "with a goal that waits"])
async def test_a_server_that_stops_gives_up_its_places_in_a_shared_slot(tmp_path, waiting):
    async def wait_for_ever(request: Count.Goal) -> Count.Result:
        await anyio.sleep_forever()
        raise AssertionError

    async def act(request: Count.Goal) -> Count.Result:
        return result(request.upto)

    options: Any = {"policy": "queue", "slot": "arm"}
    async with opened(Path(tmp_path, "goals.db")) as (journal, node):
        durable: Any = {"journal": journal, "on_restart": "resume", **options}
        stopped = node.action_server(Count, "count", wait_for_ever, **durable)
        node.action_server(Count, "other", act, **options)
        client, other = node.action_client(Count, "count"), node.action_client(Count, "other")
        for goal_id in (FIRST, *waiting):
            (await client.send_goal(goal(), goal_id=goal_id).__aenter__()).detach()
        async with running(lambda: other.send_goal(goal(7))) as next_one:
            await stopped.aclose()
            with anyio.fail_after(1):
                await next_one.done.wait()
            assert next_one.value == result(7)
