# In a checkout: pip install .
"""A server and a client in one process: send a goal, read its feedback, then its result.

Prints:

    [0, 1, 1]
    [0, 1, 1, 2]
    [0, 1, 1, 2, 3]
    result: [0, 1, 1, 2, 3]
"""

import asyncio
from collections.abc import AsyncIterator

import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "fibonacci")
async def fibonacci(goal: Fibonacci.Goal) -> AsyncIterator[Fibonacci.Feedback | Fibonacci.Result]:
    """Yields feedback as often as it likes, and the result last."""
    sequence = [0, 1]
    for i in range(1, goal.order):
        sequence.append(sequence[i] + sequence[i - 1])
        yield Fibonacci.Feedback(partial_sequence=sequence)
        await asyncio.sleep(0.01)
    yield Fibonacci.Result(sequence=sequence)


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(fibonacci)
        client = node.action_client(Fibonacci, "fibonacci")
        async with client.send_goal(Fibonacci.Goal(order=4)) as goal:
            async for feedback in goal:
                print(feedback.partial_sequence)
            print("result:", (await goal.result()).sequence)


asyncio.run(main())
