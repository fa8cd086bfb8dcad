"""The verbs of ``node``, ``param`` and ``service``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from turtleact.commands import completion
from turtleact.commands.app import MessageVerb, new_group, verb
from turtleact.commands.options import (
    ShowTypes,
    argument,
    count_of,
    flag,
    hertz,
    message_of,
    name_of,
    only_one,
    stdin_of,
    type_and_text,
    type_of,
    value,
)
from turtleact.commands.output import note, say, say_lines, say_names
from turtleact.commands.settings import Owner, quoted
from turtleact.errors import ServerUnavailable, TurtleactError

if TYPE_CHECKING:
    from turtleact.commands.message_text import GoalText, Style
    from turtleact.commands.settings import ConnectOptions
    from turtleact.interfaces import Message
    from turtleact.interfaces.standard.rcl_interfaces.msg import ParameterValue, SetParametersResult
    from turtleact.node import Node
    from turtleact.node.services import ServiceType

__all__ = ["app", "param", "service"]


def pattern(given: str) -> re.Pattern[str]:
    """Parse a regular expression."""
    try:
        return re.compile(given)
    except re.error as error:
        raise typer.BadParameter(f"{quoted(given)} is no regular expression: {error}") from None


Name = Annotated[
    str, argument("PARAMETER", "The parameter, such as background_r.", completion.parameters)
]
ServiceName = Annotated[str, name_of("service", "/spawn", completion.services)]
AskedType = Annotated[str | None, type_of("service", is_asked=True)]
CountServices = Annotated[bool, count_of("--count-services")]
HiddenServices = Annotated[bool, flag("--include-hidden-services", text="Include hidden services.")]

Filter = Annotated[
    re.Pattern[str] | None,
    value(
        "--filter",
        metavar="REGEX",
        text="Only names that begin with a match of this expression.",
        parser=pattern,
    ),
]
Prefixes = Annotated[
    list[str] | None,
    value(
        "--param-prefixes",
        metavar="NAME",
        text="Only names with this prefix. Can be given several times.",
    ),
]
Rate = Annotated[
    float | None,
    value(
        "--rate",
        "-r",
        metavar="HZ",
        text="Repeat the call this many times per second.",
        parser=hertz,
    ),
]

app = new_group("node")
param = new_group("param")
service = new_group("service")


@verb(app, "list")
async def list_nodes(
    node: Node,
    *,
    hidden: Annotated[bool, flag("--all", "-a", text="List hidden nodes too.")] = False,
    count: Annotated[bool, count_of("--count-nodes")] = False,
) -> None:
    """List the nodes on the graph."""
    from turtleact.commands import graph

    graph.print_nodes(node, count=count, hidden=hidden)


@verb(app)
async def info(
    node: Node,
    name: Annotated[str, name_of("node", "/turtlesim", completion.nodes)],
    *,
    hidden: Annotated[
        bool, flag("--include-hidden", text="Print hidden topics, services and actions too.")
    ] = False,
) -> None:
    """Print the topics, services and actions of a node."""
    from turtleact.commands import graph

    graph.print_node_info(node, name, hidden=hidden)


@verb(param, "list")
async def list_parameters(
    node: Node,
    node_name: Annotated[
        str | None, argument("NODE", "The node. If left out, all nodes.", completion.nodes)
    ] = None,
    *,
    hidden: Annotated[bool, flag("--include-hidden-nodes", text="Include hidden nodes.")] = False,
    filter_: Filter = None,
    prefixes: Prefixes = None,
    types: Annotated[bool, flag("--param-type", text="Print the types too.")] = False,
) -> int:
    """List the parameters of one node or of all nodes."""
    from turtleact.commands.node_parameters import ParameterClient, kind_name

    async def lines(client: ParameterClient) -> str:
        names = await client.names(prefixes or ())
        names = [each for each in names if filter_ is None or filter_.match(each)]
        if types:
            found = await client.descriptors(names)
            names = [f"{each.name} (type: {kind_name(each.type)})" for each in found]
        return "".join(f"  {each}\n" for each in names)

    if node_name is not None:
        say_names(await lines(await ParameterClient.find(node, Owner(node_name, hidden))))
        return 0
    status = 0
    for client in await ParameterClient.find_all(node, hidden=hidden):
        try:
            if shown := await lines(client):
                say_names(f"{client.owner}:\n{shown}")
        except TurtleactError as error:  # the others are still listed
            note(str(error))
            status = 1
    return status


@verb(param)
async def get(
    node: Node,
    owner: Owner,
    name: Name,
    *,
    hide_type: Annotated[bool, flag("--hide-type", text="Print the value only.")] = False,
) -> None:
    """Print the value of a parameter."""
    from turtleact.commands.node_parameters import ParameterClient, kind_name, plain

    client = await ParameterClient.find(node, owner)
    [value] = await client.values([name])
    shown = plain(value)
    if hide_type:
        say_names(f"{shown}\n")
    elif shown is None:
        say_names("Parameter not set.\n")
    else:
        word, _, is_array = kind_name(value.type).capitalize().partition(" ")
        say_names(f"{word} {'values are' if is_array else 'value is'}: {shown}\n")


@verb(param, "set")
async def set_(
    node: Node,
    owner: Owner,
    name: Name,
    text: Annotated[str, argument("VALUE", "A bool, a number, text or a list, as YAML.")],
) -> int:
    """Set a parameter."""
    from turtleact.commands.node_parameters import parameter_value

    value = parameter_value(text)
    return await _set_one(node, owner, name, value, "Set parameter successful", "Setting")


@verb(param)
async def delete(node: Node, owner: Owner, name: Name) -> int:
    """Delete a parameter."""
    from turtleact.interfaces.standard.rcl_interfaces.msg import ParameterValue

    done = "Deleted parameter successfully"
    return await _set_one(node, owner, name, ParameterValue(), done, "Deleting")


async def _set_one(
    node: Node, owner: Owner, name: str, value: ParameterValue, done: str, trying: str
) -> int:
    from turtleact.commands.node_parameters import ParameterClient
    from turtleact.interfaces.standard.rcl_interfaces.msg import Parameter

    client = await ParameterClient.find(node, owner)
    [result] = await client.set([Parameter(name, value)])
    return _tell(result, done, f"{trying} parameter failed")


def _tell(result: SetParametersResult, done: str, failed: str) -> int:
    """Print a node's answer, and return the exit status."""
    reason = f": {result.reason}" if result.reason else ""
    if result.successful:
        say_names(f"{done}{reason}\n")
    else:
        note(f"{failed}{reason}")
    return int(not result.successful)


