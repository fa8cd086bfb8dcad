"""Parses the arguments of a program that are for ROS: those between ``--ros-args`` and ``--``.

Source: the ROS 2 design article "ROS command line arguments"; rcl ``arguments.c`` and its
``rcl_yaml_param_parser``.
"""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from turtleact.errors import InvalidMessage
from turtleact.node.parameter_rules import flattened
from turtleact.rclpy.exceptions import RCLError, UnknownROSArgsError

__all__ = [
    "Arguments",
    "ParameterRule",
    "RemapRule",
    "arguments_of",
    "parse_arguments",
    "parse_value",
    "read_parameters",
    "split_arguments",
]

BEGIN, END = "--ros-args", "--"

WITH_VALUE = {
    "-r": "remap",
    "--remap": "remap",
    "-p": "param",
    "--param": "param",
    "--params-file": "params-file",
    "--log-level": "log-level",
    "--log-config-file": "ignored",
    "--log-file-name": "ignored",
    "-e": "ignored",
    "--enclave": "ignored",
}
ALONE = re.compile(r"--(enable|disable)-(rosout|stdout|external-lib)-logs")

LEVELS = logging.getLevelNamesMapping()

PARAMETERS = "ros__parameters"


class RemapRule(msgspec.Struct, frozen=True):
    """A rule that renames a topic, service, node or namespace, such as ``node:from:=to``.

    Attributes:
        node: The name of the node that the rule is for; empty for all nodes.
        source: The name to replace; ``__node`` for the name of the node, ``__ns`` for its
            namespace.
        target: The new name.
    """

    node: str
    source: str
    target: str


class ParameterRule(msgspec.Struct, frozen=True):
    """Values of parameters for the nodes that match a pattern.

    Attributes:
        pattern: A full name of a node, perhaps with ``*`` and ``**``.
        values: The values of the parameters, by name.
    """

    pattern: str
    values: dict[str, object]


class Arguments(msgspec.Struct, frozen=True):
    """The ROS arguments of a program's command line.

    Attributes:
        remaps: The rules for renaming, in order. The first rule that matches is applied.
        parameters: Values of parameters. Later values replace earlier ones.
        log_levels: Pairs of a logger's name and its level. The empty name means the root logger.
        flags: Options without a value.
    """

    remaps: tuple[RemapRule, ...] = ()
    parameters: tuple[ParameterRule, ...] = ()
    log_levels: tuple[tuple[str, int], ...] = ()
    flags: frozenset[str] = frozenset()

    def node_name(self, name: str) -> str:
        """Return the name of a node after remapping."""
        return self._special(name, ("__node", "__name"), name)

    def namespace(self, namespace: str, name: str) -> str:
        """Return the namespace of a node after remapping."""
        return self._special(name, ("__ns",), namespace)

    def remap(self, full_name: str, node: str, namespace: str) -> str:
        """Return the full name of a topic or service after remapping.

        Args:
            full_name: The full name before remapping.
            node: The name of the node that uses the topic or service.
            namespace: The namespace of the node.
        """
        for rule in self.remaps:
            if rule.source.startswith("__") or rule.node not in ("", node):
                continue
            if _expanded(rule.source, node, namespace) == full_name:
                return _expanded(rule.target, node, namespace)
        return full_name

    def parameters_for(self, full_name: str) -> dict[str, object]:
        """Return the values of the parameters for a node, by name."""
        found: dict[str, object] = {}
        for rule in self.parameters:
            if _matches(rule.pattern, full_name):
                found |= rule.values
        return found

    def _special(self, node: str, sources: tuple[str, ...], otherwise: str) -> str:
        for rule in self.remaps:
            if rule.source in sources and rule.node in ("", node):
                return rule.target
        return otherwise


def parse_arguments(args: Sequence[str] | None) -> Arguments:
    """Parse the ROS arguments of a program. None means ``sys.argv``.

    Raises:
        UnknownROSArgsError: if a ROS argument is unknown.
        RCLError: if the value of an option is missing or malformed.
    """
    remaps: list[RemapRule] = []
    parameters: list[ParameterRule] = []
    levels: list[tuple[str, int]] = []
    flags, unknown = set[str](), list[str]()
    words = iter(split_arguments(sys.argv if args is None else args)[1])
    for word in words:
        kind = WITH_VALUE.get(word)
        if kind is None:
            (flags.add if ALONE.fullmatch(word) else unknown.append)(word)
            continue
        value = next(words, None)
        if value is None:
            raise RCLError(f"Failed to parse ROS arguments: no value after {word}")
        if kind == "remap":
            remaps.append(_remap(value))
        elif kind == "param":
            parameters.append(_parameter(value))
        elif kind == "params-file":
            parameters += _read_file(value)
        elif kind == "log-level":
            levels.append(_level(value))
    if unknown:
        raise UnknownROSArgsError(f"Found unknown ROS arguments: {unknown}")
    return Arguments(tuple(remaps), tuple(parameters), tuple(levels), frozenset(flags))


