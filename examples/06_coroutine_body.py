# In a checkout: pip install .
"""The other style of body: a coroutine function that calls ``publish_feedback`` and returns.

Prints:

    EXECUTING [0, 1, 1]
    EXECUTING [0, 1, 1, 2]
    SUCCEEDED [0, 1, 1, 2]
"""

import asyncio

import turtleact
from turtleact import ServerGoalHandle
from turtleact.interfaces.standard import Fibonacci

Handle = ServerGoalHandle[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]


@turtleact.action(Fibonacci, "fibonacci")
async def fibonacci(goal: Fibonacci.Goal, handle: Handle) -> Fibonacci.Result:
    """The second parameter is the goal handle."""
    feedback = Fibonacci.Feedback(partial_sequence=[0, 1])
    for _ in range(1, goal.order):
        feedback.partial_sequence.append(sum(feedback.partial_sequence[-2:]))
        handle.publish_feedback(feedback)  # sends a copy, so the message may be used again
        await asyncio.sleep(0.01)
    return Fibonacci.Result(sequence=feedback.partial_sequence)


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(fibonacci)
        client = node.action_client(Fibonacci, "fibonacci")
        async with client.send_goal(Fibonacci.Goal(order=3)) as goal:
            async for feedback in goal:
                print(goal.status.name, feedback.partial_sequence)
            print(goal.status.name, (await goal.result()).sequence)


asyncio.run(main())
