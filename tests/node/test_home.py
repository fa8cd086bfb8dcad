"""What a node has opened says so when it is used in another event loop."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import anyio
import anyio.to_thread
import pytest

import turtleact
from turtleact.errors import TurtleactError
from turtleact.interfaces.standard import Empty, Twist

pytestmark = pytest.mark.loops("asyncio")


class Opened:
    """One of everything."""

    def __init__(self, node: turtleact.Node) -> None:
        self.publisher = node.publisher(Twist, "ticks")
        self.subscription = node.subscription(Twist, "ticks")
        self.client = node.service_client(Empty, "reset")
        self.timer = node.every(1.0)


async def publish(opened: Opened) -> None:
    opened.publisher.publish(Twist())


async def drain(opened: Opened) -> None:
    opened.subscription.drain()


USES: dict[str, tuple[str, Callable[[Opened], Awaitable[Any]]]] = {
    "publish": ("the publisher of topic '/ticks'", publish),
    "anext": ("the subscription of topic '/ticks'", lambda opened: anext(opened.subscription)),
    "drain": ("the subscription of topic '/ticks'", drain),
    "call": (
        "the client of service '/reset'",
        lambda opened: opened.client.call(Empty.Request()),
    ),
    "wait_for_service": (
        "the client of service '/reset'",
        lambda opened: opened.client.wait_for_service(0),
    ),
    "timer": ("the timer", lambda opened: anext(opened.timer)),
}


@pytest.mark.parametrize("use", USES)
async def test_use_in_another_event_loop_says_what_belongs_where(use):
    named, do = USES[use]
    async with turtleact.open_node("lab") as node:
        opened = Opened(node)
        expected = f"{named} belongs to another event loop: .* anyio.from_thread"
        with pytest.raises(TurtleactError, match=expected):
            await anyio.to_thread.run_sync(lambda: anyio.run(do, opened))
        assert opened.subscription.drain() == []
