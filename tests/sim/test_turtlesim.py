"""The world as a node: its topics, its ticks, its services and parameters, and what it says."""

from __future__ import annotations

import logging
import math

import anyio
import pytest

from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import RotateAbsolute
from turtleact.interfaces.standard.rcl_interfaces.msg import IntegerRange, Parameter, ParameterValue
from turtleact.interfaces.standard.rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
)
from turtleact.sim.pictures import Pen, to_png
from turtleact.sim.world_services import Poses
from turtleact.tasks.clock import VirtualClock

from ..actions.arena import tasks_alive
from .stage import ALL, POSES, TICK, stage

pytestmark = pytest.mark.loops("asyncio", "trio")


class Jumping:
    """Virtual time that a test can put forward, past those who sleep."""

    def __init__(self) -> None:
        self.ahead = 0.0
        self._inner = VirtualClock()

    def time(self) -> float:
        return self._inner.time() + self.ahead

    def now(self) -> int:
        return self._inner.now() + int(self.ahead * 1e9)

    async def sleep(self, seconds: float) -> None:
        await self._inner.sleep(seconds)

    async def sleep_until(self, deadline: float) -> None:
        await self._inner.sleep_until(deadline - self.ahead)

    def stop_at(self, moment: float) -> None:
        self._inner.stop_at(moment - self.ahead)

    async def run(self) -> None:
        await self._inner.run()


# Topics


async def test_each_turtle_has_the_topics_of_the_real_one():
    async with stage(turtles=2) as here:
        topics = here.node.graph().topics
    assert topics.pop("/parameter_events") == ("rcl_interfaces/msg/ParameterEvent",)
    assert topics.pop("/world/poses") == ("turtleact_interfaces/msg/Poses",)
    assert topics == {
        f"/turtle{number}/{name}": (type_name,)
        for number in (1, 2)
        for name, type_name in (
            ("cmd_vel", "geometry_msgs/msg/Twist"),
            ("color_sensor", "turtlesim/msg/Color"),
            ("pose", "turtlesim/msg/Pose"),
        )
    }


async def test_the_services_and_actions_are_those_of_the_real_one():
    async with stage() as here:
        graph = here.node.graph()
    own = ("simulation_interfaces/", "turtleact_interfaces/")
    assert {
        name: types for name, (types,) in graph.actions.items() if not types.startswith(own)
    } == {"/turtle1/rotate_absolute": "turtlesim/action/RotateAbsolute"}
    assert {
        name: types for name, (types,) in graph.services.items() if not types.startswith(own)
    } == {
        "/clear": "std_srvs/srv/Empty",
        "/kill": "turtlesim/srv/Kill",
        "/reset": "std_srvs/srv/Empty",
        "/spawn": "turtlesim/srv/Spawn",
        "/turtle1/set_pen": "turtlesim/srv/SetPen",
        "/turtle1/teleport_absolute": "turtlesim/srv/TeleportAbsolute",
        "/turtle1/teleport_relative": "turtlesim/srv/TeleportRelative",
        "/turtlesim/describe_parameters": "rcl_interfaces/srv/DescribeParameters",
        "/turtlesim/get_parameter_types": "rcl_interfaces/srv/GetParameterTypes",
        "/turtlesim/get_parameters": "rcl_interfaces/srv/GetParameters",
        "/turtlesim/list_parameters": "rcl_interfaces/srv/ListParameters",
        "/turtlesim/set_parameters": "rcl_interfaces/srv/SetParameters",
        "/turtlesim/set_parameters_atomically": "rcl_interfaces/srv/SetParametersAtomically",
    }


# All turtles at once


@pytest.mark.parametrize("turtles", [1, 3, 40])
async def test_all_poses_of_a_tick_are_one_message(turtles):
    async with stage(turtles=turtles) as here:
        poses = here.node.subscription(Poses, "world/poses", ALL)
        here.command(x=2.0, turn=1.0)
        await here.pass_ticks(3)
        first, _, last = poses.drain()
        assert tuple(last.names) == here.world.names
        for index, name in enumerate(last.names):
            there = last.x, last.y, last.theta, last.linear_velocity, last.angular_velocity
            assert tuple(column[index] for column in there) == tuple(here.world.pose(name))
        assert stamp_in_ns(last.stamp) - stamp_in_ns(first.stamp) == 2 * 16_000_000


