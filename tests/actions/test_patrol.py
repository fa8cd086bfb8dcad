"""``/patrol`` and ``/command_turtle``, in the world's own time."""

from __future__ import annotations

import math
from contextlib import aclosing, asynccontextmanager
from pathlib import Path

import anyio
import pytest

from turtleact.actions.patrol import Patrol
from turtleact.errors import GoalAborted, GoalRejected
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import load_interface
from turtleact.interfaces import standard as standard_interfaces
from turtleact.interfaces.standard import (
    Empty,
    PatrolCommandInterface,
    Point,
    Twist,
    Vector3,
)
from turtleact.tasks import Background

from .arena import MARK, arena

TARGETS = [(9.0, 7.0), (5.0, 1.0), (1.0, 7.0), (2.0, 9.0)]
MIDDLE = 11.088889122009277 / 2


def points(*targets):
    return [Point(x=x, y=y) for x, y in targets]


def patrol(*targets, **options):
    return Patrol.Goal(targets=points(*targets), **options)


def client_of(stage):
    return stage.node.action_client(Patrol, "patrol")


async def feedback_of(stage, goal):
    """All feedback, each with the time since the start, and the result."""
    clock = stage.node.clock
    start = clock.time()
    async with client_of(stage).send_goal(goal) as sent:
        told = [(clock.time() - start, feedback) async for feedback in sent]
        return told, await sent.result()


async def rejection(goal, **options):
    async with arena(**options) as stage:
        with pytest.raises(GoalRejected) as caught:
            await client_of(stage).send_goal(goal)
        assert stage.twists.latest is None
    return caught.value.reason


# The patrol of the README


async def test_the_default_patrol_drives_forwards_in_almost_the_shortest_time():
    async with arena() as stage:
        result = await client_of(stage).send_goal(patrol(*TARGETS))
        assert all(linear >= 0.0 for linear, _ in stage.commands())
        assert await stage.stands_still()
    assert (result.reached, result.missed) == (4, [])
    assert result.duration <= 1.10 * 9.93  # no turtle can drive it in less than 9.93 s


async def test_each_target_is_told_when_it_is_reached():
    async with arena() as stage:
        told, _ = await feedback_of(stage, patrol(*TARGETS))
    reached = [feedback for _, feedback in told if feedback.is_reached]
    assert [each.index for each in reached] == [0, 1, 2, 3]
    assert [each.reached for each in reached] == [1, 2, 3, 4]
    assert [each.target for each in reached] == points(*TARGETS)


async def test_on_the_way_there_is_feedback_once_a_second():
    async with arena() as stage:
        told, _ = await feedback_of(stage, patrol((11.0, MIDDLE), max_linear=1.0))
    times = [time for time, feedback in told if not feedback.is_reached]
    assert times == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0], abs=0.033)


async def test_the_distance_remaining_goes_through_all_targets_and_rounds():
    goal = patrol((9.0, MIDDLE), (7.0, MIDDLE), loops=1, style="rotate_then_drive")
    async with arena() as stage:
        told, _ = await feedback_of(stage, goal)
    first = told[0][1]
    assert first.distance_remaining == pytest.approx(9.0 - first.pose.x + 2.0 + 2.0 + 2.0)
    left = [feedback.distance_remaining for _, feedback in told if feedback.is_reached]
    assert left == pytest.approx([6.0, 4.0, 2.0, 0.0])


# Where targets are


async def test_extra_rounds_visit_all_targets_again():
    async with arena() as stage:
        told, result = await feedback_of(stage, patrol((9.0, 7.0), (5.0, 1.0), loops=2))
    assert result.reached == 6
    assert [f.index for _, f in told if f.is_reached] == [0, 1, 0, 1, 0, 1]


# What a goal may choose


async def test_two_turtles_patrol_side_by_side():
    async with arena(turtles=2) as stage:
        client = client_of(stage)
        start = stage.node.clock.time()
        async with (
            client.send_goal(patrol(*TARGETS)) as one,
            client.send_goal(patrol(*TARGETS, turtle="turtle2")) as two,
        ):
            results = [await one.result(), await two.result()]
        took = stage.node.clock.time() - start
    assert [result.reached for result in results] == [4, 4]
    assert took < sum(result.duration for result in results) - 5.0


# What is refused

