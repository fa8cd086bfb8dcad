# In a checkout: pip install .
"""A turtle has two topics: read its pose, send it a twist. One twist lasts about a second.

Prints:

    x 5.54, y 5.54, theta 0.00
    x 6.60, y 6.94, theta 1.81
"""

import asyncio

from turtleact import open_world
from turtleact.interfaces.standard import TurtlePose, Twist, Vector3


def show(pose: TurtlePose) -> None:
    print(f"x {pose.x:.2f}, y {pose.y:.2f}, theta {pose.theta:.2f}")


async def main() -> None:
    async with open_world(speed="max") as node:  # virtual time: as fast as the computer can
        poses = node.subscription(TurtlePose, "turtle1/pose")
        twists = node.publisher(Twist, "turtle1/cmd_vel")
        show(await anext(poses))

        twists.publish(Twist(linear=Vector3(x=2.0), angular=Vector3(z=1.8)))
        async for pose in poses:  # 62.5 poses a second
            if pose.linear_velocity == 0.0:
                break
        show(pose)


asyncio.run(main())
