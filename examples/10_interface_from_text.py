# In a checkout: pip install .
"""Your own interface, from the text of a .action file. You can also pass the path of the file.

Prints:

    Goal(seconds=3)
    Feedback(left=2)
    Feedback(left=1)
    Result(words='lift-off')
"""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import turtleact
from turtleact import Message

TEXT = "uint8 seconds 3 # the default\n---\nstring words\n---\nuint8 left"
Countdown: Any = turtleact.load_interface(TEXT, type_name="lab_interfaces/action/Countdown")


@turtleact.action(Countdown, "countdown")
async def countdown(goal: Any) -> AsyncIterator[Message]:
    for left in range(goal.seconds - 1, 0, -1):
        yield Countdown.Feedback(left=left)
    yield Countdown.Result(words="lift-off")


async def main() -> None:
    async with turtleact.open_node("lab") as node:
        node.serve(countdown)
        client = node.action_client(Countdown, "countdown")
        print(Countdown.Goal())
        print(await client.send_goal(Countdown.Goal(), feedback_callback=print))


asyncio.run(main())
