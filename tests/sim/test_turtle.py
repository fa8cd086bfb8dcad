"""One turtle as others see it: services, the colour sensor, and rotate_absolute as the real one."""

from __future__ import annotations

import logging
import math
import re

import pytest

from turtleact.errors import GoalAborted, GoalRejected
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import RotateAbsolute

from .stage import GOLDEN, POSES, TICK, stage

Goal = RotateAbsolute.Goal
WHITE = (255, 255, 255)
PEN = (179, 184, 255)


def texts(caplog):
    """What turtlesim has said, but for its beginning."""
    return [record.getMessage() for record in caplog.records if "tarting" not in record.message]


# Teleports


async def test_a_teleport_is_made_in_the_next_tick():
    async with stage() as here:
        await here.teleport(3.0, 4.0, 0.5)
        before = here.world.pose("turtle1")
        await here.pass_ticks(1)
        assert before[:3] == tuple(POSES["start"][:3])
        assert here.world.pose("turtle1")[:3] == (3.0, 4.0, 0.5)


async def test_a_quarter_turn_and_a_metre_lead_where_the_formulas_say():
    async with stage() as here:
        await here.teleport_relative(1.0, math.pi / 2)
        await here.pass_ticks(1)
        x, y, theta, *_ = here.world.pose("turtle1")
    assert (x, y, theta) == pytest.approx((5.544445, 6.544445, math.pi / 2), abs=1e-6)


@pytest.mark.parametrize("way", ["absolute", "relative"])
async def test_a_teleport_to_no_place_is_ignored_with_a_warning(way, caplog):
    async with stage() as here:
        if way == "absolute":
            await here.teleport(1.0, math.nan, 0.0)
        else:
            await here.teleport_relative(1.0, math.nan)
        await here.pass_ticks(1)
        assert list(here.world.pose("turtle1")) == POSES["start"]
    what = "y" if way == "absolute" else "angular"
    assert texts(caplog) == [
        f"a teleport was ignored: turtle1: {what} is nan: give a finite number"
    ]


# Pen and colour


async def colours_of(here, ticks):
    colours = here.colours()
    await here.pass_ticks(ticks)
    return [(colour.r, colour.g, colour.b) for colour in colours.drain()]


async def test_where_nothing_was_drawn_the_colour_is_that_of_the_real_ones_empty_canvas():
    async with stage() as here:
        assert await colours_of(here, 3) == [WHITE] * 3


async def test_a_turtle_sees_what_it_drew_before_and_not_what_it_draws_now():
    async with stage() as here:
        here.command(x=0.5)
        seen = await colours_of(here, 4)
    assert seen[0] == WHITE
    assert seen[1:] == [PEN] * 3


async def test_a_turtle_sees_the_line_of_its_teleport_at_once():
    async with stage() as here:
        await here.set_pen(1, 2, 3, 5)
        await here.teleport(2.0, 2.0, 0.0)
        assert await colours_of(here, 1) == [(1, 2, 3)]


# rotate_absolute

RECORDED = re.compile(
    r"rotate_absolute theta=(?P<theta>\S+) cancel_after=(?P<cancel>\S+) preempt=(?P<preempt>\S+):"
    r" .* status=(?P<status>\d) delta=(?P<delta>\S+); .* feedback n=(?P<told>\d+) .*"
    r" first \[\(\S+ (?P<first>[-\d.e]+)\).* last \[.*, (?P<last>[-\d.e]+)\)\];"
    r" end theta (?P<end>[-\d.e]+);"
)


def recorded():
    """The rotations of the real one, each from where the one before it has ended."""
    lines = (GOLDEN / "rotate_absolute.txt").read_text().splitlines()
    found = [RECORDED.match(line) for line in lines]
    return [match.groupdict() for match in found if match]


async def turn(here, theta):
    """Turn to a heading; the feedback and the outcome."""
    async with here.rotations().send_goal(Goal(theta)) as goal:
        told = [feedback.remaining async for feedback in goal]
        return told, await goal.outcome()


async def replay(here, each):
    """Do with a goal what was done with the real one, after as many ticks."""
    if each["cancel"] == each["preempt"] == "None":
        return await turn(here, float(each["theta"]))
    told: list[float] = []
    sending = here.rotations().send_goal(
        Goal(float(each["theta"])), feedback_callback=lambda each: told.append(each.remaining)
    )
    async with sending as goal:
        await here.node.clock.sleep(int(each["told"]) * TICK)
        if each["cancel"] != "None":
            await goal.cancel()
        else:
            second = await here.rotations().send_goal(Goal(float(each["preempt"])))
            assert second.delta == 0.0  # as recorded: it was there
        return told, await goal.outcome()


