"""A parameter gets a value of another kind, a default of none, or a range that is none."""

from __future__ import annotations

import turtleact


async def configure(node: turtleact.Node) -> None:
    count = node.parameter("count", 3)
    count.value = "three"  # error
    node.parameter("place", {"x": 1.0})  # error
    node.parameter("speed", 1.0, range=(0.0,))  # error
