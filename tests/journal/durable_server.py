"""A program that serves ``/count`` with a journal until it is killed; see `test_reattaching`."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator

import anyio

import turtleact
from tests.lab import Count
from turtleact import ServerGoalHandle


async def count(
    goal: Count.Goal, handle: ServerGoalHandle[Count.Goal, Count.Result, Count.Feedback]
) -> AsyncIterator[Count.Feedback | Count.Result]:
    """Count on from the newest feedback."""
    left = handle.resumed
    numbers = [] if left is None or left.feedback is None else list(left.feedback.so_far)
    for number in range(len(numbers), goal.upto):
        await anyio.sleep(0.01)
        numbers.append(number)
        yield Count.Feedback(so_far=numbers)
    yield Count.Result(counted=numbers)


async def main(address: str, path: str) -> None:
    """Serve on that address with that journal."""
    async with (
        turtleact.open_journal(path) as journal,
        turtleact.open_zenoh([], mode="router", listen=[address]) as transport,
        turtleact.open_node("durable", transport=transport) as node,
    ):
        node.action_server(Count, "count", count, journal=journal, on_restart="resume")
        await transport.flush()
        print("ready", flush=True)
        await anyio.sleep_forever()


if __name__ == "__main__":
    anyio.run(main, sys.argv[1], sys.argv[2])
