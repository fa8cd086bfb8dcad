"""``action``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import (
    Config,
    Connect,
    Domain,
    Interfaces,
    Job,
    Verb,
    new_group,
    on_graph,
    reach,
)
from turtleact.commands.verbs.send_goal import EXAMPLES, send_goal

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.node import Node

__all__ = ["app"]

_Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The action, such as /patrol.", autocompletion=completing.actions
    ),
]
_Type = Annotated[
    str,
    typer.Argument(
        metavar="TYPE",
        help="The type, pkg/action/Name.",
        autocompletion=completing.types("action", of_name=False),
    ),
]
_ShowTypes = Annotated[bool, typer.Option("--show-types", "-t", help="Show the types, too.")]
_CountActions = Annotated[
    bool, typer.Option("--count-actions", "-c", help="Only print how many there are.")
]
_Count = Annotated[bool, typer.Option("--count", "-c", help="Only print how many there are.")]

app = new_group("action")
app.command("send_goal", cls=Verb, help=VERBS["send-goal"], epilog=EXAMPLES)(send_goal)


@app.command("list", cls=Verb, help="List the actions that there are.")
def list_(
    *,
    types: _ShowTypes = False,
    count: _CountActions = False,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
) -> Job:
    """``action list``."""

    async def look(node: Node) -> int:
        from turtleact.commands import listing

        return await listing.print_list(node, "action", types=types, count=count, hidden=False)

    return on_graph(look, connect, domain, config)


@app.command("info", cls=Verb, help="Print which nodes serve an action, or are its clients.")
def info(
    name: _Name,
    *,
    types: _ShowTypes = False,
    count: _Count = False,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
) -> Job:
    """``action info``."""

    async def look(node: Node) -> int:
        from turtleact.commands import listing

        return await listing.print_action_info(node, name, types=types, count=count)

    return on_graph(look, connect, domain, config)


@app.command("type", cls=Verb, help="Print the type of an action.")
def type_(
    name: _Name, *, connect: Connect = None, domain: Domain = None, config: Config = None
) -> Job:
    """``action type``."""

    async def look(node: Node) -> int:
        from turtleact.commands import listing

        return await listing.print_type(node, "action", name)

    return on_graph(look, connect, domain, config)


@app.command("find", cls=Verb, help="List the actions of a type.")
def find(
    type_name: _Type,
    *,
    count: _CountActions = False,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
) -> Job:
    """``action find``."""

    async def look(node: Node) -> int:
        from turtleact.commands import listing

        return await listing.print_found(node, "action", type_name, count=count, hidden=False)

    return on_graph(look, connect, domain, config)


@app.command("echo", cls=Verb, help="Print the feedback and the states of all goals.")
def echo(
    name: _Name,
    *,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
    interfaces: Interfaces = None,
) -> Job:
    """``action echo``."""
    where = reach(connect, domain, config)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands import goals, graph
        from turtleact.commands.interfaces import make_known

        make_known(interfaces)
        return graph.run(where, lambda node: goals.echo(node, name), interrupts)

    return job
