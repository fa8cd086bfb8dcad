"""Pausing the actions that drive: their turtles stand still, and so does their time."""

from __future__ import annotations

import itertools
import math
from random import Random

import anyio
import pytest

import turtleact
from turtleact.actions.go_to import GoTo
from turtleact.actions.patrol import Patrol
from turtleact.errors import GoalAborted, GoalCanceled
from turtleact.interfaces import Message, to_dict
from turtleact.interfaces.standard import Kill, PatrolCommandInterface, Point, TurtlePose

from .arena import arena
from .rover import ODOMETRY, rover

pytestmark = pytest.mark.loops("asyncio")

DT = 0.016
ID = bytes(range(16))
TARGETS = [Point(x=x, y=y) for x, y in ((9.0, 7.0), (5.0, 1.0), (1.0, 7.0), (2.0, 9.0))]
GOALS = {
    "patrol": (Patrol, Patrol.Goal(targets=TARGETS)),
    "command_turtle": (PatrolCommandInterface, PatrolCommandInterface.Goal(targets=TARGETS)),
    "go_to": (GoTo, GoTo.Goal(x=9.0, y=1.0, theta=2.0, heading_tolerance=0.1)),
}


class Pauser:
    """Pauses a goal at random until it ends.

    Attributes:
        paused: All pauses: from when to when.
    """

    def __init__(self, clock, handle, chance: Random, *, between: float, most: float) -> None:
        self.paused: list[tuple[float, float]] = []
        self._clock = clock
        self._handle = handle
        self._chance = chance
        self._between = between
        self._most = most

    async def run(self, count: int) -> None:
        for _ in range(count):
            await self._clock.sleep(self._chance.uniform(0.0, 2 * self._between))
            await self._handle.pause()
            began = self._clock.time()
            await self._clock.sleep(self._chance.uniform(0.0, self._most))
            await self._handle.resume()
            self.paused.append((began, self._clock.time()))


async def told_by(stage, action, name, goal, pauser=None, count=0):
    """Feedback and result of a goal, and the time that it took (s)."""
    clock = stage.node.clock
    began = clock.time()
    async with (
        stage.node.action_client(action, name).send_goal(goal) as handle,
        anyio.create_task_group() as group,
    ):
        made = Pauser(clock, handle, **pauser) if pauser else None
        if made:
            group.start_soon(made.run, count)
        told = [feedback async for feedback in handle]
        result = await handle.result()
        took = clock.time() - began
    return told, result, took, made.paused if made else []


def ticks_in(pauses):
    """How many ticks pass in some pauses."""
    return sum(math.floor(end / DT) - math.floor(begin / DT) for begin, end in pauses)


def about(message):
    """A message whose numbers may differ by rounding."""
    return pytest.approx(numbers_in(to_dict(message)), abs=1e-5)


def numbers_in(value):
    if isinstance(value, dict):
        return [each for one in value.values() for each in numbers_in(one)]
    if isinstance(value, list):
        return [each for one in value for each in numbers_in(one)]
    return [value] if isinstance(value, float | int) else []


async def test_a_patrol_with_1000_pauses_gives_the_result_of_an_undisturbed_one():
    goal = Patrol.Goal(targets=TARGETS, loops=3)
    async with arena() as stage:
        told, result, took, _ = await told_by(stage, Patrol, "patrol", goal)
    chance = {"chance": Random(1), "between": 0.9 * took / 1000, "most": 0.1}
    async with arena() as stage:
        again = await told_by(stage, Patrol, "patrol", goal, chance, 1000)
    paused = again[3]
    assert len(paused) == 1000
    assert numbers_in(to_dict(again[1])) == about(result)
    assert [numbers_in(to_dict(each)) for each in again[0]] == [about(each) for each in told]
    assert again[2] - took == pytest.approx(DT * ticks_in(paused))
    assert again[2] - took == pytest.approx(sum(end - begin for begin, end in paused), rel=0.02)


