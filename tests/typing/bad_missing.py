"""A coroutine returns no result."""

from __future__ import annotations

import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "fibonacci")  # error
async def declared(goal: Fibonacci.Goal) -> None:
    print(goal.order)


async def served(goal: Fibonacci.Goal) -> None:
    print(goal.order)


async def serve(node: turtleact.Node) -> None:
    node.action_server(Fibonacci, "fibonacci", served)  # error
