"""A body takes the goal of another action."""

from __future__ import annotations

from collections.abc import AsyncIterator

import turtleact
from turtleact.interfaces.standard import Fibonacci, RotateAbsolute

Word = Fibonacci.Feedback | Fibonacci.Result


@turtleact.action(Fibonacci, "fibonacci")  # error
async def declared(
    goal: RotateAbsolute.Goal,
) -> AsyncIterator[Word]:
    yield Fibonacci.Result(sequence=[int(goal.theta)])


async def served(goal: RotateAbsolute.Goal) -> AsyncIterator[Word]:
    yield Fibonacci.Result(sequence=[int(goal.theta)])


async def serve(node: turtleact.Node) -> None:
    node.action_server(Fibonacci, "fibonacci", served)  # error
