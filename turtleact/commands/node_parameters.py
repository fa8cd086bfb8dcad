"""Asks nodes for their parameters, and reads the values that users give to parameters.

A node offers its parameters through six services. `ParameterClient` calls them for the verbs of
``param``.

``serve`` takes initial values from ``-p NAME:=VALUE`` and ``--params-file FILE``. As in ROS 2,
``NAME`` may begin with the name of a node (``lab:max_speed``), and a file has a block for each
node. The node name ``/**`` stands for all nodes. If a parameter is given several times, ``-p`` wins
over files, and later options win over earlier ones.

Source: ros2cli ``ros2param/verb/*.py`` and recordings of ROS 2 Jazzy for the order and the words of
the output; rclpy ``parameter.py`` for the parsing of text, and for the file format; the ROS 2
article "ROS Command Line Arguments" and rcl_yaml_param_parser for initial values.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import aclosing
from typing import TYPE_CHECKING, TypeVar

from turtleact.commands.message_text import read_text_file
from turtleact.commands.settings import Override, Owner, quoted
from turtleact.errors import InvalidParameter, TurtleactError, UsageError
from turtleact.interfaces import Message
from turtleact.interfaces.definition import did_you_mean, names_like
from turtleact.interfaces.standard.rcl_interfaces.msg import (
    Parameter,
    ParameterType,
    ParameterValue,
    SetParametersResult,
)
from turtleact.interfaces.standard.rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
)
from turtleact.interfaces.text import Document, block, tree_of
from turtleact.node.parameter_rules import KINDS, fitted, flattened, out_of_range, value_of
from turtleact.tasks.clock import within
from turtleact.transports.graph import is_hidden_node, types_by_name

if TYPE_CHECKING:
    from turtleact.interfaces.standard.rcl_interfaces.msg import (
        FloatingPointRange,
        IntegerRange,
        ParameterDescriptor,
    )
    from turtleact.node import Node
    from turtleact.node.services import ServiceType

__all__ = [
    "ParameterClient",
    "as_yaml",
    "described",
    "kind_name",
    "of_node",
    "parameter_value",
    "plain",
    "read_file",
    "read_overrides",
    "unheard",
    "values_for",
]

Req = TypeVar("Req", bound=Message)

Res = TypeVar("Res", bound=Message)

PATIENCE = 5.0
"""How long to wait for a node's answer (s, by the clock of the graph)."""

ON_DEMAND = 0.5
"""How long a node may take to open parameter services that a client waits for (s)."""

WILDCARD = "/**"
"""The name that stands for all nodes in a file of parameters."""

BELOW = "ros__parameters"
"""The key that holds a node's parameters in a file of parameters."""


