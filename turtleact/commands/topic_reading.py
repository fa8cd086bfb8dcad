"""Implements ``topic echo``, ``hz``, ``bw`` and ``delay``, which print or measure messages.

``echo`` prints messages. ``hz`` prints how many messages arrive per second, ``bw`` prints how many
bytes arrive per second, and ``delay`` prints the age of messages at their arrival. While no
messages arrive, ``hz`` and ``delay`` say so each second, as in ROS 1. All four verbs print a note
when the topic's last publisher has gone.

Source: ros2cli ``ros2topic/verb/{echo,hz,bw,delay}.py``; recordings of ROS 2 Jazzy for the wording
of the output.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple, Protocol

import anyio

from turtleact.commands.graph import chosen_class, note_differing
from turtleact.commands.message_text import Style
from turtleact.commands.output import note, say, say_message, say_names
from turtleact.errors import TurtleactError, UsageError
from turtleact.interfaces import Message, encode, nanoseconds, type_hash
from turtleact.interfaces.definition import did_you_mean, names_like
from turtleact.interfaces.types import fields, nested_classes
from turtleact.names import resolve_name
from turtleact.tasks.clock import within
from turtleact.tasks.failures import summary
from turtleact.transports import QoS
from turtleact.transports.graph import types_by_name

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import CodeType

    from turtleact.commands.settings import Durability, Policies
    from turtleact.node import Node
    from turtleact.node.topics import Subscription

__all__ = ["Bandwidth", "Delay", "Meter", "Order", "Rate", "echo", "measure", "note_absence"]

ECHO_DEPTH = 1000
"""How many messages ``echo`` keeps while the output is stuck."""

LONGEST = 300
"""An error that contains a message is cut after this many characters."""

DONE, TIMEOUT = 0, 124
"""Exit statuses."""


ABSENCE = 1.0
"""How long to wait for a publisher before a note says that the topic has none (s, graph clock)."""


class Order(NamedTuple):
    """The topic to read, and how to print its messages.

    Attributes:
        name: The topic's name.
        type_name: The name of the topic's type; None to look it up on the graph.
        path: The names of the fields that lead to the field to print, the outermost first; empty to
            print the whole message.
        once: Whether to exit after the first message.
        style: The format in which messages are printed.
        timeout: After how long to exit (s, by the clock of the graph); None for no limit.
        wanted: The user's filter: a Python expression in which ``m`` is the message or the field to
            print. Only messages for which it is true are printed. None to print all messages.
        raw: Whether to print messages as CDR bytes.
        policies: The quality of service to request.
    """

    name: str
    type_name: str | None
    path: tuple[str, ...]
    once: bool
    style: Style
    timeout: float | None
    wanted: CodeType | None
    raw: bool
    policies: Policies


async def echo(node: Node, order: Order) -> int:
    """Print the messages of a topic, and return the exit status.

    This function returns when the node is closed, when ``order.timeout`` has passed, or, with
    ``order.once``, after the first message.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the topic's type is unknown, or if the type of every publisher differs
            from ``order.type_name``.
        UsageError: if the messages have no field at ``order.path``, or if the user's filter raises
            an exception.
    """
    name = resolve_name(order.name)
    message_type = await chosen_class(node, "topic", Message, name, order.type_name)
    _check_type(node, name, message_type)
    _check_path(message_type, order.path)
    qos = order.policies.qos(durability=_durability(node, name), depth=ECHO_DEPTH)
    subscription = node.subscription(message_type, name, qos)
    endpoints = node.transport.endpoints()
    publishers = [each for each in endpoints if each.kind == "publisher" and each.name == name]
    note_differing(node, publishers, {message_type.type_name: type_hash(message_type)})
    async with anyio.create_task_group() as beside:
        beside.start_soon(note_absence, node, name)
        status = await _print(node, subscription, message_type, order)
        beside.cancel_scope.cancel()
    return status


async def note_absence(node: Node, name: str) -> None:
    """Print a note each time a topic has lost its last publisher. Run until cancelled."""
    while True:
        await _wait_for_publishers(node, name)
        # No change is lost between the count and the wait: there is no await in between.
        while node.count_publishers(name):
            await node.transport.wait_for_change()
        async with within(ABSENCE, node.clock):  # each message may come from a publisher of its own
            await _wait_for_publishers(node, name)
            continue
        note(f"nobody publishes topic '{name}' any more; waiting for a new publisher")


async def _wait_for_publishers(node: Node, name: str) -> None:
    while not node.count_publishers(name):
        await node.transport.wait_for_change()


async def _print(
    node: Node, subscription: Subscription[Message], message_type: type[Message], order: Order
) -> int:
    """Print the messages that the order asks for, and return the exit status."""
    count = missed = 0
    async with within(order.timeout, node.clock):
        async for message in subscription:
            missed = _note_missed(subscription, missed)
            if order.wanted is not None and not _is_wanted(message, order.wanted, order.path):
                continue
            text = _text(message, order)
            say_message(text)
            count += 1
            if order.once:
                return DONE
    if not count:
        _check_type(node, subscription.topic, message_type)
        note(f"no message on topic '{subscription.topic}' within {order.timeout:g} s")
    return DONE if count else TIMEOUT


def _durability(node: Node, name: str) -> Durability:
    """Choose the durability to request: ``transient_local`` if a publisher offers it."""
    endpoints = node.transport.endpoints()
    publishers = [each for each in endpoints if each.kind == "publisher" and each.name == name]
    is_latched = any(each.qos.durability == "transient_local" for each in publishers)
    return "transient_local" if is_latched else "volatile"


def _check_type(node: Node, name: str, message_type: type[Message]) -> None:
    """Raise an error if the topic has publishers, but none of this type."""
    endpoints = node.transport.endpoints()
    types = types_by_name(endpoints, "topic", "publisher", hidden=True).get(name, ())
    others = [each for each in types if each != message_type.type_name]
    if others and len(others) == len(types):
        problem = f"it is of type {' and '.join(others)}, not {message_type.type_name}"
        raise TurtleactError(f"topic '{name}': {problem}; leave out the type or correct it")


def _is_wanted(message: Message, wanted: CodeType, path: Sequence[str]) -> bool:
    """Whether the user's filter is true for a message, or for the field at ``path``."""
    value: object = message
    for name in path:
        value = getattr(value, name)
    try:
        return bool(eval(wanted, {"m": value}))  # noqa: S307  # the user's own program
    except Exception as error:
        raise UsageError(f"--filter: {summary(error)}; m is {value!r}"[:LONGEST]) from None


