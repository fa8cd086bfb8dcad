"""Declares the group ``topic`` for Typer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.settings import Durability, Policies, Reliability, quoted
from turtleact.commands.verbs import Job, Verb, new_group
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Csv,
    Domain,
    Flow,
    FullLength,
    Interfaces,
    MessageVerb,
    NoArrays,
    NoStrings,
    ShowTypes,
    Truncate,
    count_of,
    hertz,
    in_seconds,
    message_of,
    name_of,
    on_graph,
    on_known_graph,
    only_one,
    reach,
    stdin_of,
    style,
    type_and_text,
    type_of,
    whole,
)
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Awaitable
    from types import CodeType

    from turtleact.commands.verbs.options import Look
    from turtleact.node import Node

__all__ = ["app", "policies"]

ProfileName: TypeAlias = Literal[
    "action_status_default",
    "best_available",
    "default",
    "parameter_events",
    "parameters",
    "sensor_data",
    "services_default",
    "system_default",
]

PROFILES: dict[ProfileName, Policies] = {
    "action_status_default": Policies("reliable", "transient_local", 1),
    "best_available": Policies(),
    "default": Policies("reliable", "volatile", 10),
    "parameter_events": Policies("reliable", "volatile", 1000),
    "parameters": Policies("reliable", "volatile", 1000),
    "sensor_data": Policies("best_effort", "volatile", 5),
    "services_default": Policies("reliable", "volatile", 10),
    "system_default": Policies(),
}
"""The profiles of quality of service by name. Source: rmw ``qos_profiles.h``."""

QOS = "Quality of service"
"""The heading of the options for quality of service."""

Name: TypeAlias = Annotated[str, name_of("topic", "/turtle1/pose", completion.topics)]
Type: TypeAlias = Annotated[str, type_of("topic")]
AskedType: TypeAlias = Annotated[str | None, type_of("topic", is_asked=True)]
Values: TypeAlias = Annotated[str | None, message_of("message")]
Count: TypeAlias = Annotated[bool, count_of("--count-topics")]
Hidden: TypeAlias = Annotated[
    bool, typer.Option("--include-hidden-topics", help="Include hidden topics.")
]
Verbose: TypeAlias = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print all that is known.")
]
Once: TypeAlias = Annotated[bool, typer.Option("--once", help="Exit after the first message.")]
Field: TypeAlias = Annotated[
    str | None,
    typer.Option("--field", metavar="FIELD", help="Print only this field, such as linear.x."),
]
Timeout: TypeAlias = Annotated[float | None, in_seconds("--timeout", text="Exit after this time.")]
Filter: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--filter",
        metavar="EXPR",
        help="Print only messages m for which this Python expression is true, such as 'm.x > 5'.",
    ),
]
Raw: TypeAlias = Annotated[bool, typer.Option("--raw", help="Print the bytes, as CDR.")]
Window: TypeAlias = Annotated[
    int,
    typer.Option("--window", "-w", metavar="N", min=1, help="How many messages to look at."),
]
Rate: TypeAlias = Annotated[
    float, typer.Option("--rate", "-r", metavar="HZ", parser=hertz, help="Messages per second.")
]
PrintEach: TypeAlias = Annotated[
    int,
    typer.Option("--print", "-p", metavar="N", parser=whole, help="Print every N-th message only."),
]
PubOnce: TypeAlias = Annotated[
    bool, typer.Option("--once", "-1", help="Publish one message and exit.")
]
Times: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--times", "-t", metavar="N", parser=whole, help="Publish this many messages and exit."
    ),
]
Wait: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--wait-matching-subscriptions",
        "-w",
        metavar="N",
        parser=whole,
        help="Wait for this many subscriptions first: 1 with --once or --times, else 0.",
    ),
]
Stdin: TypeAlias = Annotated[bool, stdin_of("message")]
Profile: TypeAlias = Annotated[
    ProfileName | None,
    typer.Option(
        "--qos-profile",
        metavar="NAME",
        help="A set of policies, such as sensor_data. The options below change single ones.",
        rich_help_panel=QOS,
    ),
]
QosReliability: TypeAlias = Annotated[
    Reliability | None,
    typer.Option(
        "--qos-reliability",
        metavar="POLICY",
        help="reliable or best_effort.",
        rich_help_panel=QOS,
    ),
]
QosDurability: TypeAlias = Annotated[
    Durability | None,
    typer.Option(
        "--qos-durability",
        metavar="POLICY",
        help="volatile or transient_local.",
        rich_help_panel=QOS,
    ),
]
Depth: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--qos-depth", metavar="N", min=1, help="How many messages to keep.", rich_help_panel=QOS
    ),
]

app = new_group("topic")


@app.command("list", cls=Verb)
def list_(
    *,
    types: ShowTypes = False,
    count: Count = False,
    hidden: Hidden = False,
    verbose: Verbose = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the topics on the graph."""
    from turtleact.commands import listing

    def look(node: Node) -> Awaitable[int]:
        if verbose and not count:
            return listing.print_topics_in_full(node, hidden=hidden)
        return listing.print_list(node, "topic", types=types, count=count, hidden=hidden)

    return on_graph(reach(connect, domain, config), look)