class ParameterClient:
    """Lists, gets, describes and sets the parameters of one node.

    Args:
        node: The node of this process, which sends the requests.
        owner: The full name of the node that has the parameters.
    """

    def __init__(self, node: Node, owner: str) -> None:
        self._node = node
        self.owner = owner

    @classmethod
    async def find(cls, node: Node, owner: Owner) -> ParameterClient:
        """Wait for a node that has parameters.

        Raises:
            TurtleactError: if there is no such node, or it has no parameters. The error suggests
                the nearest name.
        """
        name = owner.name if owner.name.startswith("/") else f"/{owner.name}"
        async with within(owner.timeout, node.clock):
            while name not in _nodes(node, hidden=owner.hidden):
                await node.transport.wait_for_change()
        known = _nodes(node, hidden=owner.hidden)
        if name not in known:
            raise TurtleactError(f"there is no node '{name}'{names_like(name, known)}")
        found = cls(node, name)
        if not await found._has_services():
            raise TurtleactError(
                f"node '{name}' has no parameters: nobody serves {name}/get_parameters"
            )
        return found

    @classmethod
    async def find_all(cls, node: Node, *, hidden: bool) -> list[ParameterClient]:
        """Return a client for each node that has parameters, sorted by name."""
        clients = [cls(node, name) for name in sorted(_nodes(node, hidden=hidden))]
        return [each for each in clients if await each._has_services()]

    async def names(self, prefixes: Sequence[str] = ()) -> list[str]:
        """Return the names of the parameters, sorted; with ``prefixes``, only these groups."""
        request = ListParameters.Request(list(prefixes))
        return sorted((await self._ask(ListParameters, request)).result.names)

    async def values(self, names: Sequence[str]) -> list[ParameterValue]:
        """Return the values of parameters.

        Raises:
            TurtleactError: if the node lacks any of them. The error suggests the nearest name.
        """
        response = await self._ask(GetParameters, GetParameters.Request(list(names)))
        if len(response.values) < len(names):
            await self._refuse_unknown(names)
        return response.values

    async def descriptors(self, names: Sequence[str]) -> list[ParameterDescriptor]:
        """Return the descriptions of parameters. The errors are those of `values`."""
        response = await self._ask(DescribeParameters, DescribeParameters.Request(list(names)))
        if len(response.descriptors) < len(names):
            await self._refuse_unknown(names)
        return response.descriptors

    async def set(self, parameters: Sequence[Parameter]) -> list[SetParametersResult]:
        """Set parameters, and return the node's answers.

        If the node refuses a value, this method adds the allowed range to the reason in the answer,
        or the existing parameter with the most similar name.
        """
        request = SetParameters.Request(list(parameters))
        results = list((await self._ask(SetParameters, request)).results)
        refused = [place for place, result in enumerate(results) if not result.successful]
        known = await self.names() if refused else []
        for place in refused:
            name = parameters[place].name
            if name in known:
                results[place] = await self._set_again(parameters[place], results[place])
            else:
                results[place].reason += names_like(name, known)
        return results

    async def _set_again(
        self, parameter: Parameter, refusal: SetParametersResult
    ) -> SetParametersResult:
        """Convert a refused value to the parameter's type and set it, or explain the refusal."""
        # ROS 2 refuses an integer for a double, although ``2`` can mean nothing else. The node is
        # asked for the parameter's type only after it has refused, so all other cases cost one
        # call.
        [known] = await self.descriptors([parameter.name])
        value, given = parameter.value, value_of(parameter.value)
        if given is not None:  # otherwise it was to be deleted
            value = fitted(parameter.name, given, known.type)
        result = refusal
        if value != parameter.value:
            request = SetParameters.Request([Parameter(parameter.name, value)])
            [result] = (await self._ask(SetParameters, request)).results
        taken = "" if result.successful else out_of_range(known, value)
        if taken[1:] not in result.reason:
            result.reason = f"{result.reason.rstrip('.')}: {taken}" if result.reason else taken
        return result

    async def _has_services(self) -> bool:
        """Whether the node serves its parameters, perhaps only since this client waits for them."""
        service = f"{self.owner}/get_parameters"
        if service in types_by_name(self._node.transport.endpoints(), "service", hidden=True):
            return True
        async with aclosing(self._node.service_client(GetParameters, service)) as client:
            return await client.wait_for_service(ON_DEMAND)

    async def _ask(self, service_type: ServiceType[Req, Res], request: Req) -> Res:
        """Call one of the parameter services. The name of the service follows from its type."""
        words = service_type.type_name.rpartition("/")[2].removesuffix("Parameters").lower()
        service = f"{self.owner}/{words}_parameters"
        async with aclosing(self._node.service_client(service_type, service)) as client:
            await client.wait_for_service(PATIENCE)
            return await client.call(request, PATIENCE)

    async def _refuse_unknown(self, names: Sequence[str]) -> None:
        known = await self.names()
        for name in names:
            if name not in known:
                hint = names_like(name, known)
                raise TurtleactError(f"node '{self.owner}' has no parameter '{name}'{hint}")


def _nodes(node: Node, *, hidden: bool) -> list[str]:
    return [name for name in node.transport.nodes() if hidden or not is_hidden_node(name)]


# texts and files


def parameter_value(text: str) -> ParameterValue:
    """Parse the text of a parameter's value.

    The value is a bool, a number, text, or a list of values of one of these types. A YAML mapping
    counts as text.

    Raises:
        UsageError: if the value is null, or if a list mixes types or has items of another type.
        InvalidMessage: if the text is not YAML.

    >>> parameter_value("150").integer_value, parameter_value("it: is").string_value
    (150, 'it: is')
    """
    value = tree_of(Document(text, "value", "value", allow_nonfinite=True))
    return _message(text if isinstance(value, dict) else value, "value")


def read_file(path: str, *, use_wildcard: bool) -> dict[str, dict[str, ParameterValue]]:
    """Return the values in a file of parameters, keyed by node name and then by parameter name.

    Args:
        path: A YAML file in the format that `as_yaml` makes.
        use_wildcard: Whether to include the block ``/**``, which is for all nodes.

    Raises:
        UsageError: if the file cannot be read, or does not have that format.
        InvalidMessage: if the file is not YAML.
    """
    if not path:
        raise UsageError("FILE: the path is empty")
    text = read_text_file(path, path)
    tree = tree_of(Document(text, "parameters", path, allow_nonfinite=True))
    if not tree or not isinstance(tree, dict):
        problem = "is empty" if tree in ({}, None) else "holds no nodes with their parameters"
        raise UsageError(f"{path}: {problem}: 'param dump' prints such a file")
    found: dict[str, dict[str, ParameterValue]] = {}
    for name, below in tree.items():
        values = below.get(BELOW) if isinstance(below, dict) else None
        if not isinstance(values, dict):
            raise UsageError(f"{path}: {name} has no {BELOW}: 'param dump' prints such a file")
        if use_wildcard or name != WILDCARD:
            found[name] = {key: _message(each, f"{path}: {key}") for key, each in flattened(values)}
    return found


