"""``action``, as Typer reads it."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.verbs import Job, Verb, new_group
from turtleact.commands.verbs.goals import EXAMPLES, send_goal
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Domain,
    Interfaces,
    on_graph,
    on_known_graph,
    reach,
    type_of,
)

__all__ = ["app"]

Name: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The action, such as /patrol.", autocompletion=completion.actions
    ),
]
Type: TypeAlias = Annotated[str, type_of("action")]
ShowTypes: TypeAlias = Annotated[
    bool, typer.Option("--show-types", "-t", help="Print the types too.")
]
CountActions: TypeAlias = Annotated[
    bool, typer.Option("--count-actions", "-c", help="Print only how many there are.")
]
Count: TypeAlias = Annotated[
    bool, typer.Option("--count", "-c", help="Print only how many there are.")
]

app = new_group("action")
app.command("send_goal", cls=Verb, help=VERBS["send-goal"], epilog=EXAMPLES)(send_goal)


@app.command("list", cls=Verb)
def list_(
    *,
    types: ShowTypes = False,
    count: CountActions = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the actions on the graph."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_list(node, "action", types=types, count=count, hidden=False),
    )


@app.command(cls=Verb)
def info(
    name: Name,
    *,
    types: ShowTypes = False,
    count: Count = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print which nodes serve an action and which are its clients."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_action_info(node, name, types=types, count=count),
    )


@app.command("type", cls=Verb)
def type_(name: Name, *, connect: Connect = None, domain: Domain = 0, config: Config = None) -> Job:
    """Print the type of an action."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config), lambda node: listing.print_type(node, "action", name)
    )


@app.command(cls=Verb)
def find(
    type_name: Type,
    *,
    count: CountActions = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the actions of a type."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_found(node, "action", type_name, count=count, hidden=False),
    )


@app.command(cls=Verb)
def echo(
    name: Name,
    *,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print the feedback and the states of all goals of an action."""
    from turtleact.commands import held_goals

    return on_known_graph(
        reach(connect, domain, config),
        interfaces,
        lambda _: lambda node: held_goals.echo(node, name),
    )
