"""Declares the verbs about nodes, their parameters and services for Typer."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from turtleact.commands import completion
from turtleact.commands.settings import quoted
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
)
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Awaitable

    from turtleact.commands.verbs.options import Look
    from turtleact.node import Node

__all__ = ["app", "param", "service"]

NodeName: TypeAlias = Annotated[str, name_of("node", "/turtlesim", completion.nodes, "NODE")]
AnyNode: TypeAlias = Annotated[
    str | None,
    typer.Argument(
        metavar="NODE", help="The node. If left out, all nodes.", autocompletion=completion.nodes
    ),
]
Name: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="PARAMETER",
        help="The parameter, such as background_r.",
        autocompletion=completion.parameters,
    ),
]
Names: TypeAlias = Annotated[
    list[str],
    typer.Argument(
        metavar="PARAMETER", help="The parameters.", autocompletion=completion.parameters
    ),
]
Value: TypeAlias = Annotated[
    str, typer.Argument(metavar="VALUE", help="A bool, a number, text or a list, as YAML.")
]
File: TypeAlias = Annotated[
    Path, typer.Argument(metavar="FILE", help="A file in the format of 'param dump'.")
]
Hidden: TypeAlias = Annotated[
    bool, typer.Option("--include-hidden-nodes", help="Include hidden nodes.")
]
Timeout: TypeAlias = Annotated[
    float, in_seconds("--timeout", text="How long to wait for the node.")
]
Filter: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--filter", metavar="REGEX", help="Only names that begin with a match of this expression."
    ),
]
Prefixes: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--param-prefixes",
        metavar="NAME",
        help="Only names with this prefix. Can be given several times.",
    ),
]
ParamTypes: TypeAlias = Annotated[bool, typer.Option("--param-type", help="Print the types too.")]
HideType: TypeAlias = Annotated[bool, typer.Option("--hide-type", help="Print the value only.")]
NoWildcard: TypeAlias = Annotated[
    bool,
    typer.Option("--no-use-wildcard", help="Skip what the file sets for all nodes (/**)."),
]
SomeNode: TypeAlias = Annotated[str, name_of("node", "/turtlesim", completion.nodes)]
All: TypeAlias = Annotated[bool, typer.Option("--all", "-a", help="List hidden nodes too.")]
Count: TypeAlias = Annotated[bool, count_of("--count-nodes")]
ShowHidden: TypeAlias = Annotated[
    bool,
    typer.Option("--include-hidden", help="Print hidden topics, services and actions too."),
]

ServiceName: TypeAlias = Annotated[str, name_of("service", "/spawn", completion.services)]
ServiceType: TypeAlias = Annotated[str, type_of("service")]
AskedType: TypeAlias = Annotated[str | None, type_of("service", is_asked=True)]
Values: TypeAlias = Annotated[str | None, message_of("request")]
Stdin: TypeAlias = Annotated[bool, stdin_of("request")]
Rate: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--rate",
        "-r",
        metavar="HZ",
        parser=hertz,
        help="Repeat the call this many times per second.",
    ),
]
CountServices: TypeAlias = Annotated[bool, count_of("--count-services")]
HiddenServices: TypeAlias = Annotated[
    bool, typer.Option("--include-hidden-services", help="Include hidden services.")
]

app = new_group("node")
param = new_group("param")
service = new_group("service")


@app.command("list", cls=Verb)
def list_nodes(
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
    name: SomeNode,
    *,
    hidden: ShowHidden = False,
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


@param.command("list", cls=Verb)
def list_parameters(
    node_name: AnyNode = None,
    *,
    hidden: Hidden = False,
    filter_: Filter = None,
    prefixes: Prefixes = None,
    types: ParamTypes = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the parameters of one node or of all nodes."""
    from turtleact.commands import node_parameters

    try:
        pattern = None if filter_ is None else re.compile(filter_)
    except re.error as error:
        problem = f"takes a regular expression, not {quoted(filter_ or '')}: {error}"
        raise UsageError(f"--filter {problem}") from None

    def look(node: Node) -> Awaitable[int]:
        return node_parameters.print_names(
            node, node_name, pattern=pattern, prefixes=prefixes or (), types=types, hidden=hidden
        )

    return on_graph(reach(connect, domain, config), look)


