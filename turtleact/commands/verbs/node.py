"""``node``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import (
    Config,
    Connect,
    Domain,
    Job,
    Verb,
    new_group,
    on_graph,
)

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["app"]

_Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The node, such as /turtlesim.", autocompletion=completing.nodes
    ),
]
_All = Annotated[bool, typer.Option("--all", "-a", help="Hidden nodes, too.")]
_Count = Annotated[bool, typer.Option("--count-nodes", "-c", help="Only print how many there are.")]
_Hidden = Annotated[
    bool, typer.Option("--include-hidden", help="Hidden topics, services and actions, too.")
]

app = new_group("node")


@app.command("list", cls=Verb, help="List the nodes that there are.")
def list_(
    *,
    hidden: _All = False,
    count: _Count = False,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
) -> Job:
    """``node list``."""

    async def look(node: Node) -> int:
        from turtleact.commands import listing

        return await listing.print_nodes(node, count=count, hidden=hidden)

    return on_graph(look, connect, domain, config)


@app.command("info", cls=Verb, help="Print the topics, services and actions of a node.")
def info(
    name: _Name,
    *,
    hidden: _Hidden = False,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
) -> Job:
    """``node info``."""

    async def look(node: Node) -> int:
        from turtleact.commands import listing

        return await listing.print_node_info(node, name, hidden=hidden)

    return on_graph(look, connect, domain, config)
