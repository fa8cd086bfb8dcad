# In a checkout: pip install .
"""A patrol of ten seconds in virtual time: it takes a fraction of that, and always runs the same.

Prints:

    target 1 reached, 16.7 m to go
    target 2 reached, 9.4 m to go
    target 3 reached, 2.2 m to go
    target 4 reached, 0.0 m to go
    4 targets, 21.1 m, 10.7 s
"""

import asyncio

from turtleact import open_world
from turtleact.actions.patrol import Patrol
from turtleact.interfaces.standard import Point

TARGETS = [Point(x=9.0, y=7.0), Point(x=5.0, y=1.0), Point(x=1.0, y=7.0), Point(x=2.0, y=9.0)]


async def main() -> None:
    async with open_world(speed="max") as node:
        client = node.action_client(Patrol, "patrol")
        async with client.send_goal(Patrol.Goal(targets=TARGETS)) as goal:
            async for feedback in goal:
                if feedback.is_reached:
                    left = feedback.distance_remaining
                    print(f"target {feedback.index + 1} reached, {left:.1f} m to go")
            result = await goal.result()
        print(f"{result.reached} targets, {result.distance:.1f} m, {result.duration:.1f} s")


asyncio.run(main())