def plain(value: ParameterValue) -> object:
    """Return a parameter's value as a Python object; None if the parameter is not set."""
    found = value_of(value)
    return list(found) if isinstance(found, bytes) else found


def kind_name(number: int) -> str:
    """Return the name of the parameter type with a given number."""
    return KINDS[number].name if number < len(KINDS) else "not set"


def as_yaml(owner: str, names: Sequence[str], values: Sequence[ParameterValue]) -> str:
    """Return the parameters of a node as YAML that `read_file` can read."""
    tree: dict[str, object] = {}
    for name, value in zip(names, values, strict=True):
        _insert(tree, name, plain(value))
    return "".join(f"{line}\n" for line in block({owner: {BELOW: tree}})) + "\n"


def values_for(owner: str, path: str, *, use_wildcard: bool) -> list[Parameter]:
    """Return the values that a file has for a node.

    Raises:
        UsageError: if the file has none for that node. Other errors are those of `read_file`.
    """
    found = read_file(path, use_wildcard=use_wildcard)
    wanted: dict[str, ParameterValue] = {}
    for key in (WILDCARD, owner[1:], owner):
        wanted |= found.get(key, {})
    if not wanted:
        known = ", ".join(name for name, given in found.items() if given)
        others = f", but for {known}" if known else ""
        raise UsageError(f"{path}: has no parameters for {owner}{others}")
    return [Parameter(name, value) for name, value in wanted.items()]


def described(known: ParameterDescriptor) -> Iterator[str]:
    """Yield the lines that describe a parameter."""
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


def read_overrides(files: Sequence[str], assignments: Sequence[str]) -> list[Override]:
    """Read initial values of parameters: first those in files, then those in assignments.

    Raises:
        UsageError: if a file cannot be read or does not have the format of `as_yaml`, or if an
            assignment is malformed.
        InvalidMessage: if a value is not YAML.
    """
    found: list[Override] = []
    for path in files:
        for node, values in read_file(path, use_wildcard=True).items():
            found += [Override(node, name, plain(value)) for name, value in values.items()]
    return found + [_assignment(text) for text in assignments]


def of_node(overrides: Iterable[Override], node: str) -> dict[str, object]:
    """Return the values for one node, keyed by parameter name.

    If a parameter has several values, the last one counts.

    Args:
        overrides: The values, for this node and for others.
        node: The fully qualified name of the node.

    >>> of_node([Override("/**", "a", 1), Override("lab", "a", 2), Override("arm", "a", 3)], "/lab")
    {'a': 2}
    """
    names = (WILDCARD, node, node.removeprefix("/"))
    return {each.name: each.value for each in overrides if each.node in names}


def unheard(overrides: Iterable[Override], node: str, declared: Iterable[str]) -> list[str]:
    """Return messages for the user about values that have no effect.

    A value has no effect if no module declares its parameter. If all values are for other nodes,
    one message names those nodes.

    Args:
        overrides: The values, for this node and for others.
        node: The fully qualified name of the node.
        declared: The names of the parameters that the user's modules declare.
    """
    known, own = set(declared), of_node(overrides, node)
    said = [
        f"no module declares a parameter {quoted(name)}{did_you_mean(name, known)}"
        for name in own
        if name not in known
    ]
    if not own and (others := dict.fromkeys(each.node for each in overrides)):
        named = ", ".join(others)
        said.append(f"the node of this server is {node}, but the parameters are for {named}")
    return said


def _insert(tree: dict[str, object], name: str, value: object) -> None:
    """Insert a value into nested dicts, so that ``a.b`` is the key ``b`` in the dict of ``a``.

    If ``a`` has a value of its own, the key is ``a.b`` instead.
    """
    first, _, rest = name.partition(".")
    inner = tree.setdefault(first, {}) if rest else None
    if isinstance(inner, dict):
        _insert(inner, rest, value)
    else:
        tree[name] = value


def _message(value: object, where: str) -> ParameterValue:
    """Convert a Python value to a ``ParameterValue``."""
    kinds = {type(item) for item in value} if isinstance(value, list) else set()
    try:
        if kinds == {int, float}:
            raise InvalidParameter(where, "its numbers are of two kinds")
        return fitted(where, value, ParameterType.PARAMETER_NOT_SET)
    except InvalidParameter:
        problem = "a bool, a number, text, or a list of values of one kind"
        raise UsageError(f"{where}: a parameter is {problem}, not {value!r}") from None


def _assignment(text: str) -> Override:
    before, separator, value = text.partition(":=")
    node, _, name = before.rpartition(":")
    if not (separator and name and value):
        problem = f"takes NAME:=VALUE, such as max_speed:=2.0, not {quoted(text)}"
        raise UsageError(f"-p {problem}")
    return Override(node or WILDCARD, name, plain(parameter_value(value)))
