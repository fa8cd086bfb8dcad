"""``node``, as Typer reads it."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.verbs import Job, Verb, new_group
from turtleact.commands.verbs.options import Config, Connect, Domain, on_graph, reach

__all__ = ["app"]

Name: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The node, such as /turtlesim.", autocompletion=completion.nodes
    ),
]
All: TypeAlias = Annotated[bool, typer.Option("--all", "-a", help="List hidden nodes too.")]
Count: TypeAlias = Annotated[
    bool, typer.Option("--count-nodes", "-c", help="Print only how many there are.")
]
Hidden: TypeAlias = Annotated[
    bool,
    typer.Option("--include-hidden", help="Print hidden topics, services and actions too."),
]

app = new_group("node")


@app.command("list", cls=Verb)
def list_(
    *,
    hidden: All = False,
    count: Count = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the nodes on the graph."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_nodes(node, count=count, hidden=hidden),
    )


@app.command(cls=Verb)
def info(
    name: Name,
    *,
    hidden: Hidden = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print the topics, services and actions of a node."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_node_info(node, name, hidden=hidden),
    )