def stamp_in_ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


async def test_of_a_fleet_all_but_a_hundred_are_on_demand_to_others():
    async with stage(turtles=102) as here:
        on_demand = {each.name for each in here.node.transport.endpoints() if each.on_demand}
        assert {name.split("/")[1] for name in on_demand} == {"turtle101", "turtle102"}
        assert len(on_demand) == 2 * 11


async def test_a_pose_is_published_after_each_tick():
    async with stage() as here:
        poses = here.poses()
        here.command(x=2.0)
        await here.pass_ticks(3)
        first = POSES["start"][0]
        assert [pose.x for pose in poses.drain()] == pytest.approx(
            [first + 0.032, first + 0.064, first + 0.096], abs=1e-6
        )


async def test_of_several_commands_between_two_ticks_the_newest_counts():
    async with stage() as here:
        poses = here.poses()
        for speed in (1.0, 3.0, 2.0):
            here.command(x=speed)
        await here.pass_ticks(1)
        assert poses.drain()[-1].linear_velocity == 2.0


@pytest.mark.parametrize("value", [math.nan, math.inf])
async def test_a_command_that_is_not_finite_is_ignored_with_a_warning(value, caplog):
    async with stage() as here:
        here.command(x=1.0)
        await here.pass_ticks(1)
        here.command(turn=value)
        await here.pass_ticks(10)
        assert here.world.pose("turtle1").linear_velocity == 1.0
    (record,) = caplog.records
    assert (record.name, record.levelno) == ("turtleact.turtlesim", logging.WARNING)
    assert record.getMessage() == (
        f"a command was ignored: turtle1: omega is {value}: give a finite number"
    )


async def test_at_the_wall_it_warns_in_the_words_of_the_real_one(caplog):
    async with stage() as here:
        here.world.teleport_absolute("turtle1", 10.0, 5.0, 0.0)
        await here.pass_ticks(1)
        here.command(x=2.0)
        await here.pass_ticks(40)
    texts = [record.getMessage() for record in caplog.records]
    assert len(texts) == 40 - 34
    assert texts[1] == "Oh no! I hit the wall! (Clamping from [x=11.120889, y=6.088889])"
    assert {record.levelno for record in caplog.records} == {logging.WARNING}


# Ticks


async def test_the_ticks_do_not_drift():
    async with stage() as here:
        await here.node.clock.sleep(160.0 - TICK / 2)
        assert here.world.tick == 10_000


async def test_a_world_that_is_a_little_behind_its_clock_catches_up():
    clock = Jumping()
    async with stage(clock=clock) as here:
        await here.pass_ticks(10)
        clock.ahead = 0.9
        await clock.sleep(TICK)
        assert here.world.tick == math.ceil(clock.time() / TICK)


async def test_a_world_that_is_far_behind_its_clock_goes_on_from_there():
    clock = Jumping()
    async with stage(clock=clock) as here:
        await here.pass_ticks(10)
        before, clock.ahead = here.world.tick, 100.0
        await here.pass_ticks(10)
        assert here.world.tick - before in (10, 11, 12)


async def test_it_says_what_the_real_one_says_at_the_start(caplog):
    caplog.set_level(logging.INFO)
    async with stage(turtles=2):
        pass
    assert [record.getMessage() for record in caplog.records][:2] == [
        "Starting turtlesim with node name /turtlesim",
        "Spawning turtle [turtle1] at x=[5.544445], y=[5.544445], theta=[0.000000]",
    ]
    assert len(caplog.records) == 3


# Turtles that come and go


async def test_a_new_turtle_gets_the_next_name(caplog):
    caplog.set_level(logging.INFO)
    async with stage() as here:
        assert await here.spawn(2.0, 3.0, 0.5) == "turtle2"
        poses = here.poses("turtle2")
        await here.pass_ticks(1)
        (pose,) = poses.drain()
    assert (pose.x, pose.y, pose.theta) == (2.0, 3.0, 0.5)
    text = "Spawning turtle [turtle2] at x=[2.000000], y=[3.000000], theta=[0.500000]"
    assert caplog.records[-1].getMessage() == text