@app.command(cls=Verb)
def info(
    name: Name,
    *,
    verbose: Verbose = False,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print the type of a topic, its publishers and its subscribers."""
    from turtleact.commands import listing

    return on_known_graph(
        reach(connect, domain, config),
        interfaces,
        lambda: lambda node: listing.print_topic_info(node, name, verbose=verbose),
    )


@app.command("type", cls=Verb)
def type_(name: Name, *, connect: Connect = None, domain: Domain = 0, config: Config = None) -> Job:
    """Print the type of a topic."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config), lambda node: listing.print_type(node, "topic", name)
    )


@app.command(cls=Verb)
def find(
    type_name: Type,
    *,
    count: Count = False,
    hidden: Hidden = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the topics of a type."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_found(node, "topic", type_name, count=count, hidden=hidden),
    )


@app.command(cls=Verb)
def echo(
    name: Name,
    type_name: AskedType = None,
    *,
    once: Once = False,
    field: Field = None,
    csv: Csv = False,
    flow: Flow = False,
    full_length: FullLength = False,
    truncate_length: Truncate = 128,
    no_arr: NoArrays = False,
    no_str: NoStrings = False,
    timeout: Timeout = None,
    filter_: Filter = None,
    raw: Raw = False,
    interfaces: Interfaces = None,
    profile: Profile = None,
    reliability: QosReliability = None,
    durability: QosDurability = None,
    depth: Depth = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print the messages of a topic."""
    from turtleact.commands import topic_reading

    if field is not None and not all(field.split(".")):
        raise UsageError(f"--field takes names separated by dots, not {quoted(field)}")
    only_one("how messages are printed", raw=raw, csv=csv, flow_style=flow)
    only_one("what is printed", raw=raw, field=field is not None)
    longest = None if full_length else truncate_length
    order = topic_reading.Order(
        name,
        type_name,
        () if field is None else tuple(field.split(".")),
        once=once,
        style=style(csv=csv, flow=flow, longest=longest, no_arr=no_arr, no_str=no_str),
        timeout=timeout,
        wanted=None if filter_ is None else _compiled(filter_),
        raw=raw,
        policies=policies(profile, reliability, durability, depth),
    )
    return on_known_graph(
        reach(connect, domain, config),
        interfaces,
        lambda: lambda node: topic_reading.echo(node, order),
    )


@app.command(cls=Verb)
def hz(
    name: Name,
    *,
    window: Window = 10000,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print how many messages arrive per second."""
    from turtleact.commands import topic_reading

    return on_known_graph(
        reach(connect, domain, config),
        interfaces,
        lambda: lambda node: topic_reading.measure(node, name, topic_reading.Rate(window)),
    )


@app.command(cls=Verb)
def bw(
    name: Name,
    *,
    window: Window = 100,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print how many bytes arrive per second."""
    from turtleact.commands import topic_reading

    return on_known_graph(
        reach(connect, domain, config),
        interfaces,
        lambda: lambda node: topic_reading.measure(node, name, topic_reading.Bandwidth(window)),
    )


@app.command(cls=Verb)
def delay(
    name: Name,
    *,
    window: Window = 10000,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print the age of messages at their arrival, by the stamp in their header."""
    from turtleact.commands import topic_reading

    return on_known_graph(
        reach(connect, domain, config),
        interfaces,
        lambda: lambda node: topic_reading.measure(node, name, topic_reading.Delay(window)),
    )


@app.command(cls=MessageVerb)
def pub(
    name: Name,
    type_name: AskedType = None,
    values: Values = None,
    *,
    once: PubOnce = False,
    times: Times = None,
    rate: Rate = 1.0,
    print_each: PrintEach = 1,
    wait: Wait = None,
    stdin: Stdin = False,
    interfaces: Interfaces = None,
    profile: Profile = None,
    reliability: QosReliability = None,
    durability: QosDurability = None,
    depth: Depth = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Publish messages on a topic."""
    type_name, values = type_and_text(type_name, values, "message")
    only_one("the message", VALUES=values is not None, stdin=stdin)
    only_one("how often", once=once, times=times is not None)
    count = 1 if once else times or 0
    asked = policies(profile, reliability, durability, depth)

    def plan() -> Look:
        from turtleact.commands import user_messages
        from turtleact.commands.message_text import GoalText

        text = GoalText.read(values, stdin=stdin, path=None, what="message")
        order = user_messages.Order(
            name,
            type_name,
            text,
            rate=rate,
            times=count,
            every=print_each,
            wait=int(count > 0) if wait is None else wait,
            policies=asked,
        )
        return lambda node: user_messages.publish(node, order)

    return on_known_graph(reach(connect, domain, config), interfaces, plan)


def policies(
    profile: ProfileName | None,
    reliability: Reliability | None,
    durability: Durability | None,
    depth: int | None,
) -> Policies:
    """Return the requested quality of service. An option for one policy overrides the profile."""
    known = Policies() if profile is None else PROFILES[profile]
    return Policies(
        reliability or known.reliability, durability or known.durability, depth or known.depth
    )


def _compiled(expression: str) -> CodeType:
    """Compile the Python expression of ``--filter``."""
    try:
        return compile(expression.strip(), "--filter", "eval")
    except (SyntaxError, ValueError) as error:
        problem = f"takes a Python expression such as m.x > 5, not {quoted(expression)}"
        raise UsageError(f"--filter {problem}: {getattr(error, 'msg', error)}") from None
