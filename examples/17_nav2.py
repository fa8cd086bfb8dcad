# In a checkout: pip install .
"""Drives a robot with Nav2 through poses, and gives up a pose that takes too long.

With the endpoint of a robot's router, such as ``tcp/robot:7447``, it drives that robot, and needs
none of its interface files. Without, a turtle with the same action takes the robot's place.

Prints:

    to 8, 6: 2.5 m to go
    to 8, 6: 0.5 m to go
    to 8, 6: 0.1 m to go
    to 8, 6: SUCCEEDED
    to 2, 2: 7.1 m to go
    to 2, 2: 6.8 m to go
    to 2, 2: 4.8 m to go
    to 2, 2: CANCELED
"""

import asyncio
import sys

import nav2_turtle  # type: ignore[import-not-found]  # it is beside this file

from turtleact import Node, open_node, open_world, open_zenoh

POSES = [(8, 6), (2, 2)]
LIMIT = 2  # seconds for each pose


async def navigate(node: Node) -> None:
    client = node.action_client("navigate_to_pose")
    for x, y in POSES:
        pose = {"header": {"frame_id": "map"}, "pose": {"position": {"x": x, "y": y}}}
        async with client.send_goal({"pose": pose}) as goal:
            async for feedback in goal:
                print(f"to {x}, {y}: {feedback.distance_remaining:.1f} m to go")
                if feedback.navigation_time.sec >= LIMIT:
                    await goal.cancel()
            outcome = await goal.outcome()
        print(f"to {x}, {y}: {outcome.status.name}")


async def main() -> None:
    if len(sys.argv) > 1:
        async with open_zenoh(sys.argv[1:]) as graph, open_node("nav", transport=graph) as node:
            await navigate(node)
    else:
        async with open_world(speed="max") as node:
            node.serve(nav2_turtle.navigate_to_pose)
            await navigate(node)


asyncio.run(main())
