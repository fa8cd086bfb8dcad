# In a checkout: pip install .
"""A callback receives each feedback message while you await the result.

Prints:

    heard [0, 1, 1]
    heard [0, 1, 1, 2]
    result [0, 1, 1, 2]
"""

import asyncio
from collections.abc import AsyncIterator

import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "fibonacci")
async def fibonacci(goal: Fibonacci.Goal) -> AsyncIterator[Fibonacci.Feedback | Fibonacci.Result]:
    """The yielded list grows later. Each reader has a copy from the time of the ``yield``."""
    sequence = [0, 1]
    for i in range(1, goal.order):
        sequence.append(sequence[i] + sequence[i - 1])
        yield Fibonacci.Feedback(partial_sequence=sequence)
    yield Fibonacci.Result(sequence=sequence)


def hear(feedback: Fibonacci.Feedback) -> None:
    print("heard", feedback.partial_sequence)


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(fibonacci)
        client = node.action_client(Fibonacci, "fibonacci")
        result = await client.send_goal(Fibonacci.Goal(order=3), feedback_callback=hear)
        print("result", result.sequence)


asyncio.run(main())
