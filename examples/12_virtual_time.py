# In a checkout: pip install . trio
"""A test in virtual time: an hour of sleep takes a few milliseconds, on asyncio and on trio.

Prints:

    asyncio: [30, 60, 90], SUCCEEDED after 90 minutes
    asyncio: [30], CANCELED after 45 minutes
    trio: [30, 60, 90], SUCCEEDED after 90 minutes
    trio: [30], CANCELED after 45 minutes
"""

from collections.abc import AsyncIterator

import anyio

import turtleact
from turtleact import Action, Message, testing
from turtleact.interfaces import int32


class Bake(Action, type_name="kitchen_interfaces/action/Bake"):
    class Goal(Message):
        minutes: int32 = 0

    class Result(Message):
        minutes: int32 = 0

    class Feedback(Message):
        minutes: int32 = 0


@turtleact.action(Bake, "bake")
async def bake(goal: Bake.Goal) -> AsyncIterator[Bake.Feedback | Bake.Result]:
    """Looks into the oven every half hour."""
    for minutes in range(30, goal.minutes + 1, 30):
        await anyio.sleep(30 * 60)
        yield Bake.Feedback(minutes=minutes)
    yield Bake.Result(minutes=goal.minutes)


async def bake_for(minutes: int, patience: float) -> str:
    """Sends a goal, and cancels it after some minutes of patience."""
    async with turtleact.open_node("kitchen") as node:
        node.serve(bake)
        client = node.action_client(Bake, "bake")
        begun = node.clock.time()
        async with client.send_goal(Bake.Goal(minutes=minutes)) as goal:
            seen = []
            with anyio.move_on_after(patience * 60) as scope:
                async for feedback in goal:
                    seen.append(feedback.minutes)
            if scope.cancelled_caught:
                await goal.cancel()
            outcome = await goal.outcome()
        took = (node.clock.time() - begun) / 60
        return f"{seen}, {outcome.status.name} after {took:g} minutes"


for backend in ("asyncio", "trio"):
    for patience in (120, 45):
        print(f"{backend}: {testing.run(bake_for, 90, patience, backend=backend)}")
