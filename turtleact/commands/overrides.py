"""First values of parameters from the command line: ``-p NAME:=VALUE`` and ``--params-file FILE``.

As in ROS 2, ``NAME`` may have the name of a node before it (``lab:max_speed``), a file has a block
for each node, and ``/**`` stands for all nodes. Values in files are set first, in the order of the
files, then those of ``-p``.

Source: the ROS 2 article "ROS Command Line Arguments"; rcl_yaml_param_parser.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from turtleact.commands.node_parameters import WILDCARD, parameter_value, plain, read_file
from turtleact.commands.settings import quoted
from turtleact.errors import UsageError
from turtleact.interfaces.definition import did_you_mean

__all__ = ["Override", "of_node", "read_overrides", "unheard"]


class Override(NamedTuple):
    """The first value of one parameter.

    Attributes:
        node: The name of the node, with or without its slash; ``/**`` for any.
        name: The name of the parameter.
        value: The value.
    """

    node: str
    name: str
    value: object


def read_overrides(files: Sequence[str], assignments: Sequence[str]) -> list[Override]:
    """Read files of parameters, then single assignments.

    Raises:
        UsageError: if a file cannot be read or has another form, or an assignment is malformed.
        InvalidMessage: if a value is not YAML.
    """
    found: list[Override] = []
    for path in files:
        for node, values in read_file(path, use_wildcard=True).items():
            found += [Override(node, name, plain(value)) for name, value in values.items()]
    return found + [_assignment(text) for text in assignments]


def of_node(overrides: Iterable[Override], node: str) -> dict[str, object]:
    """The values for a node, by the names of the parameters; later ones count.

    Args:
        overrides: Those of all nodes.
        node: The fully qualified name of the node.

    >>> of_node([Override("/**", "a", 1), Override("lab", "a", 2), Override("arm", "a", 3)], "/lab")
    {'a': 2}
    """
    names = (WILDCARD, node, node.removeprefix("/"))
    return {each.name: each.value for each in overrides if each.node in names}


def unheard(overrides: Iterable[Override], node: str, declared: Iterable[str]) -> list[str]:
    """What to tell the user about values that set nothing.

    Args:
        overrides: All of them.
        node: The fully qualified name of the node.
        declared: The parameters that the user's modules declare.
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


def _assignment(text: str) -> Override:
    before, separator, value = text.partition(":=")
    node, _, name = before.rpartition(":")
    if not (separator and name and value):
        problem = f"takes NAME:=VALUE, such as max_speed:=2.0, not {quoted(text)}"
        raise UsageError(f"-p {problem}")
    return Override(node or WILDCARD, name, plain(parameter_value(value)))
