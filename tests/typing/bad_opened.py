"""What is opened for a block is used without ``async with``."""

from __future__ import annotations

import turtleact


async def use() -> None:
    with turtleact.open_node("lab"):  # error
        pass
    await turtleact.open_node("lab")  # error
    turtleact.open_node("lab").graph()  # error
    with turtleact.open_journal("goals.db"):  # error
        pass