def _check_path(message_type: type[Message], path: Sequence[str]) -> None:
    """Raise an error if messages of this type have no field at ``path``."""
    cls: type[Message] | None = message_type
    for depth, name in enumerate(path):
        where = ".".join(path[: depth + 1])
        if cls is None:
            raise UsageError(f"--field {where}: '{path[depth - 1]}' is not a single message")
        nested = dict(zip(fields(cls), nested_classes(cls), strict=True))
        found = next((field for field in nested if field.name == name), None)
        if found is None:
            known = [field.name for field in nested]
            hint = did_you_mean(name, known) or f": the fields are {', '.join(known)}"
            raise UsageError(f"--field {where}: {cls.type_name} has no field '{name}'{hint}")
        cls = None if found.type.is_sequence else nested[found]


def _note_missed(subscription: Subscription[Message], noted: int) -> int:
    """Print a note if more than ``noted`` messages were lost so far. Return how many were lost."""
    if subscription.missed > noted:
        note(f"{subscription.missed - noted} messages were lost: they came too fast")
    return subscription.missed


def _text(message: Message, order: Order) -> str:
    """The text to print for a message."""
    if order.raw:
        return f"{encode(message)!r}\n---\n"
    value: object = order.style.values(message)
    for name in order.path:
        value = value[name]  # type: ignore[index]  # a mapping, as `_check_path` has seen
    return order.style.text(value)


PERIOD = 1.0
"""The time between two lines (s, by the clock of the graph)."""

METER_DEPTH = 100_000
"""How many messages a meter keeps while the output is stuck."""

SILENT = "no new messages\n"
"""The text that is printed when a topic falls silent."""


class Meter(Protocol):
    """Measures the messages of a topic."""

    def begin(self, name: str, message_type: type[Message]) -> str:
        """Return the heading to print, which may be empty.

        Raise an error if messages of this type cannot be measured.
        """

    def add(self, now: int, message: Message) -> None:
        """Add a message that arrived at the time ``now`` (ns)."""

    def line(self, now: int) -> str:
        """Return the line to print at the time ``now`` (ns); empty if there is nothing to print."""


