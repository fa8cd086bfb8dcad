# In a checkout: pip install .
"""One turtle copies another: a second turtle is spawned and gets the first one's speeds.

From turtlesim's mimic.

Prints:

    turtle1 went 2.0 ahead and turned 1.8
    copy went 2.0 ahead and turned 1.8
"""

import asyncio

from turtleact import Node, open_world
from turtleact.interfaces.standard import Spawn, TurtlePose, Twist, Vector3


async def mimic(node: Node, leader: str, follower: str) -> None:
    """Send a turtle the speeds of another, tick by tick."""
    twists = node.publisher(Twist, f"{follower}/cmd_vel")
    async for pose in node.subscription(TurtlePose, f"{leader}/pose"):
        ahead, turning = pose.linear_velocity, pose.angular_velocity
        twists.publish(Twist(linear=Vector3(x=ahead), angular=Vector3(z=turning)))


async def watch(node: Node, turtle: str) -> None:
    """Add up the way and the turn of a turtle until it stands still."""
    way = turn = 0.0
    async for pose in node.subscription(TurtlePose, f"{turtle}/pose"):
        way += pose.linear_velocity * 0.016
        turn += pose.angular_velocity * 0.016
        if way and not pose.linear_velocity:
            break
    print(f"{turtle} went {way:.1f} ahead and turned {turn:.1f}")


async def main() -> None:
    async with open_world(speed="max") as node:
        spawn = node.service_client(Spawn, "spawn")
        await spawn.call(Spawn.Request(x=2.0, y=2.0, theta=1.0, name="copy"))
        mimicking = asyncio.create_task(mimic(node, "turtle1", "copy"))
        twist = Twist(linear=Vector3(x=2.0), angular=Vector3(z=1.8))
        node.publisher(Twist, "turtle1/cmd_vel").publish(twist)
        async with asyncio.TaskGroup() as watching:
            watching.create_task(watch(node, "turtle1"))
            watching.create_task(watch(node, "copy"))
        mimicking.cancel()


asyncio.run(main())
