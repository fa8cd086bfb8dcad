"""``/fibonacci``: the action of the ROS 2 tutorials.

Source: ROS 2 tutorial "Writing an action server and client (Python)".
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Unpack

from turtleact.errors import Reject
from turtleact.goals.body import ServerOptions, action
from turtleact.goals.state import GoalResponse
from turtleact.interfaces.standard import ExampleFibonacci, Fibonacci

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from turtleact.node import Node, ServerGoalHandle
    from turtleact.node.conflicts import OnConflict

__all__ = ["PACE", "fibonacci", "serve"]

PACE: Final = 1.0
"""Seconds between two numbers, as in the tutorial."""

LARGEST: Final = 46
"""The largest order that is accepted, because Fibonacci number 47 does not fit into an int32."""


def check(goal: Fibonacci.Goal | ExampleFibonacci.Goal) -> GoalResponse:
    """Reject a goal if its sequence has a number that does not fit into an int32."""
    if goal.order > LARGEST:
        raise Reject(f"order {goal.order} is too large: number {LARGEST + 1} does not fit an int32")
    return GoalResponse.ACCEPT


@action(Fibonacci, "/fibonacci", goal_callback=check)
async def fibonacci(
    goal: Fibonacci.Goal,
    handle: ServerGoalHandle[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback],
) -> AsyncIterator[Fibonacci.Feedback | Fibonacci.Result]:
    """Calculate the sequence up to the number with index ``order``, one number per second."""
    left = handle.resumed
    sequence = list(left.feedback.partial_sequence) if left and left.feedback else [0, 1]
    while len(sequence) <= goal.order:
        sequence.append(sequence[-1] + sequence[-2])
        handle.set_partial_result(Fibonacci.Result(sequence=sequence))
        yield Fibonacci.Feedback(partial_sequence=sequence)
        await handle.node.clock.sleep(PACE)
    yield Fibonacci.Result(sequence=sequence)


@action(ExampleFibonacci, "/fibonacci", goal_callback=check)
async def example_fibonacci(
    goal: ExampleFibonacci.Goal,
    handle: ServerGoalHandle[
        ExampleFibonacci.Goal, ExampleFibonacci.Result, ExampleFibonacci.Feedback
    ],
) -> AsyncIterator[ExampleFibonacci.Feedback | ExampleFibonacci.Result]:
    """Calculate the same sequence as `fibonacci`, for the action type of example_interfaces."""
    left = handle.resumed
    sequence = list(left.feedback.sequence) if left and left.feedback else [0, 1]
    while len(sequence) <= goal.order:
        sequence.append(sequence[-1] + sequence[-2])
        handle.set_partial_result(ExampleFibonacci.Result(sequence=sequence))
        yield ExampleFibonacci.Feedback(sequence=sequence)
        await handle.node.clock.sleep(PACE)
    yield ExampleFibonacci.Result(sequence=sequence)


def serve(
    node: Node, *, on_conflict: OnConflict = "refuse", **options: Unpack[ServerOptions]
) -> None:
    """Serve ``/fibonacci`` with each of the two types that ROS 2 has for the action.

    After a restart, a goal from a journal continues where it stopped.

    Args:
        node: The node that serves the action.
        on_conflict: See `Node.action_server`.
        **options: See `Node.action_server`.
    """
    options = {"goal_callback": check, **options}
    node.action_server(
        Fibonacci,
        "/fibonacci",
        fibonacci.execute,
        on_conflict=on_conflict,
        **options,
    )
    node.action_server(
        ExampleFibonacci,
        "/fibonacci",
        example_fibonacci.execute,
        on_conflict=on_conflict,
        **options,
    )
