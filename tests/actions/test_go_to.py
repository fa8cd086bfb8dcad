"""``/go_to``, in the world's own time."""

from __future__ import annotations

import math

import pytest

from turtleact.actions.go_to import GoTo
from turtleact.errors import GoalAborted, GoalRejected
from turtleact.geometry import distance
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import Kill

from .arena import STYLES, arena

pytestmark = pytest.mark.loops("asyncio", "trio")

MIDDLE = 11.088889122009277 / 2
FAR = GoTo.Goal(x=9.0, y=MIDDLE, max_linear=1.0)


def client_of(stage):
    return stage.node.action_client(GoTo, "go_to")


def away(stage, x, y):
    """How far the turtle is from a place."""
    return distance(stage.place[0], stage.place[1], x, y)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("target", [(9.0, 7.0), (1.0, 5.0), (MIDDLE, 5.9), (0.0, 0.0)])
async def test_a_turtle_goes_where_it_is_told(style, target):
    async with arena() as stage:
        x, y = target
        await client_of(stage).send_goal(GoTo.Goal(x=x, y=y, style=style))
        assert away(stage, x, y) <= 0.1
        assert await stage.stands_still()


async def test_the_result_tells_how_far_it_was_and_how_long_it_took():
    async with arena() as stage:
        start = stage.node.clock.time()
        result = await client_of(stage).send_goal(FAR)
        assert result.duration == pytest.approx(stage.node.clock.time() - start, abs=0.02)
        assert result.distance == pytest.approx(stage.place[0] - MIDDLE, abs=1e-5)


async def test_a_target_where_the_turtle_stands_is_reached_at_once_and_in_silence():
    async with arena() as stage, client_of(stage).send_goal(GoTo.Goal(x=MIDDLE, y=MIDDLE)) as goal:
        told = [feedback async for feedback in goal]
        result = await goal.result()
    assert (told, result.distance) == ([], 0.0)
    assert result.duration <= 0.016


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("theta", [0.0, 2.0, 1e14])
async def test_a_turtle_ends_in_the_heading_that_is_wanted(style, theta):
    goal = GoTo.Goal(x=7.0, y=7.0, theta=theta, heading_tolerance=0.02, style=style)
    async with arena() as stage:
        await client_of(stage).send_goal(goal)
        assert abs(math.remainder(stage.place[2] - theta, math.tau)) <= 0.02
        assert away(stage, 7.0, 7.0) <= 0.1


async def test_without_a_tolerance_any_heading_will_do():
    async with arena() as stage:
        await client_of(stage).send_goal(GoTo.Goal(x=8.0, y=MIDDLE, theta=2.0))
        assert stage.place[2] == 0.0


async def test_there_is_feedback_at_the_start_once_a_second_and_at_the_end():
    async with arena() as stage, client_of(stage).send_goal(FAR) as goal:
        start = stage.node.clock.time()
        told = [(stage.node.clock.time() - start, feedback) async for feedback in goal]
    assert [time for time, _ in told] == pytest.approx([0.016, 1.0, 2.0, 3.0, 3.43], abs=0.1)
    left = [feedback.distance_remaining for _, feedback in told]
    assert left == pytest.approx([9.0 - feedback.pose.x for _, feedback in told])
    assert left[-1] <= 0.1


async def test_speeds_and_tolerance_are_those_of_the_goal():
    goal = GoTo.Goal(x=8.0, y=8.0, max_linear=0.5, max_angular=0.25, tolerance=0.5)
    async with arena() as stage:
        await client_of(stage).send_goal(goal)
        commands = stage.commands()
        assert away(stage, 8.0, 8.0) == pytest.approx(0.5, abs=0.01)
    assert max(abs(linear) for linear, _ in commands) == 0.5
    assert max(abs(angular) for _, angular in commands) == 0.25


NO = "must be finite and above zero, not"
REFUSED = [
    ({"x": 12.0}, "x is 12.0, outside the world: from 0 to 11.0888891"),
    ({"y": -1.0}, "y is -1.0, outside the world: from 0 to 11.0888891"),
    ({"x": float("nan")}, "x is nan, outside the world: from 0 to 11.0888891"),
    ({"turtle": "turtle2"}, "there is no turtle 'turtle2': nobody publishes turtle2/pose"),
    ({"style": "fastest"}, "style: 'fastest' is none of natural, rotate_then_drive"),
    ({"style": ""}, "style: '' is none of natural, rotate_then_drive"),
    ({"tolerance": -0.1}, f"tolerance: {NO} -0.1"),
    ({"max_linear": 0.0}, f"max_linear: {NO} 0.0"),
    ({"heading_tolerance": -1.0}, f"heading_tolerance: {NO} -1.0"),
    ({"theta": float("inf")}, "theta is inf: it is an angle in rad"),
]


@pytest.mark.parametrize(("options", "reason"), REFUSED, ids=[str(o) for o, _ in REFUSED])
async def test_what_cannot_be_done_is_rejected_by_name(options, reason):
    async with arena() as stage:
        with pytest.raises(GoalRejected) as caught:
            await client_of(stage).send_goal(GoTo.Goal(**options))
        assert stage.twists.latest is None
    assert caught.value.reason == reason


async def test_a_canceled_goal_tells_how_far_the_turtle_got():
    async with arena() as stage, client_of(stage).send_goal(FAR) as goal:
        await stage.node.clock.sleep(2.0)
        await goal.cancel()
        result = (await goal.outcome()).result
    assert (result.distance, result.duration) == pytest.approx((2.0, 2.0), abs=0.04)


async def test_a_place_that_is_never_reached_aborts_the_goal():
    async with arena() as stage, client_of(stage).send_goal(FAR) as goal:
        async for feedback in goal:
            assert feedback.pose.x < 9.0
            stage.world.teleport_absolute("turtle1", 1.0, 1.0, 0.0)
        with pytest.raises(GoalAborted) as caught:
            await goal.result()
        assert await stage.stands_still()
    assert caught.value.reason == "x: 9, y: 5.54444 was not reached in time"
    assert caught.value.result.duration > 2 * 3.0


async def test_a_goal_whose_turtle_is_killed_ends_with_a_reason_within_a_second():
    async with arena() as stage, client_of(stage).send_goal(FAR) as goal:
        await stage.node.clock.sleep(1.0)
        await stage.node.service_client(Kill, "kill").call(Kill.Request("turtle1"))
        outcome = await goal.outcome()
        assert stage.node.clock.time() <= 2.1
    assert outcome.status is GoalStatus.ABORTED
    assert outcome.reason == "turtle 'turtle1' is gone: nobody publishes turtle1/pose any more"
    assert outcome.result.distance == pytest.approx(1.0, abs=0.04)
