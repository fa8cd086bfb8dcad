# In a checkout: pip install .
"""A server looks at a goal before it accepts it. If it rejects the goal, it says why.

Prints:

    the goal was rejected: order 100 is too large: 46 is the last that fits an int32
    goal.order: expected a whole number (int32), got 'ten'
"""

import asyncio

import turtleact
from turtleact import GoalRejected, GoalResponse, InvalidGoal, Reject
from turtleact.interfaces.standard import Fibonacci


def check(goal: Fibonacci.Goal) -> GoalResponse:
    """Called once, before the body runs."""
    if goal.order > 46:
        raise Reject(f"order {goal.order} is too large: 46 is the last that fits an int32")
    return GoalResponse.ACCEPT


@turtleact.action(Fibonacci, "fibonacci", goal_callback=check)
async def fibonacci(goal: Fibonacci.Goal) -> Fibonacci.Result:
    return Fibonacci.Result(sequence=list(range(goal.order)))


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(fibonacci)
        client = node.action_client(Fibonacci, "fibonacci")
        for order in (100, "ten"):
            try:
                await client.send_goal(Fibonacci.Goal(order=order))  # type: ignore[arg-type]  # "ten"
            except (GoalRejected, InvalidGoal) as error:
                print(error)


asyncio.run(main())