NO = "must be finite and above zero, not"
REFUSED = [
    ({"turtle": "turtle1/"}, "'turtle1/' is not a valid name of a turtle: it ends in a slash"),
    ({"targets": []}, "targets is empty: give at least one place"),
    (
        {"targets": points((1.0, 1.0), (20.0, 3.0))},
        "targets[1].x is 20.0, outside the world: from 0 to 11.0888891",
    ),
    (
        {"targets": points((1.0, 1.0), (2.0, 2.0), (3.0, -0.5))},
        "targets[2].y is -0.5, outside the world: from 0 to 11.0888891",
    ),
    (
        {"targets": points((1.0, float("nan")))},
        "targets[0].y is nan, outside the world: from 0 to 11.0888891",
    ),
    (
        {"targets": points((float("inf"), 1.0))},
        "targets[0].x is inf, outside the world: from 0 to 11.0888891",
    ),
    ({"loops": -1}, "loops is -1: it is a number of extra rounds, 0 or more"),
    (
        {"turtle": "turtle7"},
        "there is no turtle 'turtle7': nobody publishes turtle7/pose",
    ),
    ({"turtle": ""}, "there is no turtle '': nobody publishes /pose"),
    ({"style": "arc"}, "style: 'arc' is none of natural, rotate_then_drive"),
    ({"tolerance": 0.0}, f"tolerance: {NO} 0.0"),
    ({"max_linear": -1.0}, f"max_linear: {NO} -1.0"),
    ({"max_angular": float("nan")}, f"max_angular: {NO} nan"),
    ({"max_angular": 99.0}, "max_angular: must be 98.17 rad/s at most, not 99.0"),
]


@pytest.mark.parametrize(("options", "reason"), REFUSED, ids=[str(o) for o, _ in REFUSED])
async def test_what_cannot_be_done_is_rejected_by_name(options, reason):
    goal = Patrol.Goal(**({"targets": points((1.0, 1.0))} | options))
    assert await rejection(goal) == reason


@pytest.mark.parametrize("name", ["turtle1", "/turtle1"])
async def test_a_turtle_that_is_being_driven_is_rejected_by_any_of_its_names(name):
    async with arena() as stage, client_of(stage).send_goal(patrol(*TARGETS)):
        await stage.node.clock.sleep(1.0)
        reason = f"turtle '{name}' is being driven by another goal"
        with pytest.raises(GoalRejected, match=f"^the goal was rejected: {reason}$"):
            await client_of(stage).send_goal(patrol((1.0, 1.0), turtle=name))


async def test_of_two_goals_sent_at_once_one_drives_the_turtle():
    reasons, results = [], []

    async def send(client):
        try:
            results.append(await client.send_goal(patrol(*TARGETS)))
        except (GoalRejected, GoalAborted) as error:
            reasons.append(error.reason)

    async with arena() as stage, anyio.create_task_group() as group:
        group.start_soon(send, client_of(stage))
        group.start_soon(send, client_of(stage))
    assert [result.reached for result in results] == [4]
    assert reasons == ["turtle 'turtle1' is being driven by another goal"]


# How it ends


MOMENTS = {"at the start": 0.0, "in the middle": 5.0, "during the last target": 9.6}


@pytest.mark.parametrize("moment", MOMENTS)
async def test_a_canceled_patrol_stops_the_turtle(moment):
    async with arena() as stage, client_of(stage).send_goal(patrol(*TARGETS)) as goal:
        await stage.node.clock.sleep(MOMENTS[moment])
        await goal.cancel()
        assert (await goal.outcome()).status is GoalStatus.CANCELED
        assert await stage.stands_still()


async def test_a_canceled_patrol_tells_what_it_has_done():
    async with arena() as stage, client_of(stage).send_goal(patrol(*TARGETS)) as goal:
        async for feedback in goal:
            if feedback.reached == 2:
                break
        await stage.node.clock.sleep(1.0)
        await goal.cancel()
        result = (await goal.outcome()).result
        took = stage.node.clock.time()
    assert (result.reached, result.missed) == (2, [])
    assert result.duration == pytest.approx(took, abs=0.04)
    assert result.distance == pytest.approx(2.0 * took, abs=0.4)


# What others do to the turtle


async def push_back(stage, *, to, every):
    """Teleport the turtle again and again."""
    while True:
        await stage.node.clock.sleep(every)
        stage.world.teleport_absolute("turtle1", *to, 0.0)


async def drive_too(stage, *, speed, every):
    """Somebody else publishes commands; the turtle follows the last one before a tick."""
    twists = stage.node.publisher(Twist, "turtle1/cmd_vel")
    while True:
        twists.publish(Twist(linear=Vector3(y=MARK), angular=Vector3(z=speed)))
        await stage.node.clock.sleep(every)


@asynccontextmanager
async def disturbed(disturb, **how):
    """An arena in which somebody disturbs ``turtle1``."""
    async with arena() as stage, aclosing(Background(disturb(stage, **how), "a disturber")):
        yield stage


