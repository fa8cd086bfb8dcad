"""The built-in actions after a crash: they go on where the journal's feedback says."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import asynccontextmanager, closing
from pathlib import Path

import pytest

import turtleact
from turtleact import GoalStatus
from turtleact.actions.go_to import GoTo
from turtleact.actions.patrol import Patrol
from turtleact.interfaces import Action
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


async def test_a_goal_of_a_former_type_in_a_journal_is_aborted_with_the_reason(tmp_path):
    async with (
        world(tmp_path / "goals.db") as (node, journal),
        node.action_client(Patrol, "patrol").send_goal(
            Patrol.Goal(targets=TARGETS, loops=100), goal_id=ID
        ),
    ):
        crashed = await crash(journal)
    with closing(sqlite3.connect(crashed)) as database, database:
        # The hash that Patrol had when its result still had a bound.
        former = "RIHS01_7af4080965da60f1a1f264f5a16c707109751ff19f4ff53e7e54e41fb65bf804"
        database.execute("UPDATE goal SET type_hash = ?", [former])
    async with world(crashed) as (node, journal):
        await node.clock.sleep(1.0)
        await journal.written()
        (old,) = read_goals(crashed)
    assert old.status is GoalStatus.ABORTED
    assert old.reason == (
        "the type turtleact_interfaces/action/Patrol has changed since the goal was accepted"
    )