def arguments_of(own: Sequence[str] | None, shared: Arguments, *, use_shared: bool) -> Arguments:
    """Return the arguments that apply to a node. The node's own arguments take precedence.

    Args:
        own: The node's own arguments, in the form of a command line. None means that the node has
            none.
        shared: The arguments of the program.
        use_shared: Whether to include the arguments of the program.
    """
    first = Arguments() if own is None else parse_arguments(own)
    rest = shared if use_shared else Arguments()
    return Arguments(
        (*first.remaps, *rest.remaps),
        (*rest.parameters, *first.parameters),
        (*rest.log_levels, *first.log_levels),
        first.flags | rest.flags,
    )


def split_arguments(args: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the arguments that are not for ROS, and those that are."""
    split: tuple[list[str], list[str]] = [], []
    is_for_ros = False
    for arg in args:
        if arg == BEGIN or (is_for_ros and arg == END):
            is_for_ros = arg == BEGIN
        else:
            split[is_for_ros].append(arg)
    return split


def parse_value(text: str) -> object:
    """Read a text as YAML, and return its value.

    Raises:
        RCLError: if the text is malformed.
    """
    try:
        return _tree(text, "value", "value")
    except InvalidMessage as error:
        raise RCLError(f"Failed to parse ROS arguments: {error}") from error


def read_parameters(path: Path) -> list[ParameterRule]:
    """Read a file of parameters: ``NODE: {ros__parameters: {NAME: VALUE}}``.

    Raises:
        RCLError: if the file is malformed.
        OSError: if the file cannot be read.
    """
    try:
        tree = _tree(path.read_text("utf-8"), "parameters", str(path))
    except (UnicodeDecodeError, InvalidMessage) as error:
        raise RCLError(f"Failed to parse ROS arguments: {path}: {error}") from error
    if not isinstance(tree, dict):
        raise RCLError(f"Failed to parse ROS arguments: {path} has no parameters")
    return list(_rules(tree, ""))


def _tree(text: str, what: str, path: str) -> object:
    from turtleact.interfaces.text import Document, tree_of  # YAML is slow to import

    return _plain(tree_of(Document(text, what, path, allow_nonfinite=True)))


def _read_file(path: str) -> list[ParameterRule]:
    try:
        return read_parameters(Path(path))
    except OSError as error:
        raise RCLError(f"Failed to parse ROS arguments: {path}: {error.strerror}") from error


def _remap(text: str) -> RemapRule:
    before, separator, target = text.partition(":=")
    if not separator or not before or not target:
        raise RCLError(f"Failed to parse ROS arguments: {text!r} is no remap rule from:=to")
    before = re.sub(r"^(rostopic|rosservice)://", "", before)
    node, _, source = before.rpartition(":")
    return RemapRule(node, source, target)


def _parameter(text: str) -> ParameterRule:
    before, separator, value = text.partition(":=")
    if not separator or not before:
        raise RCLError(f"Failed to parse ROS arguments: {text!r} is no parameter name:=value")
    node, _, name = before.rpartition(":")
    pattern = "/**" if not node else node if node.startswith("/") else f"/**/{node}"
    return ParameterRule(pattern, {name: parse_value(value)})


def _level(text: str) -> tuple[str, int]:
    name, separator, level = text.rpartition(":=")
    if level.upper() not in LEVELS:
        raise RCLError(f"Failed to parse ROS arguments: {level!r} is no log level")
    return (name if separator else ""), LEVELS[level.upper()]


def _rules(tree: Mapping[str, object], path: str) -> Iterator[ParameterRule]:
    for key, value in tree.items():
        if not isinstance(value, dict):
            raise RCLError(
                f"Failed to parse ROS arguments: '{key}' has no '{PARAMETERS}' around its values"
            )
        if key == PARAMETERS:
            yield ParameterRule(path or "/**", dict(flattened(value)))
        else:
            joined = f"{path.rstrip('/')}/{key.strip('/')}"
            yield from _rules(value, joined)


def _plain(value: object) -> object:
    """Replace each `Spelled` value of a parsed file by its text, or ``null`` by None."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, bool | int | float | str):
        return value
    return None if str(value) == "null" else str(value)


def _expanded(name: str, node: str, namespace: str) -> str:
    base = namespace.rstrip("/")
    if name.startswith("~"):
        return f"{base}/{node}{name[1:]}"
    return name if name.startswith("/") else f"{base}/{name}"


def _matches(pattern: str, full_name: str) -> bool:
    """Whether a node's full name matches a pattern.

    ``*`` stands for one part between slashes, ``**`` for any number of parts.
    """
    parts = []
    for part in pattern.strip("/").split("/"):
        parts.append({"**": r"(?:/[^/]+)*", "*": r"/[^/]+"}.get(part, re.escape(f"/{part}")))
    return re.fullmatch("".join(parts), full_name) is not None
