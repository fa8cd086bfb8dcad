"""A coroutine returns a result of another action."""

from __future__ import annotations

import turtleact
from turtleact.interfaces.standard import Fibonacci, RotateAbsolute


@turtleact.action(Fibonacci, "fibonacci")  # error
async def declared(goal: Fibonacci.Goal) -> RotateAbsolute.Result:
    return RotateAbsolute.Result(delta=goal.order)


async def served(goal: Fibonacci.Goal) -> RotateAbsolute.Result:
    return RotateAbsolute.Result(delta=goal.order)


async def serve(node: turtleact.Node) -> None:
    node.action_server(Fibonacci, "fibonacci", served)  # error
