"""``param``, as Typer sees it."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import number, quoted
from turtleact.commands.verbs.looking import Look, on_graph
from turtleact.commands.verbs.reading import Verb, new_group
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Awaitable

    from turtleact.commands.node_parameters import Owner
    from turtleact.node import Node

__all__ = ["app"]

_Node = Annotated[
    str,
    typer.Argument(
        metavar="NODE", help="The node, such as /turtlesim.", autocompletion=completing.nodes
    ),
]
_AnyNode = Annotated[
    str | None,
    typer.Argument(
        metavar="NODE", help="The node; all of them if left out.", autocompletion=completing.nodes
    ),
]
_Name = Annotated[
    str,
    typer.Argument(
        metavar="PARAMETER",
        help="The parameter, such as background_r.",
        autocompletion=completing.parameters,
    ),
]
_Names = Annotated[
    list[str],
    typer.Argument(
        metavar="PARAMETER...", help="The parameters.", autocompletion=completing.parameters
    ),
]
_Value = Annotated[
    str, typer.Argument(metavar="VALUE", help="A bool, a number, text, or a list, as YAML.")
]
_File = Annotated[str, typer.Argument(metavar="FILE", help="A file such as 'param dump' prints.")]
_Hidden = Annotated[bool, typer.Option("--include-hidden-nodes", help="Hidden nodes, too.")]
_Timeout = Annotated[
    str, typer.Option("--timeout", metavar="SECONDS", help="Wait so long for the node.")
]
_Filter = Annotated[
    str | None,
    typer.Option("--filter", metavar="REGEX", help="Only names that begin as it says."),
]
_Prefixes = Annotated[
    list[str] | None,
    typer.Option("--param-prefixes", metavar="NAME", help="Only those of this group; repeatable."),
]
_ShowTypes = Annotated[bool, typer.Option("--param-type", help="Show of which kind they are.")]
_HideType = Annotated[bool, typer.Option("--hide-type", help="Only print the value.")]
_NoWildcard = Annotated[
    bool, typer.Option("--no-use-wildcard", help="Not those that the file has for all nodes (/**).")
]

app = new_group("param")


@app.command("list", cls=Verb, help="List the parameters that there are.")
@on_graph
def list_(
    node_name: _AnyNode = None,
    *,
    hidden: _Hidden = False,
    filter_: _Filter = None,
    prefixes: _Prefixes = None,
    types: _ShowTypes = False,
) -> Look:
    """``param list``."""
    from turtleact.commands import node_parameters

    try:
        pattern = None if filter_ is None else re.compile(filter_)
    except re.error as error:
        problem = f"is a regular expression, not {quoted(filter_ or '')}: {error}"
        raise UsageError(f"--filter {problem}") from None

    def look(node: Node) -> Awaitable[int]:
        return node_parameters.print_names(
            node, node_name, pattern=pattern, prefixes=prefixes or (), types=types, hidden=hidden
        )

    return look


@app.command("get", cls=Verb, help="Print the value of a parameter.")
@on_graph
def get(
    node_name: _Node,
    name: _Name,
    *,
    hide_type: _HideType = False,
    hidden: _Hidden = False,
    timeout: _Timeout = "1",
) -> Look:
    """``param get``."""
    from turtleact.commands import node_parameters

    owner = _owner(node_name, timeout, hidden=hidden)
    return lambda node: node_parameters.print_value(node, owner, name, hide_type=hide_type)


@app.command("set", cls=Verb, help="Set a parameter.")
@on_graph
def set_(
    node_name: _Node,
    name: _Name,
    value: _Value,
    *,
    hidden: _Hidden = False,
    timeout: _Timeout = "1",
) -> Look:
    """``param set``."""
    from turtleact.commands import node_parameters

    owner = _owner(node_name, timeout, hidden=hidden)
    message = node_parameters.parameter_value(value)
    return lambda node: node_parameters.set_value(node, owner, name, message)


@app.command("delete", cls=Verb, help="Delete a parameter.")
@on_graph
def delete(
    node_name: _Node, name: _Name, *, hidden: _Hidden = False, timeout: _Timeout = "1"
) -> Look:
    """``param delete``."""
    from turtleact.commands import node_parameters

    owner = _owner(node_name, timeout, hidden=hidden)
    return lambda node: node_parameters.delete(node, owner, name)


@app.command("describe", cls=Verb, help="Print what parameters are for, and may be.")
@on_graph
def describe(
    node_name: _Node, names: _Names, *, hidden: _Hidden = False, timeout: _Timeout = "1"
) -> Look:
    """``param describe``."""
    from turtleact.commands import node_parameters

    owner = _owner(node_name, timeout, hidden=hidden)
    return lambda node: node_parameters.describe(node, owner, names)


@app.command("dump", cls=Verb, help="Print all parameters of a node, as a file in YAML.")
@on_graph
def dump(node_name: _Node, *, hidden: _Hidden = False, timeout: _Timeout = "1") -> Look:
    """``param dump``."""
    from turtleact.commands import node_parameters

    owner = _owner(node_name, timeout, hidden=hidden)
    return lambda node: node_parameters.dump(node, owner)


@app.command("load", cls=Verb, help="Set the parameters of a node that a file has.")
@on_graph
def load(
    node_name: _Node,
    path: _File,
    *,
    no_wildcard: _NoWildcard = False,
    hidden: _Hidden = False,
    timeout: _Timeout = "1",
) -> Look:
    """``param load``."""
    from turtleact.commands import node_parameters

    owner = _owner(node_name, timeout, hidden=hidden)
    found = node_parameters.read_file(path, use_wildcard=not no_wildcard)
    return lambda node: node_parameters.load(node, owner, found, path)


def _owner(name: str, timeout: str, *, hidden: bool) -> Owner:
    from turtleact.commands.node_parameters import Owner

    return Owner(name, hidden, number("--timeout", timeout))
