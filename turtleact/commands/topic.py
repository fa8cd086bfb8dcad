"""The verbs of ``topic``."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, TypeAlias

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
from turtleact.commands.settings import WrongOptions, quoted

if TYPE_CHECKING:
    from types import CodeType

    from turtleact.commands.message_text import Style
    from turtleact.commands.settings import Policies, Reach
    from turtleact.node import Node

__all__ = ["app"]

Name: TypeAlias = Annotated[str, name_of("topic", "/turtle1/pose", completion.topics)]
AskedType: TypeAlias = Annotated[str | None, type_of("topic", is_asked=True)]
Count: TypeAlias = Annotated[bool, count_of("--count-topics")]
Hidden: TypeAlias = Annotated[bool, flag("--include-hidden-topics", text="Include hidden topics.")]
Verbose: TypeAlias = Annotated[bool, flag("--verbose", "-v", text="Print all that is known.")]
Window: TypeAlias = Annotated[
    int, value("--window", "-w", metavar="N", text="How many messages to look at.", min=1)
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
) -> int:
    """List the topics on the graph."""
    from turtleact.commands import listing

    if verbose and not count:
        return await listing.print_topics_in_full(node, hidden=hidden)
    return await listing.print_list(node, "topic", types=types, count=count, hidden=hidden)


@verb(app, knows=True)
async def info(node: Node, name: Name, *, verbose: Verbose = False) -> int:
    """Print the type of a topic, its publishers and its subscribers."""
    from turtleact.commands import listing

    return await listing.print_topic_info(node, name, verbose=verbose)


@verb(app, "type")
async def type_(node: Node, name: Name) -> int:
    """Print the type of a topic."""
    from turtleact.commands import listing

    return await listing.print_type(node, "topic", name)


@verb(app)
async def find(
    node: Node,
    type_name: Annotated[str, type_of("topic")],
    *,
    count: Count = False,
    hidden: Hidden = False,
) -> int:
    """List the topics of a type."""
    from turtleact.commands import listing

    return await listing.print_found(node, "topic", type_name, count=count, hidden=hidden)


@verb(app, knows=True)
def echo(
    reach: Reach,
    name: Name,
    type_name: AskedType = None,
    *,
    once: Annotated[bool, flag("--once", text="Exit after the first message.")] = False,
    field: Annotated[
        str | None,
        value("--field", metavar="FIELD", text="Print only this field, such as linear.x."),
    ] = None,
    style: Style,
    timeout: Annotated[float | None, in_seconds("--timeout", text="Exit after this time.")] = None,
    filter_: Annotated[
        str | None,
        value(
            "--filter",
            metavar="EXPR",
            text="Print only messages m for which this Python expression is true, such as "
            "'m.x > 5'.",
        ),
    ] = None,
    raw: Annotated[bool, flag("--raw", text="Print the bytes, as CDR.")] = False,
    policies: Policies,
) -> int:
    """Print the messages of a topic."""
    if field is not None and not all(field.split(".")):
        raise WrongOptions(f"--field takes names separated by dots, not {quoted(field)}")
    only_one("how messages are printed", raw=raw, csv=style.csv, flow_style=style.flow)
    only_one("what is printed", raw=raw, field=field is not None)
    wanted = None if filter_ is None else _compiled(filter_)
    from turtleact.commands import graph, topic_reading

    path = () if field is None else tuple(field.split("."))
    order = topic_reading.Order(
        name,
        type_name,
        path,
        once=once,
        style=style,
        timeout=timeout,
        wanted=wanted,
        raw=raw,
        policies=policies,
    )
    return graph.run(reach, partial(topic_reading.echo, order=order))


@verb(app, knows=True)
async def hz(node: Node, name: Name, *, window: Window = 10000) -> int:
    """Print how many messages arrive per second."""
    from turtleact.commands import topic_reading

    return await topic_reading.measure(node, name, topic_reading.Rate(window))


@verb(app, knows=True)
async def bw(node: Node, name: Name, *, window: Window = 100) -> int:
    """Print how many bytes arrive per second."""
    from turtleact.commands import topic_reading

    return await topic_reading.measure(node, name, topic_reading.Bandwidth(window))


@verb(app, knows=True)
async def delay(node: Node, name: Name, *, window: Window = 10000) -> int:
    """Print the age of messages at their arrival, by the stamp in their header."""
    from turtleact.commands import topic_reading

    return await topic_reading.measure(node, name, topic_reading.Delay(window))


@verb(app, cls=MessageVerb, knows=True)
def pub(
    reach: Reach,
    name: Name,
    type_name: AskedType = None,
    values: Annotated[str | None, message_of("message")] = None,
    *,
    once: Annotated[bool, flag("--once", "-1", text="Publish one message and exit.")] = False,
    times: Annotated[
        int | None,
        value(
            *("--times", "-t"),
            metavar="N",
            text="Publish this many messages and exit.",
            parser=whole,
        ),
    ] = None,
    rate: Annotated[
        float, value("--rate", "-r", metavar="HZ", text="Messages per second.", parser=hertz)
    ] = 1.0,
    print_each: Annotated[
        int,
        value(*("--print", "-p"), metavar="N", text="Print every N-th message only.", parser=whole),
    ] = 1,
    wait: Annotated[
        int | None,
        value(
            *("--wait-matching-subscriptions", "-w"),
            metavar="N",
            text="Wait for this many subscriptions first: 1 with --once or --times, else 0.",
            parser=whole,
        ),
    ] = None,
    stdin: Annotated[bool, stdin_of("message")] = False,
    policies: Policies,
) -> int:
    """Publish messages on a topic."""
    type_name, values = type_and_text(type_name, values, "message")
    only_one("the message", VALUES=values is not None, stdin=stdin)
    only_one("how often", once=once, times=times is not None)
    count = 1 if once else times or 0
    from turtleact.commands import graph, user_messages
    from turtleact.commands.message_text import GoalText

    order = user_messages.Order(
        name,
        type_name,
        GoalText.read(values, stdin=stdin, path=None, what="message"),
        rate=rate,
        times=count,
        every=print_each,
        wait=int(count > 0) if wait is None else wait,
        policies=policies,
    )
    return graph.run(reach, partial(user_messages.publish, order=order))


def _compiled(expression: str) -> CodeType:
    """Compile the Python expression of ``--filter``."""
    try:
        return compile(expression.strip(), "--filter", "eval")
    except (SyntaxError, ValueError) as error:
        problem = f"takes a Python expression such as m.x > 5, not {quoted(expression)}"
        raise WrongOptions(f"--filter {problem}: {getattr(error, 'msg', error)}") from None
