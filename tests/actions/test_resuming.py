"""The built-in actions after a crash: they go on where the journal's feedback says."""

from __future__ import annotations

import shutil
from contextlib import asynccontextmanager
from pathlib import Path

import anyio
import pytest

import turtleact
from turtleact import GoalStatus, recording
from turtleact.actions.go_to import GoTo
from turtleact.actions.patrol import Patrol
from turtleact.interfaces import Action, Message, float64, int32, to_dict
from turtleact.interfaces.standard import (
    ExampleFibonacci,
    Fibonacci,
    PatrolCommandInterface,
    Point,
)
from turtleact.journal import read_goals

pytestmark = pytest.mark.loops("asyncio")

ID = bytes(range(16))
TARGETS = [Point(x=x, y=y) for x, y in ((7.0, 5.5), (7.0, 8.0), (4.0, 8.0), (4.0, 5.0))]


@asynccontextmanager
async def world(path: Path):
    async with (
        turtleact.open_journal(path) as journal,
        turtleact.open_world(speed="max", journal=journal, on_restart="resume") as node,
    ):
        yield node, journal


async def crash(journal: turtleact.Journal) -> Path:
    """What a process would find that starts after this one was killed now."""
    await journal.written()
    copy = journal.path.with_name("crashed.db")
    for suffix in ("", "-wal"):
        shutil.copy(f"{journal.path}{suffix}", f"{copy}{suffix}")
    return copy


async def before_and_after(tmp_path: Path, action: type[Action], name: str, goal, count: int):
    """The feedback up to a crash after at least ``count`` messages, the rest, and the result."""
    before, after = [], []
    async with (
        world(tmp_path / "goals.db") as (node, journal),
        node.action_client(action, name).send_goal(goal, goal_id=ID) as handle,
    ):
        async for feedback in handle:
            before.append(feedback)
            if len(before) == count:
                crashed = await crash(journal)
                (left,) = read_goals(crashed)
                count = left.feedback_count  # virtual time may have gone on meanwhile
            if len(before) >= count:
                break
    async with (
        world(crashed) as (node, _),
        node.action_client(action, name).attach(ID) as handle,
    ):
        async for feedback in handle:
            after.append(feedback)
        return before, after, await handle.result()


@pytest.mark.parametrize("count", [1, 3, 5])
async def test_a_patrol_reaches_each_target_once(tmp_path, count):
    goal = Patrol.Goal(targets=TARGETS, loops=1)
    before, after, result = await before_and_after(tmp_path, Patrol, "patrol", goal, count)
    reached = [each.index for each in (*before, *after) if each.is_reached]
    assert reached == [0, 1, 2, 3, 0, 1, 2, 3]
    assert (result.reached, result.missed) == (8, [])
    assert result.distance > 15.0
    assert result.duration > 0.0


async def test_the_lectures_patrol_names_each_target_once(tmp_path):
    goal = PatrolCommandInterface.Goal(targets=TARGETS)
    before, after, result = await before_and_after(
        tmp_path, PatrolCommandInterface, "command_turtle", goal, 2
    )
    told = [each.feedback_msg for each in (*before, *after)]
    assert told == [f"Target {number} reached" for number in (1, 2, 3, 4)]
    assert result.result_msg == "Patrolling complete!"


async def test_a_goal_to_go_to_arrives(tmp_path):
    goal = GoTo.Goal(x=9.0, y=9.0)
    before, _, result = await before_and_after(tmp_path, GoTo, "go_to", goal, 2)
    assert len(before) >= 2
    assert result.duration > 0.0


@pytest.mark.parametrize("action", [Fibonacci, ExampleFibonacci])
async def test_fibonacci_continues(tmp_path, action):
    goal = action.Goal(order=7)
    before, after, result = await before_and_after(tmp_path, action, "fibonacci", goal, 3)
    numbers = [getattr(each, each.__struct_fields__[0]) for each in (*before, *after)]
    assert [len(each) for each in numbers] == [3, 4, 5, 6, 7, 8]
    assert list(result.sequence) == [0, 1, 1, 2, 3, 5, 8, 13]


class FormerPatrol(Action, type_name="turtleact_interfaces/action/Patrol"):
    """Patrol as it was when its result still had a bound."""

    class Goal(Message):
        targets: list[Point] = []
        loops: int32 = 0

    class Result(Message):
        reached: int32 = 0
        bound: float64 = 0.0

    class Feedback(Message):
        index: int32 = 0


async def test_a_goal_of_the_former_patrol_in_a_journal_is_aborted_with_the_reason(tmp_path):
    async def wait(_goal: FormerPatrol.Goal) -> FormerPatrol.Result:
        await anyio.sleep_forever()
        raise AssertionError

    async with (
        turtleact.open_journal(tmp_path / "goals.db") as journal,
        turtleact.open_node("former") as node,
    ):
        # The journal tells goals of built-in actions from goals of the user's own.
        node.action_server(FormerPatrol, "/patrol", wait, journal=journal, on_conflict="withdraw")
        client = node.action_client(FormerPatrol, "/patrol")
        async with client.send_goal(FormerPatrol.Goal(targets=TARGETS), goal_id=ID):
            crashed = await crash(journal)
    async with world(crashed) as (node, journal):
        await node.clock.sleep(1.0)
        await journal.written()
        (old,) = read_goals(crashed)
    assert old.status is GoalStatus.ABORTED
    assert old.reason == (
        "the type turtleact_interfaces/action/Patrol has changed since the goal was accepted"
    )


async def test_a_goal_of_the_former_patrol_in_a_bag_is_read_with_its_bound(tmp_path):
    async def arrive(goal: FormerPatrol.Goal) -> FormerPatrol.Result:
        return FormerPatrol.Result(len(goal.targets), 9.93)

    async with turtleact.open_node("former") as node:
        node.action_server(FormerPatrol, "/patrol", arrive, introspection="contents")
        client = node.action_client(FormerPatrol, "/patrol")
        async with recording.record(node, tmp_path / "run", actions=["/patrol"]):
            await client.send_goal(FormerPatrol.Goal(targets=TARGETS))
    (found,) = await recording.goals(tmp_path / "run")
    assert to_dict(found.result) == {"reached": 4, "bound": 9.93}
