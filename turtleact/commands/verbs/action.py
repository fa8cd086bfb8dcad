"""``action``, as Typer sees it."""

from __future__ import annotations

from typing import Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import type_of
from turtleact.commands.verbs.looking import Look, on_graph, on_known_graph
from turtleact.commands.verbs.reading import Verb, new_group
from turtleact.commands.verbs.send_goal import EXAMPLES, send_goal

__all__ = ["app"]

_Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The action, such as /patrol.", autocompletion=completing.actions
    ),
]
_Type = Annotated[str, type_of("action")]
_ShowTypes = Annotated[bool, typer.Option("--show-types", "-t", help="Show the types, too.")]
_CountActions = Annotated[
    bool, typer.Option("--count-actions", "-c", help="Only print how many there are.")
]
_Count = Annotated[bool, typer.Option("--count", "-c", help="Only print how many there are.")]

app = new_group("action")
app.command("send_goal", cls=Verb, help=VERBS["send-goal"], epilog=EXAMPLES)(send_goal)


@app.command("list", cls=Verb, help="List the actions that there are.")
@on_graph
def list_(*, types: _ShowTypes = False, count: _CountActions = False) -> Look:
    """``action list``."""
    from turtleact.commands import listing

    return lambda node: listing.print_list(node, "action", types=types, count=count, hidden=False)


@app.command("info", cls=Verb, help="Print which nodes serve an action, or are its clients.")
@on_graph
def info(name: _Name, *, types: _ShowTypes = False, count: _Count = False) -> Look:
    """``action info``."""
    from turtleact.commands import listing

    return lambda node: listing.print_action_info(node, name, types=types, count=count)


@app.command("type", cls=Verb, help="Print the type of an action.")
@on_graph
def type_(name: _Name) -> Look:
    """``action type``."""
    from turtleact.commands import listing

    return lambda node: listing.print_type(node, "action", name)


@app.command("find", cls=Verb, help="List the actions of a type.")
@on_graph
def find(type_name: _Type, *, count: _CountActions = False) -> Look:
    """``action find``."""
    from turtleact.commands import listing

    return lambda node: listing.print_found(node, "action", type_name, count=count, hidden=False)


@app.command("echo", cls=Verb, help="Print the feedback and the states of all goals.")
@on_known_graph
def echo(name: _Name) -> Look:
    """``action echo``."""
    from turtleact.commands import held_goals

    return lambda node: held_goals.echo(node, name)
