"""The verbs of ``param``: what the parameters of a node are, and what they shall be.

A node serves its parameters by six services; what they answer is printed as ``ros2`` prints it.

Source: ros2cli ``ros2param/verb/*.py`` and recordings of ROS 2 Jazzy for the order of
things and for the words.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeVar

from turtleact.clock import within
from turtleact.commands.graph import names_like, say_names
from turtleact.commands.kinds import is_hidden_node, types_by_name
from turtleact.commands.parameter_values import BELOW, KINDS, WILDCARD, kind_name, plain
from turtleact.commands.stderr import note
from turtleact.errors import TurtleactError, UsageError
from turtleact.interfaces import Message
from turtleact.interfaces.standard.parameters import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    Parameter,
    ParameterValue,
    SetParameters,
)
from turtleact.interfaces.text import block

if TYPE_CHECKING:
    import re
    from collections.abc import Iterator, Mapping, Sequence

    from turtleact.interfaces.standard.parameters import (
        FloatingPointRange,
        IntegerRange,
        ParameterDescriptor,
    )
    from turtleact.node import Node
    from turtleact.services import ServiceType

__all__ = [
    "Owner",
    "delete",
    "describe",
    "dump",
    "load",
    "names_of",
    "print_names",
    "print_value",
    "set_value",
]

Req = TypeVar("Req", bound=Message)
Res = TypeVar("Res", bound=Message)

DONE, FAILED = 0, 1
"""Exit statuses."""

PATIENCE = 5.0
"""Seconds that a node has for an answer, by the clock of the graph."""


class Owner(NamedTuple):
    """The node whose parameters are meant.

    Attributes:
        name: Its name; a slash before it may be missing.
        hidden: Whether it may be one whose name begins with an underscore.
        timeout: How long it is waited for (s, by the clock of the graph).
    """

    name: str
    hidden: bool
    timeout: float


async def print_names(
    node: Node,
    name: str | None,
    *,
    pattern: re.Pattern[str] | None,
    prefixes: Sequence[str],
    types: bool,
    hidden: bool,
) -> int:
    """Print the names of the parameters of a node, or of all nodes that have some.

    Of all nodes, one that does not answer is noted, and is an error at the end.

    Args:
        node: A node on the graph.
        name: The node; None for all.
        pattern: What the names must begin with; None for anything.
        prefixes: The groups that are wanted; none means all.
        types: Whether to print of which kind they are.
        hidden: Whether to look at nodes whose name begins with an underscore.

    Raises:
        TurtleactError: if the node is not there or has none, or does not answer.
    """

    async def lines(owner: str) -> list[str]:
        names = await _names(node, owner, prefixes)
        names = [each for each in names if pattern is None or pattern.match(each)]
        if not types:
            return [f"  {each}" for each in names]
        found = await _described(node, owner, names)
        return [f"  {one.name} (type: {kind_name(one.type)})" for one in found]

    if name is not None:
        owner = await _find(node, Owner(name, hidden, 0))
        say_names("".join(f"{line}\n" for line in await lines(owner)))
        return DONE
    status = DONE
    for owner in sorted(_nodes(node, hidden=hidden)):
        if not _has_parameters(node, owner):
            continue
        try:
            shown = await lines(owner)
        except TurtleactError as error:
            note(str(error))
            status = FAILED
            continue
        if shown:
            say_names("".join(f"{line}\n" for line in (f"{owner}:", *shown)))
    return status


async def names_of(node: Node, name: str) -> list[str]:
    """The names of a node's parameters; raises as `print_names` does."""
    return await _names(node, await _find(node, Owner(name, hidden=True, timeout=0)), ())


async def print_value(node: Node, owner: Owner, name: str, *, hide_type: bool) -> int:
    """Print the value of a parameter.

    Raises:
        TurtleactError: if there is no such node or parameter, with the nearest.
    """
    who = await _find(node, owner)
    [value] = await _values(node, who, [name])
    kind = KINDS.get(value.type)
    label, shown = ("Parameter not set.", None) if kind is None else (kind.label, plain(value))
    say_names(f"{shown}\n" if hide_type else f"{label}\n" if kind is None else f"{label} {shown}\n")
    return DONE


async def set_value(node: Node, owner: Owner, name: str, value: ParameterValue) -> int:
    """Set a parameter; the exit status says whether its node has taken the value.

    Raises:
        TurtleactError: if there is no such node.
    """
    return await _set_one(node, owner, name, value, "Set parameter successful", "Setting")


async def delete(node: Node, owner: Owner, name: str) -> int:
    """Delete a parameter, if its node lets us; as `set_value`."""
    done = "Deleted parameter successfully"
    return await _set_one(node, owner, name, ParameterValue(), done, "Deleting")


async def describe(node: Node, owner: Owner, names: Sequence[str]) -> int:
    """Print what parameters are for, and what they may be.

    Raises:
        TurtleactError: if there is no such node or parameter, with the nearest.
    """
    who = await _find(node, owner)
    for each in await _described(node, who, names):
        say_names("".join(f"{line}\n" for line in _description(each)))
    return DONE


async def dump(node: Node, owner: Owner) -> int:
    """Print all parameters of a node as a file that `load` takes.

    Raises:
        TurtleactError: if there is no such node.
    """
    who = await _find(node, owner)
    names = await _names(node, who, ())
    tree: dict[str, object] = {}
    for name, value in zip(names, await _values(node, who, names), strict=True):
        _insert(tree, name, plain(value))
    say_names("".join(f"{line}\n" for line in block({who: {BELOW: tree}})) + "\n")
    return DONE


