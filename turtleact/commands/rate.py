"""``topic hz``, ``bw`` and ``delay``: how many messages of a topic come, how large and how old.

``hz`` and ``delay`` tell each second of a topic that has fallen silent, all three of its last
publisher when it goes.

Source: ros2cli ``ros2topic/verb/{hz,bw,delay}.py`` for what is measured, and for the words; ``hz``
of ROS 2 says nothing of a silent topic, that of ROS 1 what ``delay`` says.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Protocol

import anyio

from turtleact.commands.echo import note_absence
from turtleact.commands.graph import chosen_class, names_like, say_names
from turtleact.commands.kinds import types_by_name
from turtleact.commands.stderr import note
from turtleact.commands.transcript import say
from turtleact.errors import TurtleactError
from turtleact.interfaces import Message, encode
from turtleact.interfaces.stamps import nanoseconds
from turtleact.interfaces.types import fields
from turtleact.names import resolve_name
from turtleact.transports import QoS

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["Bandwidth", "Delay", "Meter", "Rate", "measure"]

PERIOD = 1.0
"""Seconds from line to line, by the clock of the graph."""

DEPTH = 100_000
"""Messages that are kept while the output is stuck."""

SILENT = "no new messages\n"
"""What is told of a topic that has had messages."""


class Meter(Protocol):
    """What is measured of the messages of a topic."""

    def begin(self, name: str, message_type: type[Message]) -> str:
        """What is told before the first message; raises if there is nothing to measure."""

    def add(self, now: int, message: Message) -> None:
        """Note that a message came at this time (ns)."""

    def line(self, now: int) -> str:
        """What there is to be told at this time (ns); empty if there is nothing."""


class Rate:
    """The times between messages.

    Args:
        window: How many of them are looked at, the newest.
    """

    def __init__(self, window: int) -> None:
        self._between: deque[int] = deque(maxlen=window)
        self._last: int | None = None
        self._is_news = False

    def begin(self, name: str, message_type: type[Message]) -> str:  # noqa: ARG002  # of any type
        """Nothing is told before."""
        return ""

    def add(self, now: int, message: Message) -> None:  # noqa: ARG002  # only its coming counts
        """Note that a message came at this time (ns); time that goes back begins anew."""
        if self._last is not None and now < self._last:
            self._between.clear()
        elif self._last is not None:
            self._between.append(now - self._last)
            self._is_news = True
        self._last = now

    def line(self, now: int) -> str:  # noqa: ARG002  # only the times between messages count
        """What there is to be told; empty before the second message."""
        if not self._between:
            return ""
        if not self._is_news:
            return SILENT
        self._is_news = False
        seconds = [each * 1e-9 for each in self._between]
        mean = math.fsum(seconds) / len(seconds)
        rate = 1 / mean if mean else 0.0
        return f"average rate: {rate:.3f}\n{_spread(seconds)}"


class Bandwidth:
    """How many bytes of messages come a second, as CDR.

    Args:
        window: How many messages are looked at, the newest.
    """

    def __init__(self, window: int) -> None:
        self._came: deque[tuple[int, int]] = deque(maxlen=window)

    def begin(self, name: str, message_type: type[Message]) -> str:  # noqa: ARG002  # of any type
        """As ros2 says it."""
        return f"Subscribed to [{name}]\n"

    def add(self, now: int, message: Message) -> None:
        """Note how large a message is; time that goes back begins anew."""
        if self._came and now < self._came[-1][0]:
            self._came.clear()
        self._came.append((now, len(encode(message))))

    def line(self, now: int) -> str:
        """From the first message of the window up to now; empty before the second one."""
        if len(self._came) < 2 or now <= self._came[0][0]:
            return ""
        sizes = [size for _, size in self._came]
        each_second = sum(sizes) / ((now - self._came[0][0]) * 1e-9)
        mean = sum(sizes) / len(sizes)
        rate, *said = _sizes(each_second, mean, min(sizes), max(sizes))
        return (
            f"{rate}/s from {len(sizes)} messages\n"
            f"\tMessage size mean: {said[0]} min: {said[1]} max: {said[2]}\n"
        )


class Delay:
    """How old messages are when they come, by the stamp in their header.

    Args:
        window: How many messages are looked at, the newest.
    """

    def __init__(self, window: int) -> None:
        self._delays: deque[int] = deque(maxlen=window)
        self._is_news = False

    def begin(self, name: str, message_type: type[Message]) -> str:
        """Nothing is told before.

        Raises:
            TurtleactError: if the messages have no header.
        """
        kinds = {field.name: field.type.name for field in fields(message_type)}
        if kinds.get("header") != "std_msgs/msg/Header":
            problem = f"messages of type {message_type.type_name} have no header"
            raise TurtleactError(f"topic '{name}': {problem}, which says when they were made")
        return ""

    def add(self, now: int, message: Message) -> None:
        """Note how old a message is."""
        stamp = message.header.stamp  # type: ignore[attr-defined]  # as `begin` has seen
        self._delays.append(now - nanoseconds(stamp))
        self._is_news = True

    def line(self, now: int) -> str:  # noqa: ARG002  # how old they were then is what counts
        """What there is to be told; empty before the first message."""
        if not self._delays:
            return ""
        if not self._is_news:
            return SILENT
        self._is_news = False
        seconds = [each * 1e-9 for each in self._delays]
        return f"average delay: {math.fsum(seconds) / len(seconds):.3f}\n{_spread(seconds)}"


async def measure(node: Node, name: str, meter: Meter) -> int:
    """Print what is measured of a topic each second, once it is there; ends with the node.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the topic's type is not known.
    """
    full_name = resolve_name(name)
    await _wait_for_topic(node, full_name)
    message_type = chosen_class(node, "topic", Message, full_name, None)
    say_names(meter.begin(full_name, message_type))
    async with anyio.create_task_group() as beside:
        beside.start_soon(note_absence, node, full_name)
        beside.start_soon(_print, meter, node)
        async for message in node.subscription(message_type, full_name, QoS(depth=DEPTH)):
            meter.add(node.clock.now(), message)
        beside.cancel_scope.cancel()
    return 0


async def _print(meter: Meter, node: Node) -> None:
    while True:
        await node.clock.sleep(PERIOD)
        say(meter.line(node.clock.now()))


async def _wait_for_topic(node: Node, name: str) -> None:
    found = types_by_name(node.transport.endpoints(), "topic", hidden=True)
    if name not in found:
        hint = names_like(name, [each for each in found if "/_" not in each])
        note(f"topic '{name}' is not there yet{hint}; waiting for it")
    while name not in types_by_name(node.transport.endpoints(), "topic", hidden=True):
        await node.transport.wait_for_change()


def _spread(seconds: list[float]) -> str:
    """The line on how much times differ."""
    mean = math.fsum(seconds) / len(seconds)
    deviation = math.sqrt(math.fsum((each - mean) ** 2 for each in seconds) / len(seconds))
    return (
        f"\tmin: {min(seconds):.3f}s max: {max(seconds):.3f}s "
        f"std dev: {deviation:.5f}s window: {len(seconds)}\n"
    )


def _sizes(first: float, *more: float) -> list[str]:
    """Numbers of bytes, all in the unit that suits the first."""
    if first < 1000:
        return [f"{each:.0f} B" for each in (first, *more)]
    unit, size = ("KB", 1e3) if first < 1e6 else ("MB", 1e6)
    return [f"{each / size:.2f} {unit}" for each in (first, *more)]