@verb(param)
async def describe(
    node: Node,
    owner: Owner,
    names: Annotated[list[str], argument("PARAMETER", "The parameters.", completion.parameters)],
) -> None:
    """Print what parameters are for, and which values they may have."""
    from turtleact.commands.node_parameters import ParameterClient, described

    client = await ParameterClient.find(node, owner)
    for each in await client.descriptors(names):
        say_lines(described(each))


@verb(param)
async def dump(node: Node, owner: Owner) -> None:
    """Print all parameters of a node as a YAML file."""
    from turtleact.commands.node_parameters import ParameterClient, as_yaml

    client = await ParameterClient.find(node, owner)
    names = await client.names()
    say_names(as_yaml(client.owner, names, await client.values(names)))


@verb(param, "load")
async def load_(
    node: Node,
    owner: Owner,
    path: Annotated[Path, argument("FILE", "A file in the format of 'param dump'.")],
    *,
    no_wildcard: Annotated[
        bool, flag("--no-use-wildcard", text="Skip what the file sets for all nodes (/**).")
    ] = False,
) -> int:
    """Set the parameters of a node from a file."""
    from turtleact.commands.node_parameters import ParameterClient, values_for

    client = await ParameterClient.find(node, owner)
    given = values_for(client.owner, str(path), use_wildcard=not no_wildcard)
    statuses = [
        _tell(result, f"Set parameter {name} successful", f"Set parameter {name} failed")
        for name, result in zip([each.name for each in given], await client.set(given), strict=True)
    ]
    return max(statuses)


