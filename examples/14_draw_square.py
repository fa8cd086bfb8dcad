# In a checkout: pip install .
"""Draws a square: drives each side by topics and turns each corner by an action. From turtlesim.

Prints:

    corner 1: x 7.5, y 5.5
    corner 2: x 7.6, y 7.6
    corner 3: x 5.6, y 7.6
    corner 4: x 5.6, y 5.6
"""

import asyncio
import math

from turtleact import Node, open_world
from turtleact.geometry import distance, wrap_angle
from turtleact.interfaces.standard import RotateAbsolute, TurtlePose, Twist, Vector3

SIDE = 2.0


async def go_ahead(node: Node) -> TurtlePose:
    """Drive until the side is done. Return the pose at its end."""
    poses = node.subscription(TurtlePose, "turtle1/pose")
    twists = node.publisher(Twist, "turtle1/cmd_vel")
    pose = start = await anext(poses)
    while distance(start.x, start.y, pose.x, pose.y) < SIDE:
        twists.publish(Twist(linear=Vector3(x=1.0)))
        pose = await anext(poses)
    twists.publish(Twist())
    await poses.aclose()
    await twists.aclose()
    return pose


async def main() -> None:
    async with open_world(speed="max") as node:
        rotate = node.action_client(RotateAbsolute, "turtle1/rotate_absolute")
        for corner in range(1, 5):
            pose = await go_ahead(node)
            print(f"corner {corner}: x {pose.x:.1f}, y {pose.y:.1f}")
            await rotate.send_goal(RotateAbsolute.Goal(theta=wrap_angle(corner * math.pi / 2)))


asyncio.run(main())
