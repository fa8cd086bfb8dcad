"""``topic``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands.policies import Policies
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import (
    message_of,
    number,
    only_one,
    quoted,
    type_and_text,
    type_of,
    whole,
)
from turtleact.commands.verbs.grouping import grouped
from turtleact.commands.verbs.looking import (
    Look,
    Plan,
    on_graph,
    on_known_graph,
    planned_on_known_graph,
)
from turtleact.commands.verbs.policies import read_policies
from turtleact.commands.verbs.reading import Verb, new_group
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from types import CodeType

    from turtleact.commands.interrupts import Interrupts

__all__ = ["app"]

_Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The topic, such as /turtle1/pose.", autocompletion=completing.topics
    ),
]
_Type = Annotated[str, type_of("topic")]
_AskedType = Annotated[str | None, type_of("topic", is_asked=True)]
_Values = Annotated[str | None, message_of("message")]
_ShowTypes = Annotated[bool, typer.Option("--show-types", "-t", help="Show the types, too.")]
_Count = Annotated[
    bool, typer.Option("--count-topics", "-c", help="Only print how many there are.")
]
_Hidden = Annotated[bool, typer.Option("--include-hidden-topics", help="Hidden topics, too.")]
_Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print all that is known.")]
_Once = Annotated[bool, typer.Option("--once", help="Leave after the first message.")]
_Field = Annotated[
    str | None,
    typer.Option("--field", metavar="FIELD", help="Only this field, such as linear.x."),
]
_Csv = Annotated[bool, typer.Option("--csv", help="All values on one line, commas between.")]
_Flow = Annotated[bool, typer.Option("--flow-style", help="A message a line, in braces.")]
_FullLength = Annotated[
    bool, typer.Option("--full-length", "-f", help="Cut neither lists nor strings.")
]
_Truncate = Annotated[
    str,
    typer.Option(
        "--truncate-length", "-l", metavar="N", help="Cut lists and strings that are longer."
    ),
]
_NoArrays = Annotated[bool, typer.Option("--no-arr", help="Print no lists, just what they are.")]
_NoStrings = Annotated[bool, typer.Option("--no-str", help="Print no strings, just their length.")]
_Timeout = Annotated[
    str | None, typer.Option("--timeout", metavar="SECONDS", help="Leave after so long.")
]
_Filter = Annotated[
    str | None,
    typer.Option("--filter", metavar="EXPR", help="Only messages m of which this Python is true."),
]
_Raw = Annotated[bool, typer.Option("--raw", help="Print the bytes, as CDR.")]
_Window = Annotated[
    str, typer.Option("--window", "-w", metavar="N", help="How many messages are looked at.")
]
_Rate = Annotated[
    str, typer.Option("--rate", "-r", metavar="HZ", help="So many messages a second.")
]
_PrintEach = Annotated[
    str, typer.Option("--print", "-p", metavar="N", help="Only print every N-th message.")
]
_PubOnce = Annotated[bool, typer.Option("--once", "-1", help="Publish one message and leave.")]
_Times = Annotated[
    str | None,
    typer.Option("--times", "-t", metavar="N", help="Publish so many messages and leave."),
]
_Wait = Annotated[
    str | None,
    typer.Option(
        "--wait-matching-subscriptions",
        "-w",
        metavar="N",
        help="Wait for so many subscriptions: 1 with --once or --times, else 0.",
    ),
]
_Stdin = Annotated[bool, typer.Option("--stdin", help="Read the message from stdin.")]

app = new_group("topic")


@app.command("list", cls=Verb, help="List the topics that there are.")
@on_graph
def list_(
    *,
    types: _ShowTypes = False,
    count: _Count = False,
    hidden: _Hidden = False,
    verbose: _Verbose = False,
) -> Look:
    """``topic list``."""
    from turtleact.commands import listing

    if verbose and not count:
        return lambda node: listing.print_topics_in_full(node, hidden=hidden)
    return lambda node: listing.print_list(node, "topic", types=types, count=count, hidden=hidden)


@app.command("info", cls=Verb, help="Print the type of a topic, and who uses it.")
@on_known_graph
def info(name: _Name, *, verbose: _Verbose = False) -> Look:
    """``topic info``."""
    from turtleact.commands import listing

    return lambda node: listing.print_topic_info(node, name, verbose=verbose)


@app.command("type", cls=Verb, help="Print the type of a topic.")
@on_graph
def type_(name: _Name) -> Look:
    """``topic type``."""
    from turtleact.commands import listing

    return lambda node: listing.print_type(node, "topic", name)


@app.command("find", cls=Verb, help="List the topics of a type.")
@on_graph
def find(type_name: _Type, *, count: _Count = False, hidden: _Hidden = False) -> Look:
    """``topic find``."""
    from turtleact.commands import listing

    return lambda node: listing.print_found(node, "topic", type_name, count=count, hidden=hidden)


@app.command("echo", cls=Verb, help="Print the messages of a topic.")
@on_known_graph
@grouped(policies=read_policies)
def echo(
    name: _Name,
    type_name: _AskedType = None,
    *,
    once: _Once = False,
    field: _Field = None,
    csv: _Csv = False,
    flow: _Flow = False,
    full_length: _FullLength = False,
    truncate_length: _Truncate = "128",
    no_arr: _NoArrays = False,
    no_str: _NoStrings = False,
    timeout: _Timeout = None,
    filter_: _Filter = None,
    raw: _Raw = False,
    policies: Policies,
) -> Look:
    """``topic echo``."""
    from turtleact.commands import topic_reading

    length = whole("--truncate-length", truncate_length)
    seconds = None if timeout is None else number("--timeout", timeout)
    if field is not None and not all(field.split(".")):
        raise UsageError(f"--field is names with dots between, such as linear.x, not '{field}'")

    only_one("how messages are printed", raw=raw, csv=csv, flow_style=flow)
    only_one("what is printed", raw=raw, field=field is not None)
    wanted = None if filter_ is None else _compiled(filter_)
    order = topic_reading.Order(
        name,
        type_name,
        () if field is None else tuple(field.split(".")),
        once=once,
        csv=csv,
        flow=flow,
        longest=None if full_length else length,
        arrays=not no_arr,
        strings=not no_str,
        timeout=seconds,
        wanted=wanted,
        raw=raw,
        policies=policies,
    )
    return lambda node: topic_reading.echo(node, order)


@app.command("hz", cls=Verb, help="Print how many messages come a second.")
@on_known_graph
def hz(name: _Name, *, window: _Window = "10000") -> Look:
    """``topic hz``."""
    from turtleact.commands import topic_reading

    meter = topic_reading.Rate(whole("--window", window, least=1))
    return lambda node: topic_reading.measure(node, name, meter)


@app.command("bw", cls=Verb, help="Print how many bytes come a second.")
@on_known_graph
def bw(name: _Name, *, window: _Window = "100") -> Look:
    """``topic bw``."""
    from turtleact.commands import topic_reading

    meter = topic_reading.Bandwidth(whole("--window", window, least=1))
    return lambda node: topic_reading.measure(node, name, meter)


@app.command("delay", cls=Verb, help="Print how old messages with a header are.")
@on_known_graph
def delay(name: _Name, *, window: _Window = "10000") -> Look:
    """``topic delay``."""
    from turtleact.commands import topic_reading

    meter = topic_reading.Delay(whole("--window", window, least=1))
    return lambda node: topic_reading.measure(node, name, meter)


@app.command("pub", cls=Verb, help="Publish messages on a topic.")
@planned_on_known_graph
@grouped(policies=read_policies)
def pub(
    name: _Name,
    type_name: _AskedType = None,
    values: _Values = None,
    *,
    once: _PubOnce = False,
    times: _Times = None,
    rate: _Rate = "1",
    print_each: _PrintEach = "1",
    wait: _Wait = None,
    stdin: _Stdin = False,
    policies: Policies,
) -> Plan:
    """``topic pub``."""
    type_name, values = type_and_text(type_name, values, "message")
    only_one("the message", VALUES=values is not None, stdin=stdin)
    only_one("how often", once=once, times=times is not None)
    hertz = number("--rate", rate, unit="messages a second", is_positive=True)
    count = 1 if once else 0 if times is None else whole("--times", times)
    least = int(count > 0) if wait is None else whole("--wait-matching-subscriptions", wait)
    every = whole("--print", print_each)

    def plan(interrupts: Interrupts) -> Look:
        from turtleact.commands import user_messages
        from turtleact.commands.message_text import GoalText

        text = GoalText.read(values, stdin=stdin, path=None, interrupts=interrupts, what="message")
        order = user_messages.Order(
            name,
            type_name,
            text,
            rate=hertz,
            times=count,
            every=every,
            wait=least,
            policies=policies,
        )
        return lambda node: user_messages.publish(node, order)

    return plan


def _compiled(expression: str) -> CodeType:
    """A Python expression, ready to be asked."""
    try:
        return compile(expression.strip(), "--filter", "eval")
    except (SyntaxError, ValueError) as error:
        problem = f"is a Python expression such as m.x > 5, not {quoted(expression)}"
        raise UsageError(f"--filter {problem}: {getattr(error, 'msg', error)}") from None