async def test_a_taken_name_is_answered_with_an_empty_one(caplog):
    async with stage() as here:
        assert await here.spawn(1.0, 1.0, 0.0, "turtle1") == ""
    assert [record.getMessage() for record in caplog.records] == [
        "A turtle named [turtle1] already exists"
    ]
    assert caplog.records[0].levelno == logging.ERROR


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("2fast", "a part begins with a digit"),
        ("a b", "only letters, digits, '_', '/' and a leading '~' are allowed"),
    ],
)
async def test_a_name_that_no_topic_can_have_is_refused_and_nothing_opened(name, why, caplog):
    async with stage() as here:
        before = here.node.transport.endpoints()
        assert await here.spawn(name=name) == ""
        assert here.node.transport.endpoints() == before
        assert here.world.names == ("turtle1",)
    assert caplog.records[-1].getMessage() == f"A turtle cannot be named [{name}]: {why}"


async def test_a_turtle_is_not_spawned_at_no_place(caplog):
    async with stage() as here:
        assert await here.spawn(math.nan, 1.0, 0.0) == ""
    assert caplog.records[-1].getMessage() == (
        "A turtle was not spawned: a new turtle: x is nan: give a finite number"
    )


async def test_a_turtle_that_is_killed_leaves_nothing_behind():
    async with stage() as here:
        before = (here.node.transport.endpoints(), tasks_alive())
        for _ in range(3):
            await here.spawn(1.0, 1.0, 0.0, "guest")
            await here.pass_ticks(2)
            await here.kill("guest")
        await here.pass_ticks(1)
        after = (here.node.transport.endpoints(), tasks_alive())
        assert after == before
        assert here.world.names == ("turtle1",)


async def test_a_turtle_is_told_where_it_is_whoever_comes_and_goes():
    async with stage() as here:
        for name in ("beta", "delta"):
            await here.spawn(float(len(name)), 2.0, 0.0, name)
        poses, colours = here.poses("delta"), here.colours("delta")
        for name in ("alpha", "gamma", "beta", "alpha"):
            if name in here.world.names:
                await here.kill(name)
            else:
                await here.spawn(1.0, 1.0, 0.0, name)
            poses.drain(), colours.drain()
            await here.pass_ticks(2)
            assert {pose.x for pose in poses.drain()} == {5.0}
            assert colours.drain()


async def test_a_turtle_that_is_not_there_cannot_be_killed(caplog):
    async with stage() as here:
        await here.kill("bob")
    (record,) = caplog.records
    assert record.getMessage() == "Tried to kill turtle [bob], which does not exist"
    assert record.levelno == logging.ERROR


async def test_a_turtle_that_is_killed_ends_its_rotation_with_a_reason():
    async with stage() as here, here.rotations().send_goal(RotateAbsolute.Goal(3.0)) as goal:
        await here.pass_ticks(10)
        await here.kill("turtle1")
        outcome = await goal.outcome()
    assert (outcome.status, outcome.reason) == (GoalStatus.ABORTED, "turtle 'turtle1' was killed")
    assert outcome.result.delta == pytest.approx(-9 * TICK)


async def test_a_reset_leaves_turtle1_at_the_start(caplog):
    caplog.set_level(logging.INFO)
    async with stage(turtles=3) as here:
        poses = here.poses()
        here.command(x=1.0)
        await here.pass_ticks(10)
        await here.reset()
        poses.drain()
        await here.pass_ticks(1)
        (pose,) = poses.drain()
        assert here.world.names == ("turtle1",)
        assert await here.spawn() == "turtle2"
    assert [pose.x, pose.y, pose.theta, pose.linear_velocity] == POSES["start"][:4]
    assert [record.getMessage() for record in caplog.records][-3:-1] == [
        "Resetting turtlesim.",
        "Spawning turtle [turtle1] at x=[5.544445], y=[5.544445], theta=[0.000000]",
    ]


