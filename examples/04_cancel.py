# In a checkout: pip install .
"""A cancel reaches the body as Python's own cancellation: its ``finally`` runs and is awaited.

Prints:

    motors on
    motors off
    CANCELED [0, 1, 1]
"""

import asyncio

import turtleact
from turtleact import ServerGoalHandle
from turtleact.interfaces.standard import Fibonacci

Handle = ServerGoalHandle[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]


@turtleact.action(Fibonacci, "fibonacci")
async def fibonacci(goal: Fibonacci.Goal, handle: Handle) -> Fibonacci.Result:
    print("motors on")
    try:
        handle.set_partial_result(Fibonacci.Result(sequence=[0, 1, 1]))
        await asyncio.sleep(goal.order)
    finally:
        print("motors off")
    return Fibonacci.Result()


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(fibonacci)
        client = node.action_client(Fibonacci, "fibonacci")
        async with client.send_goal(Fibonacci.Goal(order=3600)) as goal:
            await goal.cancel()
            outcome = await goal.outcome()
            print(outcome.status.name, outcome.result.sequence)


asyncio.run(main())