async def test_rotations_are_those_of_the_real_one_to_the_last_bit():
    seen = []
    async with stage() as here:
        await here.node.clock.sleep(TICK / 2)
        for each in recorded():
            told, outcome = await replay(here, each)
            await here.node.clock.sleep(1.5 * TICK)
            end = here.world.pose("turtle1").theta
            numbers = [outcome.result.delta, told[0], told[-1], end]
            seen.append([int(outcome.status), len(told), *numbers])
            if outcome.status is GoalStatus.CANCELED:
                await here.node.clock.sleep(0.5 * TICK)
    assert len(seen) == 7
    assert seen == [
        [
            int(each["status"]),
            int(each["told"]),
            *(float(each[name]) for name in ("delta", "first", "last", "end")),
        ]
        for each in recorded()
    ]


async def test_a_rotation_that_succeeds_says_what_the_real_one_says(caplog):
    caplog.set_level(logging.INFO)
    async with stage() as here:
        await here.rotations().send_goal(Goal(0.1))
    assert caplog.records[-1].getMessage() == "Rotation goal completed successfully"


async def test_a_new_goal_aborts_the_one_that_runs_and_begins_where_that_has_come(caplog):
    async with stage() as here:
        async with here.rotations().send_goal(Goal(-3.0)) as first:
            await here.pass_ticks(32)
            result = await here.rotations().send_goal(Goal(-0.5))
            outcome = await first.outcome()
        pose = here.world.pose("turtle1")
    assert (outcome.status, outcome.reason) == (GoalStatus.ABORTED, "preempted by another goal")
    assert outcome.result.delta == pytest.approx(0.496, abs=1e-6)
    assert result.delta == 0.0  # it was there
    assert pose.theta == pytest.approx(-0.512, abs=1e-6)
    assert texts(caplog) == [
        "Rotation goal received before a previous goal finished. Aborting previous goal"
    ]


async def test_a_command_that_comes_after_the_goal_aborts_it(caplog):
    async with stage() as here:
        async with here.rotations().send_goal(Goal(3.0)) as goal:
            await here.pass_ticks(20)
            here.command(x=1.0)
            with pytest.raises(GoalAborted, match="a velocity command arrived") as caught:
                await goal.result()
        pose = here.world.pose("turtle1")
    assert caught.value.result.delta == pytest.approx(-0.30399999, abs=1e-6)
    assert (pose.linear_velocity, pose.angular_velocity) == (1.0, 0.0)
    assert texts(caplog) == ["Velocity command received during rotation goal. Aborting goal"]


async def test_a_command_that_came_before_the_goal_does_not_abort_it(caplog):
    async with stage() as here:
        here.command(x=1.0)
        await here.rotations().send_goal(Goal(0.2))
        assert here.world.pose("turtle1").x == POSES["start"][0]
    assert texts(caplog) == []


async def test_a_teleport_changes_what_remains_of_a_rotation():
    async with stage() as here, here.rotations().send_goal(Goal(1.0)) as goal:
        await here.pass_ticks(5)
        await here.teleport(5.0, 5.0, 0.99)
        result = await goal.result()
        assert result.delta == pytest.approx(-0.99, abs=1e-6)


async def test_a_paused_rotation_stands_still_and_ends_where_an_undisturbed_one_does():
    async with stage() as here:
        told, undisturbed = await turn(here, 1.0)
    async with stage() as here, here.rotations().send_goal(Goal(1.0)) as goal:
        for _ in range(10):
            await here.pass_ticks(3)
            await goal.pause()
            await here.pass_ticks(1)
            pose = here.world.pose("turtle1")
            await here.pass_ticks(100)
            assert here.world.pose("turtle1") == pose
            assert pose.angular_velocity == 0.0
            await goal.resume()
        again = [feedback.remaining async for feedback in goal]
        assert (await goal.outcome(), again) == (undisturbed, told)


async def test_a_paused_rotation_is_canceled_and_preempted():
    async with stage() as here:
        async with here.rotations().send_goal(Goal(3.0)) as goal:
            await here.pass_ticks(3)
            await goal.pause()
            await goal.cancel()
            assert (await goal.outcome()).status is GoalStatus.CANCELED
        async with here.rotations().send_goal(Goal(3.0)) as goal:
            await here.pass_ticks(3)
            await goal.pause()
            await here.rotations().send_goal(Goal(0.0))
            assert (await goal.outcome()).reason == "preempted by another goal"


@pytest.mark.parametrize("theta", [math.nan, math.inf])
async def test_a_rotation_to_no_heading_is_rejected(theta):
    async with stage() as here:
        with pytest.raises(GoalRejected, match=f"theta is {theta}: give a finite number"):
            await here.rotations().send_goal(Goal(theta))
