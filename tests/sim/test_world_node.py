"""A whole world in a block: what it opens, and that it leaves nothing behind."""

from __future__ import annotations

import itertools
import time
from contextlib import asynccontextmanager
from types import SimpleNamespace

import pytest

from turtleact import open_world
from turtleact.actions.patrol import Patrol
from turtleact.errors import SimError
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import Point, TurtlePose, Twist, Vector3
from turtleact.tasks.clock import ScaledClock, WallClock

from ..actions.arena import tasks_alive
from ..lab import ON_ASYNCIO, settle

TARGETS = [Point(x=9.0, y=7.0), Point(x=5.0, y=1.0)]


@pytest.fixture(params=["asyncio", "trio"])
def anyio_backend(request: pytest.FixtureRequest) -> object:
    """On uvloop, each leap of virtual time takes 0.1 s; a few tests below run there too."""
    return request.param


@asynccontextmanager
async def nothing_left_behind():
    """Fails if a task that was begun in the block is alive after it."""
    before = tasks_alive()
    yield
    await settle()
    assert tasks_alive() == before


# What it opens


async def test_a_world_has_one_turtle_and_the_built_in_actions():
    async with open_world(speed="max") as node:
        graph = node.graph()
    assert [topic for topic in graph.topics if topic.endswith("/pose")] == ["/turtle1/pose"]
    assert graph.actions == {
        "/command_turtle": ("patrol_interfaces/action/PatrolCommandInterface",),
        "/fibonacci": (
            "action_tutorials_interfaces/action/Fibonacci",
            "example_interfaces/action/Fibonacci",
        ),
        "/go_to": ("turtleact_interfaces/action/GoTo",),
        "/patrol": ("turtleact_interfaces/action/Patrol",),
        "/turtle1/rotate_absolute": ("turtlesim/action/RotateAbsolute",),
        "/world/simulate_steps": ("simulation_interfaces/action/SimulateSteps",),
    }


async def test_a_world_that_is_turtlesim_only_serves_what_turtlesim_serves():
    async with open_world(speed="max", turtlesim_only=True) as node:
        graph = node.graph()
    assert graph.nodes == ("/_turtleact", "/turtlesim")
    assert list(graph.actions) == ["/turtle1/rotate_absolute"]
    assert list(graph.topics) == [
        "/parameter_events",
        "/turtle1/cmd_vel",
        "/turtle1/color_sensor",
        "/turtle1/pose",
    ]
    assert {name.rpartition("/")[0] for name in graph.services} == {"", "/turtle1", "/turtlesim"}


async def test_its_nodes_are_the_simulator_the_actions_and_the_users():
    async with open_world(speed="max") as node:
        node.publisher(TurtlePose, "my_pose")
        assert node.name == "turtleact"
        assert node.graph().nodes == ("/turtle_actions", "/turtleact", "/turtlesim", "/world")


@pytest.mark.parametrize(
    ("speed", "clock", "factor"),
    [(1.0, WallClock, 1.0), (2, ScaledClock, 2.0), ("0.5", ScaledClock, 0.5)],
)
async def test_a_speed_is_a_factor_of_wall_time(speed, clock, factor):
    async with open_world(speed=speed) as node:
        assert type(node.clock) is clock
        assert isinstance(node.clock, ScaledClock)
        assert node.clock.factor == factor


async def test_a_world_that_begins_paused_is_driven_in_lock_step():
    async with open_world(speed="max", paused=True) as node:
        poses = node.subscription(TurtlePose, "turtle1/pose")
        twists = node.publisher(Twist, "turtle1/cmd_vel")
        seen = []
        for turn in (0.0, 1.0, -1.0):
            twists.publish(Twist(Vector3(x=1.0), Vector3(z=turn)))
            await node.step(2)
            seen.append([round(pose.theta, 3) for pose in poses.drain()])
        assert node.is_paused
        node.resume()
        assert not node.is_paused
        await node.clock.sleep(1.0)
    assert seen == [[0.0, 0.0], [0.016, 0.032], [0.016, 0.0]]


@ON_ASYNCIO
async def test_a_machine_that_is_too_slow_makes_time_slower_and_misses_nothing(monkeypatch):
    """Between any two looks at the clock, 20 ms have passed: two simulated seconds."""
    moments = itertools.count()
    slow = SimpleNamespace(monotonic=lambda: 1e6 + next(moments) * 0.02, time_ns=time.time_ns)
    monkeypatch.setattr("turtleact.tasks.clock.time", slow)
    async with open_world(speed=100) as node:
        goal = Patrol.Goal(targets=TARGETS, stop_on_failure=True)
        async with node.action_client(Patrol, "patrol").send_goal(goal) as handle:
            outcome = await handle.outcome()
    assert (outcome.status, outcome.result.missed) == (GoalStatus.SUCCEEDED, [])


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"speed": 0}, "a clock's speed must be a number above zero, not 0.0"),
        ({"speed": -1.0}, "a clock's speed must be a number above zero, not -1.0"),
        ({"speed": float("nan")}, "a clock's speed must be a number above zero, not nan"),
        ({"speed": float("inf")}, "a clock's speed must be a number above zero, not inf"),
        (
            {"speed": 100.5},
            "a clock's speed is 100 at most, not 100.5; 'max' has no limit",
        ),
        (
            {"speed": 1e307},
            "a clock's speed is 100 at most, not 1e+307; 'max' has no limit",
        ),
        ({"speed": "fast"}, "a speed is a number above zero or 'max', not 'fast'"),
        ({"turtles": 0}, "a world of 0 turtles: give 1 or more"),
    ],
)
async def test_a_world_that_cannot_be_is_refused_and_nothing_opened(options, problem):
    async with nothing_left_behind():
        with pytest.raises(SimError) as caught:
            async with open_world(**options):
                pytest.fail("it was opened")
    assert str(caught.value) == problem


# What it leaves behind


@pytest.mark.parametrize("speed", [1.0, "max"])
async def test_nothing_is_left_running(speed):
    async with nothing_left_behind(), open_world(speed=speed, turtles=3):
        assert tasks_alive() > 0


async def test_nothing_is_left_open():
    async with open_world(speed="max") as node:
        node.subscription(TurtlePose, "turtle1/pose")
        assert node.transport.endpoints() != ()
    assert node.transport.endpoints() == ()


async def test_goals_that_still_run_end_with_the_world():
    async with nothing_left_behind():
        async with open_world(speed="max") as node:
            sending = node.action_client(Patrol, "patrol").send_goal(Patrol.Goal(targets=TARGETS))
            goal = await sending.__aenter__()
            await node.clock.sleep(1.0)
        outcome = await goal.outcome()
    assert (outcome.status, outcome.reason) == (GoalStatus.ABORTED, "shutdown")
