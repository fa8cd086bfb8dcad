"""A client names fields that do not exist, or sends the goal of another action."""

from __future__ import annotations

import turtleact
from turtleact.interfaces.standard import Fibonacci, RotateAbsolute


async def call(node: turtleact.Node) -> None:
    client = node.action_client(Fibonacci, "fibonacci")
    await client.send_goal(Fibonacci.Goal(order="3"))  # error
    await client.send_goal(Fibonacci.Goal(ordre=3))  # error
    await client.send_goal(RotateAbsolute.Goal(theta=1.0))  # error
    result = await client.send_goal(Fibonacci.Goal(order=3))
    print(result.partial_sequence)  # error
