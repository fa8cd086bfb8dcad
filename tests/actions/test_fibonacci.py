"""``/fibonacci`` under both of its types, at its own pace in virtual time.

The answers to orders -3, 0, 2 and 5 are those of ROS 2 Jazzy, as ``ros2 action`` printed them.
"""

from __future__ import annotations

from contextlib import aclosing, asynccontextmanager

import pytest

from turtleact.actions import fibonacci
from turtleact.errors import GoalRejected
from turtleact.goals.state import GoalStatus
from turtleact.interfaces.standard import ExampleFibonacci, Fibonacci
from turtleact.node import open_node
from turtleact.tasks import Background
from turtleact.tasks.clock import VirtualClock
from turtleact.transports import MemoryTransport

pytestmark = pytest.mark.loops("asyncio", "trio")

TYPES = {"tutorial": (Fibonacci, "partial_sequence"), "example": (ExampleFibonacci, "sequence")}
FIRST_ELEVEN = [0, 1, 1, 2, 3, 5, 8, 13, 21, 34, 55]


@pytest.fixture(params=TYPES)
def kind(request):
    """An action type, and the name of the field of its feedback."""
    return TYPES[request.param]


@asynccontextmanager
async def served(action_type):
    """A client of the action, in virtual time."""
    clock = VirtualClock()
    async with (
        aclosing(Background(clock.run(), "the clock")),
        open_node("lab", transport=MemoryTransport(clock)) as node,
    ):
        fibonacci.serve(node)
        yield node.action_client(action_type, "fibonacci"), clock


async def run(kind, order):
    """The feedback, each with its time, the result, and the time of that."""
    action_type, field = kind
    request = action_type.Goal(order=order)
    async with served(action_type) as (client, clock), client.send_goal(request) as goal:
        told = [(clock.time(), getattr(feedback, field)) async for feedback in goal]
        return told, (await goal.result()).sequence, clock.time()


@pytest.mark.parametrize("order", [-3, 0, 1])  # as the real server answers them
async def test_the_first_two_numbers_come_at_once_and_without_feedback(kind, order):
    assert await run(kind, order) == ([], [0, 1], 0.0)


async def test_order_5_gives_the_feedback_of_the_real_server(kind):
    told, sequence, _ = await run(kind, 5)
    assert [partial for _, partial in told] == [
        [0, 1, 1],
        [0, 1, 1, 2],
        [0, 1, 1, 2, 3],
        [0, 1, 1, 2, 3, 5],
    ]
    assert sequence == [0, 1, 1, 2, 3, 5]


async def test_a_number_comes_every_second(kind):
    told, _, end = await run(kind, 10)
    assert [time for time, _ in told] == [float(second) for second in range(9)]
    assert end == 9.0


async def test_the_largest_order_is_the_last_that_an_int32_holds(kind):
    _, sequence, _ = await run(kind, 46)
    assert (len(sequence), sequence[-1]) == (47, 1836311903)


@pytest.mark.parametrize("order", [47, 2**31 - 1])
async def test_a_larger_order_is_rejected(kind, order):
    async with served(kind[0]) as (client, _):
        with pytest.raises(GoalRejected) as caught:
            await client.send_goal(kind[0].Goal(order=order))
    assert caught.value.reason == f"order {order} is too large: number 47 does not fit an int32"


async def test_a_canceled_goal_tells_the_numbers_so_far(kind):
    request = kind[0].Goal(order=10)
    async with served(kind[0]) as (client, clock), client.send_goal(request) as goal:
        await clock.sleep(2.5)
        await goal.cancel()
        outcome = await goal.outcome()
        assert clock.time() == 2.5
    assert (outcome.status, outcome.result.sequence) == (GoalStatus.CANCELED, [0, 1, 1, 2, 3])


async def test_several_goals_run_side_by_side(kind):
    async with (
        served(kind[0]) as (client, clock),
        client.send_goal(kind[0].Goal(order=4)) as one,
        client.send_goal(kind[0].Goal(order=5)) as two,
    ):
        results = [(await one.result()).sequence, (await two.result()).sequence]
        assert clock.time() == 4.0
    assert results == [FIRST_ELEVEN[:5], FIRST_ELEVEN[:6]]
