"""A body gives up, says why, and hands over what it has; a bug in a body ends its goal, not more.

Prints:

    ABORTED out of paper [0, 1, 1]
    the goal was aborted: ZeroDivisionError: integer division or modulo by zero
"""

import asyncio

import turtleact
from turtleact import Abort, GoalAborted
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "fibonacci")
async def fibonacci(goal: Fibonacci.Goal) -> Fibonacci.Result:
    if goal.order == 3:
        raise Abort("out of paper", result=Fibonacci.Result(sequence=[0, 1, 1]))
    return Fibonacci.Result(sequence=[1 // goal.order])


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(fibonacci)
        client = node.action_client(Fibonacci, "fibonacci")
        async with client.send_goal(Fibonacci.Goal(order=3)) as goal:
            outcome = await goal.outcome()  # never raises for a goal that did not succeed
            print(outcome.status.name, outcome.reason, outcome.result.sequence)
        try:
            await client.send_goal(Fibonacci.Goal(order=0))
        except GoalAborted as error:
            print(error)


asyncio.run(main())
