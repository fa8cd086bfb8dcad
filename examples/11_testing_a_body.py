# In a checkout: pip install .
"""A declared body is still a plain function, so you can test it without a server.

Prints:

    Feedback(partial_sequence=[0, 1, 1])
    Feedback(partial_sequence=[0, 1, 1, 2])
    Result(sequence=[0, 1, 1, 2])
"""

import asyncio
from collections.abc import AsyncIterator

import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "fibonacci")
async def fibonacci(goal: Fibonacci.Goal) -> AsyncIterator[Fibonacci.Feedback | Fibonacci.Result]:
    sequence = [0, 1]
    for i in range(1, goal.order):
        sequence.append(sequence[i] + sequence[i - 1])
        yield Fibonacci.Feedback(partial_sequence=list(sequence))
    yield Fibonacci.Result(sequence=sequence)


async def test_the_result_comes_last() -> None:
    said = [word async for word in fibonacci(Fibonacci.Goal(order=3))]
    print(*said, sep="\n")
    if said[-1] != Fibonacci.Result(sequence=[0, 1, 1, 2]):
        raise AssertionError


asyncio.run(test_the_result_comes_last())