async def test_a_turtle_that_is_pushed_now_and_then_reaches_its_targets():
    async with disturbed(drive_too, speed=-3.0, every=0.5) as stage:
        result = await client_of(stage).send_goal(patrol(*TARGETS))
    assert (result.reached, result.missed) == (4, [])


async def test_a_target_that_is_never_reached_is_missed_and_the_next_headed_for():
    async with disturbed(push_back, to=(1.0, 1.0), every=0.5) as stage:
        result = await client_of(stage).send_goal(patrol((9.0, 7.0), (1.5, 1.0), (8.0, 8.0)))
        assert await stage.stands_still()
    assert (result.reached, result.missed) == (1, [0, 2])


async def test_a_patrol_that_somebody_else_keeps_from_its_target_says_so():
    async with disturbed(drive_too, speed=3.0, every=0.016) as stage:
        with pytest.raises(GoalAborted) as caught:
            await client_of(stage).send_goal(patrol((9.0, 7.0), stop_on_failure=True))
    late = "targets[0] was not reached in time"
    assert caught.value.reason == f"{late}: somebody else publishes turtle1/cmd_vel too"


async def test_a_patrol_may_stop_on_failure():
    async with disturbed(push_back, to=(1.0, 1.0), every=0.5) as stage:
        goal = patrol((1.5, 1.0), (8.0, 8.0), (1.5, 1.0), stop_on_failure=True)
        with pytest.raises(GoalAborted) as caught:
            await client_of(stage).send_goal(goal)
        assert await stage.stands_still()
    assert caught.value.reason == "targets[1] was not reached in time"
    result = caught.value.result
    assert (result.reached, result.missed) == (1, [1])
    assert result.duration > 0.0


async def test_a_patrol_goes_on_from_where_a_reset_has_put_its_turtle():
    async with arena() as stage, client_of(stage).send_goal(patrol((9.0, 7.0))) as goal:
        await stage.node.clock.sleep(1.0)
        await stage.node.service_client(Empty, "reset").call(Empty.Request())
        result = await goal.result()
        assert math.dist(stage.place[:2], (9.0, 7.0)) <= 0.1
    assert (result.reached, result.missed) == (1, [])


# The lecture's

FILE = "patrol_interfaces/action/PatrolCommandInterface.action"


def command(*targets):
    return PatrolCommandInterface.Goal(targets=points(*targets))


def lecture_client_of(stage):
    return stage.node.action_client(PatrolCommandInterface, "command_turtle")


def test_the_lectures_interface_is_its_file():
    file = Path(standard_interfaces.__file__).parent / FILE
    text = "geometry_msgs/Point[] targets --- string result_msg --- string feedback_msg"
    assert " ".join(file.read_text("utf-8").split()) == text
    lecture = load_interface(file)
    for part in ("Goal", "Result", "Feedback"):
        ours = getattr(PatrolCommandInterface, part)
        assert ours.__struct_fields__ == getattr(lecture, part).__struct_fields__


async def test_the_lectures_patrol_is_served_under_its_name_and_type():
    async with arena() as stage:
        types = stage.node.graph().actions["/command_turtle"]
    assert types == ("patrol_interfaces/action/PatrolCommandInterface",)


async def test_the_lectures_patrol_says_the_lectures_words():
    async with arena() as stage:
        async with lecture_client_of(stage).send_goal(command(*TARGETS)) as goal:
            told = [feedback.feedback_msg async for feedback in goal]
            result = await goal.result()
        assert await stage.stands_still()
    assert told == [f"Target {number} reached" for number in (1, 2, 3, 4)]
    assert result == PatrolCommandInterface.Result(result_msg="Patrolling complete!")


async def test_the_lectures_patrol_ends_at_the_first_target_that_is_not_reached():
    async with disturbed(push_back, to=(1.0, 1.0), every=0.5) as stage:
        with pytest.raises(GoalAborted) as caught:
            await lecture_client_of(stage).send_goal(command((8.0, 8.0), (1.0, 1.0)))
        assert await stage.stands_still()
    assert caught.value.reason == "targets[0] was not reached in time"


@pytest.mark.parametrize(
    ("targets", "reason"),
    [
        ([], "targets is empty"),
        ([(1.0, 1.0), (1.0, 12.0)], r"targets\[1\].y is 12.0, outside the world"),
    ],
)
async def test_the_lectures_patrol_rejects_the_same_targets(targets, reason):
    async with arena() as stage:
        with pytest.raises(GoalRejected, match=reason):
            await lecture_client_of(stage).send_goal(command(*targets))
