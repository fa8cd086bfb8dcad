# In a checkout: pip install .
"""A body gives up, says why, and returns what it has achieved so far.

Prints:

    ABORTED, out of paper: [0, 1, 1]
    the goal was aborted: out of paper
"""

import asyncio

import turtleact
from turtleact import Abort, GoalAborted
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "fibonacci")
async def fibonacci(goal: Fibonacci.Goal) -> Fibonacci.Result:
    sequence = [0, 1]
    while len(sequence) <= goal.order:
        if len(sequence) == 3:
            raise Abort("out of paper", result=Fibonacci.Result(sequence=sequence))
        sequence.append(sum(sequence[-2:]))
    return Fibonacci.Result(sequence=sequence)


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(fibonacci)
        client = node.action_client(Fibonacci, "fibonacci")
        async with client.send_goal(Fibonacci.Goal(order=5)) as goal:
            outcome = await goal.outcome()  # does not raise if the goal fails
            print(f"{outcome.status.name}, {outcome.reason}: {outcome.result.sequence}")
        try:
            await client.send_goal(Fibonacci.Goal(order=5))
        except GoalAborted as error:
            print(error)


asyncio.run(main())
