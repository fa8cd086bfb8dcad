"""A generator yields a result of another action."""

from __future__ import annotations

from collections.abc import AsyncIterator

import turtleact
from turtleact.interfaces.standard import Fibonacci, RotateAbsolute

Word = Fibonacci.Feedback | RotateAbsolute.Result


@turtleact.action(Fibonacci, "fibonacci")  # error
async def declared(
    goal: Fibonacci.Goal,
) -> AsyncIterator[Word]:
    yield RotateAbsolute.Result(delta=goal.order)


async def served(goal: Fibonacci.Goal) -> AsyncIterator[Word]:
    yield RotateAbsolute.Result(delta=goal.order)


async def serve(node: turtleact.Node) -> None:
    node.action_server(Fibonacci, "fibonacci", served)  # error