async def test_a_reset_leaves_nothing_of_the_others_behind():
    async with stage() as here:
        before = sorted(each.name for each in here.node.transport.endpoints())
        for _ in range(3):
            await here.spawn()
        async with here.rotations("turtle2").send_goal(RotateAbsolute.Goal(3.0)) as goal:
            await here.pass_ticks(2)
            await here.reset()
            assert (await goal.outcome()).reason == "turtle 'turtle2' was killed"
        await here.pass_ticks(1)
        here.command(x=1.0)
        await here.pass_ticks(1)
        assert here.world.pose("turtle1").linear_velocity == 1.0
    after = sorted(each.name for each in here.node.transport.endpoints())
    assert set(after) <= set(before)


async def test_requests_that_come_together_leave_each_turtle_with_its_endpoints_once(caplog):
    async with stage() as here:
        async with anyio.create_task_group() as group:
            for call in (here.spawn, here.reset, here.spawn, here.reset, here.spawn):
                group.start_soon(call)
        served = [each.name for each in here.node.transport.endpoints() if "set_pen" in each.name]
        assert sorted(served) == [f"/{name}/set_pen" for name in here.world.names]
    assert caplog.records == []


# What is drawn


async def test_a_snapshot_shows_the_drawing_the_turtles_and_the_background():
    async with stage(turtles=2) as here:
        here.command(x=2.0)
        await here.pass_ticks(20)
        await set_background(here, r=10)
        snapshot = here.sim.snapshot()
    assert snapshot.background == (10, 86, 255)
    assert [len(line.points) for line in snapshot.polylines] == [2]
    assert len(snapshot.turtles) == 2
    assert snapshot.turtles[0].place.real == pytest.approx(5.5444 + 0.64, abs=1e-3)
    assert len(to_png(snapshot)) > 500


async def test_clear_erases_the_drawing_and_leaves_the_turtles(caplog):
    caplog.set_level(logging.INFO)
    async with stage() as here:
        here.command(x=2.0)
        await here.pass_ticks(20)
        before = here.world.pose("turtle1")
        await here.clear()
        assert not any(here.sim.snapshot().pixels)
        assert here.world.pose("turtle1") == before
    assert caplog.records[-1].getMessage() == "Clearing turtlesim."


async def test_a_reset_erases_the_drawing_and_renews_the_pen():
    async with stage() as here:
        await here.set_pen(255, 0, 0, 9)
        here.command(x=2.0)
        await here.pass_ticks(20)
        await here.reset()
        here.command(x=2.0)
        await here.pass_ticks(20)
        (line,) = here.sim.snapshot().polylines
    assert line.pen == Pen()


# Parameters


async def set_background(here, **channels):
    """Set channels of the background; what came of each."""
    parameters = [
        Parameter(f"background_{name}", ParameterValue(2, integer_value=value))
        for name, value in channels.items()
    ]
    service = "turtlesim/set_parameters"
    return (await here.call(SetParameters, service, parameters)).results


async def test_the_background_is_a_parameter_with_the_real_bounds():
    async with stage() as here:
        good, bad = await set_background(here, g=255, b=256)
        assert (good.successful, bad.successful) == (True, False)
        assert bad.reason.startswith("Parameter {background_b} doesn't comply with integer range.")
        assert here.sim.snapshot().background == (69, 255, 255)


async def test_its_parameters_are_those_of_the_real_one():
    async with stage() as here:
        listed = await here.call(ListParameters, "turtlesim/list_parameters")
        names = listed.result.names
        read = await here.call(GetParameters, "turtlesim/get_parameters", names)
        told = await here.call(DescribeParameters, "turtlesim/describe_parameters", names)
    assert names == ["background_b", "background_g", "background_r", "holonomic"]
    assert [value.integer_value for value in read.values[:3]] == [255, 86, 69]
    assert (read.values[3].type, read.values[3].bool_value) == (1, False)
    assert [each.description for each in told.descriptors] == [
        "Blue channel of the background color",
        "Green channel of the background color",
        "Red channel of the background color",
        "If true, then turtles will be holonomic",
    ]
    assert told.descriptors[0].integer_range == [IntegerRange(0, 255, 1)]


async def test_turtles_become_holonomic_by_a_parameter():
    async with stage() as here:
        holonomic = Parameter("holonomic", ParameterValue(1, bool_value=True))
        await here.call(SetParameters, "turtlesim/set_parameters", [holonomic])
        here.command(y=1.0)
        await here.pass_ticks(1)
        assert here.world.pose("turtle1").linear_velocity == 1.0