@pytest.mark.parametrize("name", GOALS)
async def test_a_paused_turtle_stands_still_within_a_tick(name):
    action, goal = GOALS[name]
    async with arena() as stage:
        clock = stage.node.clock
        async with stage.node.action_client(action, name).send_goal(goal) as handle:
            await clock.sleep(1.0)
            at = stage.place
            await handle.pause()
            await clock.sleep(DT)
            stood = stage.place
            assert math.dist(at[:2], stood[:2]) <= 2.0 * DT
            count = len(stage.commands())
            await clock.sleep(60.0)  # longer than the time limit
            assert (stage.place, stage.commands()) == (stood, [])
            assert count
            await handle.resume()
            await handle.result()


@pytest.mark.parametrize("name", GOALS)
async def test_no_feedback_comes_in_a_pause(name):
    action, goal = GOALS[name]
    told: list[Message] = []
    async with arena() as stage:
        clock = stage.node.clock
        async with stage.node.action_client(action, name).send_goal(
            goal, feedback_callback=told.append
        ) as handle:
            for tick in range(20, 40):
                await clock.sleep(DT * (tick % 13))
                await handle.pause()
                count = len(told)
                await clock.sleep(1.5)
                assert len(told) == count
                await handle.resume()
            await handle.result()


@pytest.mark.parametrize("name", GOALS)
async def test_a_paused_goal_is_canceled_at_once(name):
    action, goal = GOALS[name]
    async with arena() as stage:
        clock = stage.node.clock
        async with stage.node.action_client(action, name).send_goal(goal) as handle:
            await clock.sleep(1.0)
            await handle.pause()
            await clock.sleep(1.0)
            now = clock.time()
            await handle.cancel()
            with pytest.raises(GoalCanceled):
                await handle.result()
            assert clock.time() == now
        assert await stage.stands_still()


async def test_a_turtle_that_is_killed_in_a_pause_ends_its_goal():
    async with arena() as stage:
        clock = stage.node.clock
        action, goal = GOALS["patrol"]
        async with stage.node.action_client(action, "patrol").send_goal(goal) as handle:
            await clock.sleep(1.0)
            await handle.pause()
            await stage.node.service_client(Kill, "kill").call(Kill.Request("turtle1"))
            with pytest.raises(GoalAborted, match="turtle 'turtle1' is gone"):
                await handle.result()


async def test_a_goal_that_was_paused_is_at_rest_after_a_restart(tmp_path):
    async with turtleact.open_journal(tmp_path / "goals.db") as journal:
        for is_restarted in (False, True):
            async with turtleact.open_world(
                speed="max", journal=journal, on_restart="resume"
            ) as node:
                client = node.action_client(Patrol, "patrol")
                poses = node.subscription(TurtlePose, "turtle1/pose")
                if not is_restarted:
                    async with client.send_goal(Patrol.Goal(targets=TARGETS), goal_id=ID) as handle:
                        handle.detach()
                        await handle.pause()
                    continue
                async with client.attach(ID) as handle:
                    assert handle.is_paused
                    at = await anext(poses)
                    await node.clock.sleep(10.0)
                    assert poses.latest == at
                    await handle.resume()
                    assert (await handle.result()).reached == 4


async def test_a_robot_with_limited_accelerations_starts_from_rest():
    async with rover() as robot:
        clock = robot.node.clock
        client = robot.node.action_client(GoTo, "go_to")
        goal = GoTo.Goal(x=4.0, y=0.0, turtle="rover", max_linear=1.0, max_angular=1.0)
        async with client.send_goal(goal) as handle:
            await clock.sleep(2.5)
            assert robot.speeds[0] > 0.9
            await handle.pause()
            await clock.sleep(0.4)
            assert robot.speeds == (0.0, 0.0)
            at = robot.pose
            await clock.sleep(10.0)
            assert robot.pose == at
            robot.told.clear()
            robot.told.append((0.0, 0.0))
            await handle.resume()
            result = await handle.result()
        steps = [after - before for (before, _), (after, _) in itertools.pairwise(robot.told)]
        assert 0.0 < max(steps) <= ODOMETRY.max_acceleration * ODOMETRY.dt * 1.3
        assert result.duration < 8.0