async def load(
    node: Node, owner: Owner, parameters: Mapping[str, Mapping[str, ParameterValue]], source: str
) -> int:
    """Set the parameters that a file has for a node; the exit status says if all were taken.

    Args:
        node: A node on the graph.
        owner: Whose they are.
        parameters: What `parameter_values.read_file` has read.
        source: What an error calls the file.

    Raises:
        UsageError: if the file has none for that node.
        TurtleactError: if there is no such node.
    """
    who = await _find(node, owner)
    wanted: dict[str, ParameterValue] = {}
    for key in (WILDCARD, who[1:], who):
        wanted |= parameters.get(key, {})
    if not wanted:
        known = ", ".join(name for name, given in parameters.items() if given)
        others = f", but for {known}" if known else ""
        raise UsageError(f"{source}: has no parameters for {who}{others}")
    given = [Parameter(name, value) for name, value in wanted.items()]
    response = await _ask(node, SetParameters, who, SetParameters.Request(given))
    for name, result in zip(wanted, response.results, strict=True):
        reason = f": {result.reason}" if result.reason else ""
        if result.successful:
            say_names(f"Set parameter {name} successful{reason}\n")
        else:
            note(f"Set parameter {name} failed{reason}")
    return DONE if all(result.successful for result in response.results) else FAILED


# what is asked of a node


async def _find(node: Node, owner: Owner) -> str:
    """The full name of a node that has parameters, once it is there."""
    name = owner.name if owner.name.startswith("/") else f"/{owner.name}"
    async with within(owner.timeout, node.clock):
        while name not in _nodes(node, hidden=owner.hidden):
            await node.transport.wait_for_change()
    known = _nodes(node, hidden=owner.hidden)
    if name not in known:
        raise TurtleactError(f"node '{name}': there is none of that name{names_like(name, known)}")
    if not _has_parameters(node, name):
        raise TurtleactError(
            f"node '{name}' has no parameters: nobody serves {name}/get_parameters"
        )
    return name


def _nodes(node: Node, *, hidden: bool) -> list[str]:
    return [name for name in node.transport.nodes() if hidden or not is_hidden_node(name)]


def _has_parameters(node: Node, name: str) -> bool:
    services = types_by_name(node.transport.endpoints(), "service", hidden=True)
    return f"{name}/get_parameters" in services


async def _ask(node: Node, service_type: ServiceType[Req, Res], owner: str, request: Req) -> Res:
    """Call one of the services of a node's parameters, which is named like its type."""
    words = service_type.type_name.rpartition("/")[2].removesuffix("Parameters").lower()
    client = node.service_client(service_type, f"{owner}/{words}_parameters")
    try:
        await client.wait_for_service(PATIENCE)
        return await client.call(request, PATIENCE)
    finally:
        await client.aclose()


async def _names(node: Node, owner: str, prefixes: Sequence[str]) -> list[str]:
    request = ListParameters.Request(list(prefixes))
    return sorted((await _ask(node, ListParameters, owner, request)).result.names)


async def _values(node: Node, owner: str, names: Sequence[str]) -> list[ParameterValue]:
    """The values of parameters that must be there."""
    response = await _ask(node, GetParameters, owner, GetParameters.Request(list(names)))
    if len(response.values) < len(names):
        await _refuse_unknown(node, owner, names)
    return response.values


async def _described(node: Node, owner: str, names: Sequence[str]) -> list[ParameterDescriptor]:
    """What is known of parameters that must be there."""
    request = DescribeParameters.Request(list(names))
    response = await _ask(node, DescribeParameters, owner, request)
    if len(response.descriptors) < len(names):
        await _refuse_unknown(node, owner, names)
    return response.descriptors


async def _refuse_unknown(node: Node, owner: str, names: Sequence[str]) -> None:
    """Raises for the first parameter that a node has not, with the nearest."""
    known = await _names(node, owner, ())
    for name in names:
        if name not in known:
            hint = names_like(name, known)
            raise TurtleactError(f"node '{owner}' has no parameter '{name}'{hint}")


async def _set_one(
    node: Node, owner: Owner, name: str, value: ParameterValue, done: str, trying: str
) -> int:
    who = await _find(node, owner)
    request = SetParameters.Request([Parameter(name, value)])
    [result] = (await _ask(node, SetParameters, who, request)).results
    reason = f": {result.reason}" if result.reason else ""
    if result.successful:
        say_names(f"{done}{reason}\n")
        return DONE
    known = await _names(node, who, ())
    hint = "" if name in known else names_like(name, known)
    note(f"{trying} parameter failed{reason}{hint}")
    return FAILED


# how it is said


def _description(known: ParameterDescriptor) -> Iterator[str]:
    yield f"Parameter name: {known.name}"
    yield f"  Type: {kind_name(known.type)}"
    if known.description:
        yield f"  Description: {known.description}"
    yield "  Constraints:"
    if known.read_only:
        yield "    Read only: true"
    ranges: list[FloatingPointRange | IntegerRange] = [*known.floating_point_range]
    for bounds in [*ranges, *known.integer_range]:
        yield f"    Min value: {bounds.from_value}"
        yield f"    Max value: {bounds.to_value}"
        if bounds.step:
            yield f"    Step: {bounds.step}"
    if known.additional_constraints:
        yield f"    Additional constraints: {known.additional_constraints}"


def _insert(tree: dict[str, object], name: str, value: object) -> None:
    """Put a value where the dots of its name lead; one that is in the way leaves them in it."""
    first, _, rest = name.partition(".")
    inner = tree.setdefault(first, {}) if rest else None
    if isinstance(inner, dict):
        _insert(inner, rest, value)
    else:
        tree[name] = value
