"""``topic hz``: how many messages of a topic come a second.

Source: ros2cli ``ros2topic/verb/hz.py`` for what is measured; recordings of Jazzy for the words.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import anyio

from turtleact.commands.graph import chosen_class, names_like, types_by_name
from turtleact.commands.stderr import note
from turtleact.commands.transcript import say
from turtleact.interfaces import Message
from turtleact.names import resolve_name
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["Rate", "measure"]

PERIOD = 1.0
"""Seconds from line to line, by the clock of the graph."""

DEPTH = 100_000
"""Messages that are kept while the output is stuck; of each only the coming counts."""


class Rate:
    """The times between messages.

    Args:
        window: How many of them are looked at, the newest.
    """

    def __init__(self, window: int) -> None:
        self._between: deque[int] = deque(maxlen=window)
        self._last: int | None = None
        self._is_news = False

    def add(self, now: int) -> None:
        """Note that a message came at this time (ns); time that goes back begins anew."""
        if self._last is not None and now < self._last:
            self._between.clear()
        elif self._last is not None:
            self._between.append(now - self._last)
            self._is_news = True
        self._last = now

    def line(self) -> str:
        """What there is to be told; empty if no message has come since the last time."""
        if not self._is_news or not self._between:
            return ""
        self._is_news = False
        seconds = [each * 1e-9 for each in self._between]
        mean = math.fsum(seconds) / len(seconds)
        rate = 1 / mean if mean else 0.0
        deviation = math.sqrt(math.fsum((each - mean) ** 2 for each in seconds) / len(seconds))
        return (
            f"average rate: {rate:.3f}\n"
            f"\tmin: {min(seconds):.3f}s max: {max(seconds):.3f}s "
            f"std dev: {deviation:.5f}s window: {len(seconds)}\n"
        )


async def measure(node: Node, name: str, window: int) -> int:
    """Print the rate of a topic each second, once the topic is there; ends with the node.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the topic's type is not known.
    """
    full_name = resolve_name(name)
    await _wait_for_topic(node, full_name)
    message_type = chosen_class(node, "topic", Message, full_name, None)
    rate = Rate(window)
    async with anyio.create_task_group() as beside:
        beside.start_soon(_print, rate, node)
        async for _ in node.subscription(message_type, full_name, QoS(depth=DEPTH)):
            rate.add(node.clock.now())
        beside.cancel_scope.cancel()
    return 0


async def _print(rate: Rate, node: Node) -> None:
    while True:
        await node.clock.sleep(PERIOD)
        say(rate.line())


async def _wait_for_topic(node: Node, name: str) -> None:
    found = types_by_name(node.transport.endpoints(), "topic", hidden=True)
    if name not in found:
        hint = names_like(name, [each for each in found if "/_" not in each])
        note(f"topic '{name}' is not there yet{hint}; waiting for it")
    while name not in types_by_name(node.transport.endpoints(), "topic", hidden=True):
        await node.transport.wait_for_change()