@param.command(cls=Verb)
def get(
    node_name: NodeName,
    name: Name,
    *,
    hide_type: HideType = False,
    hidden: Hidden = False,
    timeout: Timeout = 1.0,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print the value of a parameter."""
    from turtleact.commands import node_parameters

    owner = node_parameters.Owner(node_name, hidden, timeout)
    return on_graph(
        reach(connect, domain, config),
        lambda node: node_parameters.print_value(node, owner, name, hide_type=hide_type),
    )


@param.command("set", cls=Verb)
def set_(
    node_name: NodeName,
    name: Name,
    value: Value,
    *,
    hidden: Hidden = False,
    timeout: Timeout = 1.0,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Set a parameter."""
    from turtleact.commands import node_parameters

    owner = node_parameters.Owner(node_name, hidden, timeout)
    message = node_parameters.parameter_value(value)
    return on_graph(
        reach(connect, domain, config),
        lambda node: node_parameters.set_value(node, owner, name, message),
    )


@param.command(cls=Verb)
def delete(
    node_name: NodeName,
    name: Name,
    *,
    hidden: Hidden = False,
    timeout: Timeout = 1.0,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Delete a parameter."""
    from turtleact.commands import node_parameters

    owner = node_parameters.Owner(node_name, hidden, timeout)
    return on_graph(
        reach(connect, domain, config), lambda node: node_parameters.delete(node, owner, name)
    )


@param.command(cls=Verb)
def describe(
    node_name: NodeName,
    names: Names,
    *,
    hidden: Hidden = False,
    timeout: Timeout = 1.0,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print what parameters are for, and which values they may have."""
    from turtleact.commands import node_parameters

    owner = node_parameters.Owner(node_name, hidden, timeout)
    return on_graph(
        reach(connect, domain, config), lambda node: node_parameters.describe(node, owner, names)
    )


@param.command(cls=Verb)
def dump(
    node_name: NodeName,
    *,
    hidden: Hidden = False,
    timeout: Timeout = 1.0,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print all parameters of a node as a YAML file."""
    from turtleact.commands import node_parameters

    owner = node_parameters.Owner(node_name, hidden, timeout)
    return on_graph(reach(connect, domain, config), lambda node: node_parameters.dump(node, owner))


@param.command("load", cls=Verb)
def load_(
    node_name: NodeName,
    path: File,
    *,
    no_wildcard: NoWildcard = False,
    hidden: Hidden = False,
    timeout: Timeout = 1.0,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Set the parameters of a node from a file."""
    from turtleact.commands import graph, node_parameters

    owner = node_parameters.Owner(node_name, hidden, timeout)
    where = reach(connect, domain, config)

    def job() -> int:
        found = node_parameters.read_file(str(path), use_wildcard=not no_wildcard)
        return graph.run(where, lambda node: node_parameters.load(node, owner, found, str(path)))

    return job


@service.command("list", cls=Verb)
def list_services(
    *,
    types: ShowTypes = False,
    count: CountServices = False,
    hidden: HiddenServices = False,
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


@service.command("info", cls=Verb)
def service_info(
    name: ServiceName, *, connect: Connect = None, domain: Domain = 0, config: Config = None
) -> Job:
    """Print the type of a service, and how many servers and clients it has."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config), lambda node: listing.print_service_info(node, name)
    )


@service.command("type", cls=Verb)
def type_(
    name: ServiceName, *, connect: Connect = None, domain: Domain = 0, config: Config = None
) -> Job:
    """Print the type of a service."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config), lambda node: listing.print_type(node, "service", name)
    )


@service.command(cls=Verb)
def find(
    type_name: ServiceType,
    *,
    count: CountServices = False,
    hidden: HiddenServices = False,
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


@service.command(cls=MessageVerb)
def call(
    name: ServiceName,
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

    def plan() -> Look:
        from turtleact.commands import user_messages
        from turtleact.commands.message_text import GoalText

        text = GoalText.read(values, stdin=stdin, path=None, what="request")
        return lambda node: user_messages.call(node, name, type_name, text, rate=rate)

    return on_known_graph(reach(connect, domain, config), interfaces, plan)


@service.command(cls=Verb)
def echo(
    name: ServiceName,
    type_name: AskedType = None,
    *,
    csv: Csv = False,
    flow: Flow = False,
    full_length: FullLength = False,
    truncate_length: Truncate = 128,
    no_arr: NoArrays = False,
    no_str: NoStrings = False,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print the requests and responses of a service, if somebody publishes them."""
    from turtleact.commands import event_echo

    longest = None if full_length else truncate_length
    shown = style(csv=csv, flow=flow, longest=longest, no_arr=no_arr, no_str=no_str)
    order = event_echo.Order(name, type_name, shown)
    return on_known_graph(
        reach(connect, domain, config),
        interfaces,
        lambda: lambda node: event_echo.echo_service(node, order),
    )