@verb(service, "list")
async def list_services(
    node: Node,
    *,
    types: ShowTypes = False,
    count: CountServices = False,
    hidden: HiddenServices = False,
) -> None:
    """List the services on the graph."""
    from turtleact.commands import graph

    graph.print_list(node, "service", types=types, count=count, hidden=hidden)


@verb(service, "info")
async def service_info(node: Node, name: ServiceName) -> None:
    """Print the type of a service, and how many servers and clients it has."""
    from turtleact.commands import graph

    graph.print_service_info(node, name)


@verb(service, "type")
async def type_(node: Node, name: ServiceName) -> int:
    """Print the type of a service."""
    from turtleact.commands import graph

    return graph.print_type(node, "service", name)


@verb(service)
async def find(
    node: Node,
    type_name: Annotated[str, type_of("service")],
    *,
    count: CountServices = False,
    hidden: HiddenServices = False,
) -> None:
    """List the services of a type."""
    from turtleact.commands import graph

    graph.print_list(node, "service", type_name=type_name, count=count, hidden=hidden)


@verb(service, cls=MessageVerb, knows=True)
def call(
    reach: ConnectOptions,
    name: ServiceName,
    type_name: AskedType = None,
    values: Annotated[str | None, message_of("request")] = None,
    *,
    stdin: Annotated[bool, stdin_of("request")] = False,
    rate: Rate = None,
) -> int:
    """Call a service and print its response."""
    type_name, values = type_and_text(type_name, values, "request")
    only_one("the request", VALUES=values is not None, stdin=stdin)
    from turtleact.commands import graph
    from turtleact.commands.message_text import GoalText

    text = GoalText.read(values, stdin=stdin, path=None, what="request")
    return graph.run(reach, lambda node: _call(node, name, type_name, text, rate=rate))


async def _call(
    node: Node, name: str, type_name: str | None, text: GoalText, *, rate: float | None
) -> int:
    """Call a service as soon as it exists, once or at a rate, and return the exit status.

    Raises:
        InvalidName: if the name breaks ROS 2's rules.
        TurtleactError: if the service's type is unknown.
        InvalidMessage: if the request does not fit the type.
        ServerUnavailable: if the service has another type, or its server goes away.
        ServiceError: if the service's handler fails.
    """
    from turtleact.commands.graph import chosen_class, suggest
    from turtleact.commands.message_text import python_text
    from turtleact.interfaces import Service, from_text
    from turtleact.names import resolve_name
    from turtleact.transports.graph import types_by_name

    full_name = resolve_name(name)
    service_type = await chosen_class(node, "service", Service, full_name, type_name)
    request = from_text(
        service_type.Request, text.text, root="request", source=text.source, allow_nonfinite=True
    )
    client = node.service_client(cast("ServiceType[Message, Message]", service_type), full_name)
    types = types_by_name(node.transport.endpoints(), "service", hidden=True).get(full_name, ())
    if types and service_type.type_name not in types:
        problem = f"it is served as {' and '.join(types)}, not as {service_type.type_name}"
        raise ServerUnavailable(full_name, problem, kind="service")
    if not types:
        say("waiting for service to become available...\n")
        suggest(node, "service", full_name, service_type.type_name)
    await client.wait_for_service()
    while True:
        begun = node.clock.time()
        say(f"requester: making request: {python_text(request)}\n\n")
        response = await client.call(request)
        say(f"response:\n{python_text(response)}\n\n")
        if rate is None:
            return 0
        await node.clock.sleep_until(begun + 1 / rate)


@verb(service, knows=True)
async def echo(node: Node, name: ServiceName, type_name: AskedType = None, *, style: Style) -> int:
    """Print the requests and responses of a service, if somebody publishes them."""
    from turtleact.commands import event_echo

    return await event_echo.echo_service(node, name, type_name, style)