class Rate:
    """Measures the intervals between messages, and how many messages arrive per second.

    Args:
        window: How many of the latest intervals to keep.
    """

    def __init__(self, window: int) -> None:
        self._between: deque[int] = deque(maxlen=window)
        self._last: int | None = None
        self._is_news = False

    def begin(self, name: str, message_type: type[Message]) -> str:  # noqa: ARG002  # of any type
        """Return "", because ``hz`` prints no heading."""
        return ""

    def add(self, now: int, message: Message) -> None:  # noqa: ARG002  # only its arrival counts
        """Add a message that arrived at the time ``now`` (ns).

        If the clock has gone back, forget all earlier messages.
        """
        if self._last is not None and now < self._last:
            self._between.clear()
        elif self._last is not None:
            self._between.append(now - self._last)
            self._is_news = True
        self._last = now

    def line(self, now: int) -> str:  # noqa: ARG002  # only the times between messages count
        """The rate, or a note if no message has arrived since the last line.

        Empty before the second message.
        """
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
    """Measures how many bytes of messages arrive per second, with each message encoded as CDR.

    Args:
        window: How many of the latest messages to keep.
    """

    def __init__(self, window: int) -> None:
        self._came: deque[tuple[int, int]] = deque(maxlen=window)

    def begin(self, name: str, message_type: type[Message]) -> str:  # noqa: ARG002  # of any type
        """Return the same heading as ``ros2 topic bw``."""
        return f"Subscribed to [{name}]\n"

    def add(self, now: int, message: Message) -> None:
        """Add the size of a message. If the clock has gone back, forget all earlier messages."""
        if self._came and now < self._came[-1][0]:
            self._came.clear()
        self._came.append((now, len(encode(message))))

    def line(self, now: int) -> str:
        """The bandwidth since the oldest kept message; empty before the second message."""
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
    """Measures the age of messages at their arrival, by the stamp in their header.

    Args:
        window: How many of the latest messages to keep.
    """

    def __init__(self, window: int) -> None:
        self._delays: deque[int] = deque(maxlen=window)
        self._is_news = False

    def begin(self, name: str, message_type: type[Message]) -> str:
        """Return "", because ``delay`` prints no heading.

        Raises:
            TurtleactError: if the messages have no header.
        """
        kinds = {field.name: field.type.name for field in fields(message_type)}
        if kinds.get("header") != "std_msgs/msg/Header":
            problem = f"messages of type {message_type.type_name} have no header"
            raise TurtleactError(f"topic '{name}': {problem}, so their age is unknown")
        return ""

    def add(self, now: int, message: Message) -> None:
        """Add the age of a message."""
        stamp = message.header.stamp  # type: ignore[attr-defined]  # `begin` has checked it
        self._delays.append(now - nanoseconds(stamp))
        self._is_news = True

    def line(self, now: int) -> str:  # noqa: ARG002  # the age on arrival counts
        """Return the mean age of messages, or a note if no message has arrived since the last call.

        The text is empty before the first message.
        """
        if not self._delays:
            return ""
        if not self._is_news:
            return SILENT
        self._is_news = False
        seconds = [each * 1e-9 for each in self._delays]
        return f"average delay: {math.fsum(seconds) / len(seconds):.3f}\n{_spread(seconds)}"


async def measure(node: Node, name: str, meter: Meter) -> int:
    """Print the measurements of a topic each second, until the node is closed.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the topic's type is not known.
    """
    full_name = resolve_name(name)
    await _wait_for_topic(node, full_name)
    message_type = await chosen_class(node, "topic", Message, full_name, None)
    say_names(meter.begin(full_name, message_type))
    async with anyio.create_task_group() as beside:
        beside.start_soon(note_absence, node, full_name)
        beside.start_soon(_print_lines, meter, node)
        async for message in node.subscription(message_type, full_name, QoS(depth=METER_DEPTH)):
            meter.add(node.clock.now(), message)
        beside.cancel_scope.cancel()
    return 0


async def _print_lines(meter: Meter, node: Node) -> None:
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
    """The line with the minimum, maximum and standard deviation of ``seconds``."""
    mean = math.fsum(seconds) / len(seconds)
    deviation = math.sqrt(math.fsum((each - mean) ** 2 for each in seconds) / len(seconds))
    return (
        f"\tmin: {min(seconds):.3f}s max: {max(seconds):.3f}s "
        f"std dev: {deviation:.5f}s window: {len(seconds)}\n"
    )


def _sizes(first: float, *more: float) -> list[str]:
    """Format sizes in bytes, all in the unit that suits the first one."""
    if first < 1000:
        return [f"{each:.0f} B" for each in (first, *more)]
    unit, size = ("KB", 1e3) if first < 1e6 else ("MB", 1e6)
    return [f"{each / size:.2f} {unit}" for each in (first, *more)]
