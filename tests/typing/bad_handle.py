"""A body publishes feedback of another action, or asks for the handle of another action."""

from __future__ import annotations

import turtleact
from turtleact import ServerGoalHandle
from turtleact.interfaces.standard import Fibonacci, RotateAbsolute


async def publishing(
    goal: Fibonacci.Goal,
    handle: ServerGoalHandle[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback],
) -> Fibonacci.Result:
    handle.publish_feedback(RotateAbsolute.Feedback(remaining=goal.order))  # error
    return Fibonacci.Result()


async def of_another_action(
    goal: Fibonacci.Goal,
    handle: ServerGoalHandle[Fibonacci.Goal, Fibonacci.Result, RotateAbsolute.Feedback],
) -> Fibonacci.Result:
    handle.publish_feedback(RotateAbsolute.Feedback(remaining=goal.order))
    return Fibonacci.Result()


async def serve(node: turtleact.Node) -> None:
    node.action_server(Fibonacci, "fibonacci", of_another_action)  # error
