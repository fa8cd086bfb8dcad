"""``node``, as Typer sees it."""

from __future__ import annotations

from typing import Annotated

import typer

from turtleact.commands.verbs import completing
from turtleact.commands.verbs.looking import Look, on_graph
from turtleact.commands.verbs.reading import Verb, new_group

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
@on_graph
def list_(*, hidden: _All = False, count: _Count = False) -> Look:
    """``node list``."""
    from turtleact.commands import listing

    return lambda node: listing.print_nodes(node, count=count, hidden=hidden)


@app.command("info", cls=Verb, help="Print the topics, services and actions of a node.")
@on_graph
def info(name: _Name, *, hidden: _Hidden = False) -> Look:
    """``node info``."""
    from turtleact.commands import listing

    return lambda node: listing.print_node_info(node, name, hidden=hidden)
