"""``service``, as Typer reads it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.verbs import Job, Verb, new_group
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Domain,
    Interfaces,
    hertz,
    message_of,
    on_graph,
    on_known_graph,
    only_one,
    reach,
    type_and_text,
    type_of,
)

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.verbs.options import Look

__all__ = ["app"]

Name: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The service, such as /spawn.", autocompletion=completion.services
    ),
]
Type: TypeAlias = Annotated[str, type_of("service")]
AskedType: TypeAlias = Annotated[str | None, type_of("service", is_asked=True)]
Values: TypeAlias = Annotated[str | None, message_of("request")]
Stdin: TypeAlias = Annotated[bool, typer.Option("--stdin", help="Read the request from stdin.")]
Rate: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--rate", "-r", metavar="HZ", parser=hertz, help="Repeat the call, this many a second."
    ),
]
ShowTypes: TypeAlias = Annotated[
    bool, typer.Option("--show-types", "-t", help="Print the types too.")
]
Count: TypeAlias = Annotated[
    bool, typer.Option("--count-services", "-c", help="Print only how many there are.")
]
Hidden: TypeAlias = Annotated[
    bool, typer.Option("--include-hidden-services", help="Include hidden services.")
]

app = new_group("service")


@app.command("list", cls=Verb)
def list_(
    *,
    types: ShowTypes = False,
    count: Count = False,
    hidden: Hidden = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the services on the graph."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_list(node, "service", types=types, count=count, hidden=hidden),
    )


@app.command(cls=Verb)
def info(name: Name, *, connect: Connect = None, domain: Domain = 0, config: Config = None) -> Job:
    """Print the type of a service, and how many servers and clients it has."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config), lambda node: listing.print_service_info(node, name)
    )


@app.command("type", cls=Verb)
def type_(name: Name, *, connect: Connect = None, domain: Domain = 0, config: Config = None) -> Job:
    """Print the type of a service."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config), lambda node: listing.print_type(node, "service", name)
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
    """List the services of a type."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_found(node, "service", type_name, count=count, hidden=hidden),
    )


@app.command(cls=Verb)
def call(
    name: Name,
    type_name: AskedType = None,
    values: Values = None,
    *,
    stdin: Stdin = False,
    rate: Rate = None,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Call a service and print its response."""
    type_name, values = type_and_text(type_name, values, "request")
    only_one("the request", VALUES=values is not None, stdin=stdin)

    def plan(interrupts: Interrupts) -> Look:
        from turtleact.commands import user_messages
        from turtleact.commands.message_text import GoalText

        text = GoalText.read(values, stdin=stdin, path=None, interrupts=interrupts, what="request")
        return lambda node: user_messages.call(node, name, type_name, text, rate=rate)

    return on_known_graph(reach(connect, domain, config), interfaces, plan)
