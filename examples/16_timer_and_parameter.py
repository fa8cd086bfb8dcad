# In a checkout: pip install .
"""A turtle drives at a fixed rate, as fast as a parameter says, which another task changes.

Prints:

    at 0.5 s: 1.0 m/s
    at 1.0 s: 1.0 m/s
    the parameter is now 2.0
    at 1.5 s: 2.0 m/s
    at 2.0 s: 2.0 m/s
    parameter 'speed': it takes 0.0 to 2.0, not 300.0
"""

import asyncio

import turtleact
from turtleact import Node, Parameter
from turtleact.interfaces.standard import Twist, Vector3


async def drive(node: Node, speed: Parameter[float]) -> None:
    """Send a command every half a second."""
    twists = node.publisher(Twist, "turtle1/cmd_vel")
    async for tick in node.every(0.5):
        twists.publish(Twist(linear=Vector3(x=speed.value)))
        print(f"at {tick.elapsed} s: {speed.value} m/s")
        if tick.number == 4:
            break


async def follow(speed: Parameter[float]) -> None:
    """Print each change of the parameter."""
    async for value in speed.changes():
        print(f"the parameter is now {value}")


async def main() -> None:
    async with turtleact.open_world(speed="max") as node, asyncio.TaskGroup() as tasks:
        speed = node.parameter(
            "speed", 1.0, description="How fast to drive (m/s)", range=(0.0, 2.0)
        )
        following = tasks.create_task(follow(speed))
        driving = tasks.create_task(drive(node, speed))
        await node.clock.sleep(1.2)
        speed.value = 2.0  # as `turtleact param set /turtleact speed 2` does
        await driving
        following.cancel()
        try:
            speed.value = 300
        except turtleact.InvalidParameter as error:
            print(error)


asyncio.run(main())
