"""The verbs of ``topic``.

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
from contextlib import aclosing
from typing import TYPE_CHECKING, Annotated, TypeVar

from turtleact.commands import completion
from turtleact.commands.app import MessageVerb, new_group, verb
from turtleact.commands.options import (
    ShowTypes,
    count_of,
    flag,
    hertz,
    in_seconds,
    message_of,
    name_of,
    only_one,
    stdin_of,
    type_and_text,
    type_of,
    value,
    whole,
)
from turtleact.commands.output import note, say, say_message, say_names
from turtleact.commands.settings import WrongOptions, quoted
from turtleact.errors import TurtleactError, UsageError, summary

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence
    from types import CodeType

    from turtleact.commands.message_text import GoalText, Style
    from turtleact.commands.settings import ConnectOptions, Durability, Policies
    from turtleact.interfaces import Message
    from turtleact.node import Node
    from turtleact.node.topics import Publisher, Subscription

__all__ = ["app"]

T = TypeVar("T")

ECHO_DEPTH = 1000
"""How many messages ``echo`` keeps while the output is stuck."""

METER_DEPTH = 100_000
"""How many messages ``hz``, ``bw`` and ``delay`` keep while the output is stuck."""

DONE, TIMEOUT = 0, 124
"""Exit statuses."""

ABSENCE = 1.0
"""How long to wait for a publisher before a note says that the topic has none (s, graph clock)."""

PATIENCE = 5.0
"""How long to wait until a subscription on the graph can be reached (s, by the graph's clock)."""

PERIOD = 1.0
"""The time between two lines of a measurement (s, by the clock of the graph)."""

SILENT = "no new messages\n"
"""The text that is printed when a topic falls silent."""

Name = Annotated[str, name_of("topic", "/turtle1/pose", completion.topics)]
AskedType = Annotated[str | None, type_of("topic", is_asked=True)]
Count = Annotated[bool, count_of("--count-topics")]
Hidden = Annotated[bool, flag("--include-hidden-topics", text="Include hidden topics.")]
Verbose = Annotated[bool, flag("--verbose", "-v", text="Print all that is known.")]
Window = Annotated[
    int, value("--window", "-w", metavar="N", text="How many messages to look at.", min=1)
]
Field = Annotated[
    str | None, value("--field", metavar="FIELD", text="Print only this field, such as linear.x.")
]
Filter = Annotated[
    str | None,
    value(
        "--filter",
        metavar="EXPR",
        text="Print only messages m for which this Python expression is true, such as 'm.x > 5'.",
    ),
]
Times = Annotated[
    int | None,
    value("--times", "-t", metavar="N", text="Publish this many messages and exit.", parser=whole),
]
Frequency = Annotated[
    float, value("--rate", "-r", metavar="HZ", text="Messages per second.", parser=hertz)
]
PrintEach = Annotated[
    int, value("--print", "-p", metavar="N", text="Print every N-th message only.", parser=whole)
]
Wait = Annotated[
    int | None,
    value(
        *("--wait-matching-subscriptions", "-w"),
        metavar="N",
        text="Wait for this many subscriptions first: 1 with --once or --times, else 0.",
        parser=whole,
    ),
]

app = new_group("topic")


@verb(app, "list")
async def list_(
    node: Node,
    *,
    types: ShowTypes = False,
    count: Count = False,
    hidden: Hidden = False,
    verbose: Verbose = False,
) -> None:
    """List the topics on the graph."""
    from turtleact.commands import graph

    if verbose and not count:
        graph.print_topics_in_full(node, hidden=hidden)
    else:
        graph.print_list(node, "topic", types=types, count=count, hidden=hidden)


@verb(app, knows=True)
async def info(node: Node, name: Name, *, verbose: Verbose = False) -> None:
    """Print the type of a topic, its publishers and its subscribers."""
    from turtleact.commands import graph

    graph.print_topic_info(node, name, verbose=verbose)


@verb(app, "type")
async def type_(node: Node, name: Name) -> int:
    """Print the type of a topic."""
    from turtleact.commands import graph

    return graph.print_type(node, "topic", name)


@verb(app)
async def find(
    node: Node,
    type_name: Annotated[str, type_of("topic")],
    *,
    count: Count = False,
    hidden: Hidden = False,
) -> None:
    """List the topics of a type."""
    from turtleact.commands import graph

    graph.print_list(node, "topic", type_name=type_name, count=count, hidden=hidden)


@verb(app, knows=True)
def echo(
    reach: ConnectOptions,
    name: Name,
    type_name: AskedType = None,
    *,
    once: Annotated[bool, flag("--once", text="Exit after the first message.")] = False,
    field: Field = None,
    style: Style,
    timeout: Annotated[float | None, in_seconds("--timeout", text="Exit after this time.")] = None,
    filter_: Filter = None,
    raw: Annotated[bool, flag("--raw", text="Print the bytes, as CDR.")] = False,
    policies: Policies,
) -> int:
    """Print the messages of a topic."""
    path = () if field is None else tuple(field.split("."))
    if not all(path):
        raise WrongOptions(f"--field takes names separated by dots, not {quoted(field or '')}")
    only_one("how messages are printed", raw=raw, csv=style.csv, flow_style=style.flow)
    only_one("what is printed", raw=raw, field=field is not None)
    wanted = None if filter_ is None else _compiled(filter_)
    from turtleact.commands import graph
    from turtleact.interfaces import encode
    from turtleact.tasks.clock import within

    def text_of(message: Message) -> str:
        if raw:
            return f"{encode(message)!r}\n---\n"
        shown: object = style.values(message)
        for each in path:
            shown = shown[each]  # type: ignore[index]  # a mapping, as `_check_path` has seen
        return style.text(shown)

    async def print_messages(node: Node, subscription: Subscription[Message]) -> int:
        count = missed = 0
        async with within(timeout, node.clock):
            async for message in subscription:
                if subscription.missed > missed:
                    note(f"{subscription.missed - missed} messages were lost: they came too fast")
                    missed = subscription.missed
                if wanted is None or _is_wanted(message, wanted, path):
                    say_message(text_of(message))
                    count += 1
                    if once:
                        break
        return count

    async def look(node: Node) -> int:
        subscription = await _subscribed(node, name, type_name, path, policies)
        if await _beside_notes(node, subscription.topic, print_messages(node, subscription)):
            return DONE
        note(f"no message on topic '{subscription.topic}' within {timeout:g} s")
        return TIMEOUT

    return graph.run(reach, look)


@verb(app, knows=True)
async def hz(node: Node, name: Name, *, window: Window = 10000) -> None:
    """Print how many messages arrive per second."""
    full_name, message_type = await _awaited_topic(node, name)
    between = _Samples(window)
    last: list[int] = []

    def add(now: int, _message: Message) -> None:
        between.add(*(now - each for each in last))
        last[:] = [now]

    def headline(mean: float) -> str:
        return f"average rate: {1 / mean if mean else 0:.3f}"

    await _measure(node, full_name, message_type, add, lambda: between.lines(headline))


@verb(app, knows=True)
async def bw(node: Node, name: Name, *, window: Window = 100) -> None:
    """Print how many bytes arrive per second."""
    from turtleact.interfaces import encode

    full_name, message_type = await _awaited_topic(node, name)
    say_names(f"Subscribed to [{full_name}]\n")
    came: deque[tuple[int, int]] = deque(maxlen=window)

    def add(now: int, message: Message) -> None:
        came.append((now, len(encode(message))))

    def lines() -> str:
        elapsed = node.clock.now() - came[0][0] if len(came) > 1 else 0
        return _bandwidth([size for _, size in came], elapsed * 1e-9) if elapsed > 0 else ""

    await _measure(node, full_name, message_type, add, lines)


@verb(app, knows=True)
async def delay(node: Node, name: Name, *, window: Window = 10000) -> None:
    """Print the age of messages at their arrival, by the stamp in their header."""
    from turtleact.interfaces import nanoseconds
    from turtleact.interfaces.types import fields

    full_name, message_type = await _awaited_topic(node, name)
    kinds = {field.name: field.type.name for field in fields(message_type)}
    if kinds.get("header") != "std_msgs/msg/Header":
        problem = f"messages of type {message_type.type_name} have no header"
        raise TurtleactError(f"topic '{full_name}': {problem}, so their age is unknown")
    ages = _Samples(window)

    def add(now: int, message: Message) -> None:
        ages.add(now - nanoseconds(message.header.stamp))  # type: ignore[attr-defined]  # as above

    def lines() -> str:
        return ages.lines(lambda mean: f"average delay: {mean:.3f}")

    await _measure(node, full_name, message_type, add, lines)


@verb(app, cls=MessageVerb, knows=True)
def pub(
    reach: ConnectOptions,
    name: Name,
    type_name: AskedType = None,
    values: Annotated[str | None, message_of("message")] = None,
    *,
    once: Annotated[bool, flag("--once", "-1", text="Publish one message and exit.")] = False,
    times: Times = None,
    rate: Frequency = 1.0,
    print_each: PrintEach = 1,
    wait: Wait = None,
    stdin: Annotated[bool, stdin_of("message")] = False,
    policies: Policies,
) -> int:
    """Publish messages on a topic."""
    type_name, values = type_and_text(type_name, values, "message")
    only_one("the message", VALUES=values is not None, stdin=stdin)
    only_one("how often", once=once, times=times is not None)
    count = 1 if once else times or 0
    least = int(count > 0) if wait is None else wait
    from turtleact.commands import graph
    from turtleact.commands.message_text import GoalText, python_text

    text = GoalText.read(values, stdin=stdin, path=None, what="message")

    async def publish(node: Node) -> int:
        full_name, message_type, make = await _message_maker(node, name, type_name, text)
        publisher = node.publisher(message_type, full_name, policies.qos())
        await _wait_for_subscriptions(node, publisher, message_type.type_name, least)
        say("publisher: beginning loop\n")
        start, number = node.clock.time(), 0
        while True:
            number += 1
            message = make()
            if print_each and number % print_each == 0:
                say(f"publishing #{number}: {python_text(message)}\n\n")
            publisher.publish(message)
            if number == count:
                return DONE
            # By a schedule that begins with the first message, so that delays do not add up.
            await node.clock.sleep_until(start + number / rate)

    return graph.run(reach, publish)


# publishing


async def _message_maker(
    node: Node, name: str, type_name: str | None, text: GoalText
) -> tuple[str, type[Message], Callable[[], Message]]:
    """Read the text of a message. Print a note if the topic has another type.

    Return the full name and the type of the topic, and a function that makes the message. It is
    made anew each time, as ``now`` and ``auto`` stand for the time of each message.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the topic's type is unknown.
        InvalidMessage: if the message does not fit the type.
    """
    from turtleact.commands.graph import chosen_class
    from turtleact.interfaces import Message, from_dict
    from turtleact.interfaces.text import Document, tree_of
    from turtleact.names import resolve_name
    from turtleact.transports.graph import types_by_name

    name = resolve_name(name)
    message_type = await chosen_class(node, "topic", Message, name, type_name)
    tree = tree_of(Document(text.text, "message", text.source, allow_nonfinite=True))

    def make() -> Message:
        timed = _timed(tree, message_type, node.clock.now())
        return from_dict(message_type, timed, root="message")  # type: ignore[arg-type]  # it checks that

    make()  # an error is raised before waiting for subscriptions
    types = types_by_name(node.transport.endpoints(), "topic", hidden=True).get(name, ())
    if types and message_type.type_name not in types:
        others = " and ".join(types)
        note(f"topic '{name}' is of type {others}, so no node receives {message_type.type_name}")
    return name, message_type, make


async def _wait_for_subscriptions(
    node: Node, publisher: Publisher[Message], type_name: str, least: int
) -> None:
    """Wait until a topic has some subscriptions of this type, and until they can be reached."""
    from turtleact.commands.graph import suggest
    from turtleact.tasks.clock import within

    def count() -> int:
        wanted = ("subscription", publisher.topic, type_name)
        endpoints = node.transport.endpoints()
        return sum((each.kind, each.name, each.type_name) == wanted for each in endpoints)

    if count() < least:
        say(f"Waiting for at least {least} matching subscription(s)...\n")
        suggest(node, "subscription", publisher.topic, type_name)
    while count() < least:
        await node.transport.wait_for_change()
    async with within(PATIENCE, node.clock):  # a known subscription is reached a little later
        while count() and not publisher.has_subscriptions:
            await node.transport.wait_for_change()


def _timed(tree: object, message_type: type[Message], now: int) -> object:
    """Return a message's plain values, with the current time filled in.

    The time replaces the text ``auto`` of a header and the text ``now`` of a stamp.
    """
    from turtleact.interfaces import stamp_of
    from turtleact.interfaces.types import fields, nested_classes

    if not isinstance(tree, dict):
        return tree
    stamp = stamp_of(now)
    present = {"sec": stamp.sec, "nanosec": stamp.nanosec}
    timed = dict(tree)
    for field, nested in zip(fields(message_type), nested_classes(message_type), strict=True):
        said = (field.type.name, tree.get(field.name))
        if said == ("std_msgs/msg/Header", "auto"):
            timed[field.name] = {"stamp": present}
        elif said == ("builtin_interfaces/msg/Time", "now"):
            timed[field.name] = present
        elif nested is not None and field.name in tree and not field.type.is_sequence:
            timed[field.name] = _timed(tree[field.name], nested, now)
    return timed


# reading


async def _subscribed(
    node: Node, name: str, type_name: str | None, path: Sequence[str], policies: Policies
) -> Subscription[Message]:
    """Subscribe to a topic, with the durability that its publishers offer unless one is given.

    Raises:
        TurtleactError: if the topic's type is unknown, or if the type of every publisher differs
            from ``type_name``.
        UsageError: if the messages have no field at ``path``.
    """
    from turtleact.commands.graph import chosen_class, note_differing
    from turtleact.interfaces import Message, type_hash
    from turtleact.names import resolve_name

    name = resolve_name(name)
    message_type = await chosen_class(node, "topic", Message, name, type_name)
    _check_type(node, name, message_type.type_name)
    _check_path(message_type, path)
    endpoints = node.transport.endpoints()
    publishers = [each for each in endpoints if each.kind == "publisher" and each.name == name]
    is_latched = any(each.qos.durability == "transient_local" for each in publishers)
    durability: Durability = "transient_local" if is_latched else "volatile"
    qos = policies.qos(durability=durability, depth=ECHO_DEPTH)
    subscription = node.subscription(message_type, name, qos)
    note_differing(node, publishers, {message_type.type_name: type_hash(message_type)})
    return subscription


async def _beside_notes(node: Node, name: str, reading: Coroutine[object, object, T]) -> T:
    """Wait for ``reading``. Meanwhile, say if no publisher is left, or the world is paused."""
    from turtleact.commands.graph import note_pause
    from turtleact.tasks import Background

    async def tell() -> None:
        await note_pause(node)
        await _note_absence(node, name)

    async with aclosing(Background(tell(), "watching publishers")):
        return await reading


async def _note_absence(node: Node, name: str) -> None:
    from turtleact.tasks.clock import within

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


def _check_type(node: Node, name: str, type_name: str) -> None:
    """Raise an error if the topic has publishers, but none of this type."""
    from turtleact.transports.graph import types_by_name

    endpoints = node.transport.endpoints()
    types = types_by_name(endpoints, "topic", "publisher", hidden=True).get(name, ())
    if types and type_name not in types:
        problem = f"it is of type {' and '.join(types)}, not {type_name}"
        raise TurtleactError(f"topic '{name}': {problem}; leave out the type or correct it")


def _check_path(message_type: type[Message], path: Sequence[str]) -> None:
    """Raise an error if messages of this type have no field at ``path``."""
    from turtleact.interfaces.definition import did_you_mean
    from turtleact.interfaces.types import fields, nested_classes

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


def _compiled(expression: str) -> CodeType:
    """Compile the Python expression of ``--filter``."""
    try:
        return compile(expression.strip(), "--filter", "eval")
    except (SyntaxError, ValueError) as error:
        problem = f"takes a Python expression such as m.x > 5, not {quoted(expression)}"
        raise WrongOptions(f"--filter {problem}: {getattr(error, 'msg', error)}") from None


def _is_wanted(message: Message, wanted: CodeType, path: Sequence[str]) -> bool:
    """Whether the user's filter is true for a message, or for the field at ``path``."""
    value: object = message
    for name in path:
        value = getattr(value, name)
    try:
        return bool(eval(wanted, {"m": value}))  # noqa: S307  # the user's own program
    except Exception as error:
        raise UsageError(f"--filter: {summary(error)}; m is {value!r}") from None


# measuring


class _Samples:
    """The latest measurements (ns)."""

    def __init__(self, window: int) -> None:
        self._held: deque[int] = deque(maxlen=window)
        self._is_news = False

    def add(self, *samples: int) -> None:
        self._held.extend(samples)
        self._is_news = self._is_news or bool(samples)

    def lines(self, headline: Callable[[float], str]) -> str:
        """Return the mean and the spread, or a note if there is nothing new since the last call.

        The text is empty before the first sample.
        """
        if not self._held:
            return ""
        if not self._is_news:
            return SILENT
        self._is_news = False
        seconds = [each * 1e-9 for each in self._held]
        mean = math.fsum(seconds) / len(seconds)
        deviation = math.sqrt(math.fsum((each - mean) ** 2 for each in seconds) / len(seconds))
        return (
            f"{headline(mean)}\n\tmin: {min(seconds):.3f}s max: {max(seconds):.3f}s "
            f"std dev: {deviation:.5f}s window: {len(seconds)}\n"
        )


def _bandwidth(sizes: Sequence[int], seconds: float) -> str:
    """Return the bandwidth of messages of these sizes, all in the unit that suits it."""
    rate = sum(sizes) / seconds
    figures = (rate, sum(sizes) / len(sizes), min(sizes), max(sizes))
    if rate < 1000:
        said = [f"{each:.0f} B" for each in figures]
    else:
        unit, size = ("KB", 1e3) if rate < 1e6 else ("MB", 1e6)
        said = [f"{each / size:.2f} {unit}" for each in figures]
    return (
        f"{said[0]}/s from {len(sizes)} messages\n"
        f"\tMessage size mean: {said[1]} min: {said[2]} max: {said[3]}\n"
    )


async def _awaited_topic(node: Node, name: str) -> tuple[str, type[Message]]:
    """Wait until a topic is there. Return its full name and its type."""
    from turtleact.commands.graph import chosen_class
    from turtleact.interfaces import Message
    from turtleact.interfaces.definition import names_like
    from turtleact.names import resolve_name
    from turtleact.transports.graph import types_by_name

    name = resolve_name(name)
    found = types_by_name(node.transport.endpoints(), "topic", hidden=True)
    if name not in found:
        hint = names_like(name, [each for each in found if "/_" not in each])
        note(f"topic '{name}' is not there yet{hint}; waiting for it")
    while name not in types_by_name(node.transport.endpoints(), "topic", hidden=True):
        await node.transport.wait_for_change()
    return name, await chosen_class(node, "topic", Message, name, None)


async def _measure(
    node: Node,
    name: str,
    message_type: type[Message],
    add: Callable[[int, Message], None],
    lines: Callable[[], str],
) -> None:
    """Print the measurements of a topic each second, until the node is closed.

    Args:
        node: A node on the graph.
        name: The full name of the topic.
        message_type: The type of the topic.
        add: Adds a message that arrived at a time (ns).
        lines: Returns the lines to print.
    """
    from turtleact.tasks import Background
    from turtleact.transports import QoS

    async def print_lines() -> None:
        while True:
            await node.clock.sleep(PERIOD)
            say(lines())

    subscription = node.subscription(message_type, name, QoS(depth=METER_DEPTH))

    async def read() -> None:
        async for message in subscription:
            add(node.clock.now(), message)

    # An error of printing, such as a closed pipe, ends the verb.
    async with aclosing(Background(read(), "measuring")):
        await _beside_notes(node, name, print_lines())
