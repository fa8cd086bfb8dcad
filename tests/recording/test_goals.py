"""The goals in a bag: what its topics tell, with and without service events."""

from contextlib import suppress

import pytest

import turtleact
from turtleact import GoalRejected, GoalStatus, open_node, recording
from turtleact.interfaces.standard import ExampleFibonacci as Fibonacci
from turtleact.recording import RecordedGoal


async def body(goal):
    for number in range(goal.order):
        yield Fibonacci.Feedback([number])
    if goal.order > 4:
        raise turtleact.Abort("too far", Fibonacci.Result([1]))
    yield Fibonacci.Result([goal.order])


def refuse(goal):
    if goal.order < 0:
        raise turtleact.Reject("negative")
    return turtleact.GoalResponse.ACCEPT


async def recorded(path, introspection, *orders) -> list[RecordedGoal]:
    async with open_node("lab") as node:
        node.action_server(
            Fibonacci, "fibonacci", body, goal_callback=refuse, introspection=introspection
        )
        client = node.action_client(Fibonacci, "fibonacci")
        async with recording.record(node, path, actions=["fibonacci"]):
            for order in orders:
                with suppress(turtleact.GoalAborted, GoalRejected):
                    await client.send_goal(Fibonacci.Goal(order=order))
    return await recording.goals(path)


async def test_with_contents_all_is_known(tmp_path):
    done, aborted, rejected = await recorded(tmp_path / "run", "contents", 3, 5, -1)
    assert done.goal == Fibonacci.Goal(order=3)
    assert done.result == Fibonacci.Result([3])
    assert done.feedback_count == 3
    assert done.type_name == "example_interfaces/action/Fibonacci"
    assert [each for _, each in done.states] == [
        GoalStatus.ACCEPTED,
        GoalStatus.EXECUTING,
        GoalStatus.SUCCEEDED,
    ]
    assert done.accepted
    assert done.reason == ""
    assert done.duration is not None
    assert 0 <= done.duration < 10
    assert (aborted.status, aborted.result) == (GoalStatus.ABORTED, Fibonacci.Result([1]))
    assert aborted.reason == "too far"
    assert (rejected.accepted, rejected.states, rejected.reason) == (False, [], "negative")
    assert rejected.duration is None


@pytest.mark.parametrize("introspection", ["off", "metadata"])
async def test_without_contents_states_and_feedback_are_known(tmp_path, introspection):
    done, aborted = await recorded(tmp_path / "run", introspection, 3, 5)
    assert (done.status, done.feedback_count) == (GoalStatus.SUCCEEDED, 3)
    assert (aborted.status, aborted.feedback_count) == (GoalStatus.ABORTED, 5)
    assert done.goal is done.result is None
    assert (done.reason, aborted.reason) == ("", "too far")
    assert done.type_name == "example_interfaces/action/Fibonacci"


async def test_the_reason_of_a_rejection_is_known_without_its_contents(tmp_path):
    [rejected] = await recorded(tmp_path / "run", "metadata", -1)
    assert (rejected.accepted, rejected.reason, rejected.goal) == (False, "negative", None)


def test_a_rejection_without_a_reason_is_called_one():
    """Bags of ROS 2 have no reasons."""
    goal = RecordedGoal(action="/fibonacci", id=bytes(16), stamp=0, accepted=False)
    assert goal.reason == "rejected"


async def test_a_goal_that_has_not_ended_says_so(tmp_path):
    async with open_node("lab") as node:
        node.action_server(Fibonacci, "fibonacci", forever)
        client = node.action_client(Fibonacci, "fibonacci")
        async with client.send_goal(Fibonacci.Goal()) as goal:
            async with recording.record(node, tmp_path / "run"):
                pass
            goal.cancel_nowait()
    [found] = await recording.goals(tmp_path / "run")
    assert (found.status, found.ended, found.duration) == (GoalStatus.EXECUTING, 0, None)
    assert found.reason == "its end was not recorded"
    assert found.is_begun_before


def test_a_goal_that_had_ended_before_the_recording_has_no_duration():
    """Its only state came when the recorder subscribed, long after the goal's end."""
    ended = [(9_000_000_000, GoalStatus.SUCCEEDED)]
    goal = RecordedGoal(
        action="/fibonacci", id=bytes(16), stamp=1, states=ended, is_begun_before=True
    )
    assert (goal.status, goal.duration) == (GoalStatus.SUCCEEDED, None)
    goal.is_begun_before = False
    assert goal.duration is not None


async def forever(goal, handle):
    await turtleact.tasks.current_tasks().signal().wait()
    return Fibonacci.Result()


async def test_only_goals_of_chosen_actions_are_listed(tmp_path):
    await recorded(tmp_path / "run", "contents", 1)
    assert len(await recording.goals(tmp_path / "run", actions=["/fibonacci"])) == 1
    assert await recording.goals(tmp_path / "run", actions=["/other"]) == []
