# In a checkout: pip install .
"""If you only need the result, await the goal. Many goals can run side by side.

Prints:

    [0, 1, 1, 2, 3, 5]
    [0, 1] [0, 1, 1] [0, 1, 1, 2]
"""

import asyncio

import turtleact
from turtleact.interfaces.standard import Fibonacci


@turtleact.action(Fibonacci, "fibonacci")
async def fibonacci(goal: Fibonacci.Goal) -> Fibonacci.Result:
    """Returns its result; it has no feedback to give."""
    sequence = [0, 1]
    for i in range(1, goal.order):
        await asyncio.sleep(0.01)
        sequence.append(sequence[i] + sequence[i - 1])
    return Fibonacci.Result(sequence=sequence)


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(fibonacci)
        client = node.action_client(Fibonacci, "fibonacci")

        result = await client.send_goal(Fibonacci.Goal(order=5))
        print(result.sequence)

        async def order(number: int) -> list[int]:
            return (await client.send_goal(Fibonacci.Goal(order=number))).sequence

        print(*await asyncio.gather(order(1), order(2), order(3)))


asyncio.run(main())
