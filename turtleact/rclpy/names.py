"""Checks names of topics, services, nodes, namespaces and parameters by rclpy's rules.

In rclpy, each of these functions has a module of its own. The import hook of
`turtleact.rclpy.finder` imports this module in place of each of them.

Source: rmw ``validate_*_name.c``; rcl ``expand_topic_name.c``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TypeAlias

from turtleact.rclpy.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidParameterException,
    InvalidServiceNameException,
    InvalidTopicNameException,
    NameOfKind,
    NameValidationException,
)

__all__ = [
    "HIDDEN_TOPIC_PREFIX",
    "TOPIC_SEPERATOR_STRING",
    "expand_topic_name",
    "topic_or_service_is_hidden",
    "validate_full_topic_name",
    "validate_namespace",
    "validate_node_name",
    "validate_parameter_name",
    "validate_topic_name",
]

TOPIC_SEPERATOR_STRING = "/"
HIDDEN_TOPIC_PREFIX = "_"

Fault: TypeAlias = tuple[re.Pattern[str], str]
"""A pattern that finds a forbidden part of a name, and what is wrong with it."""

EMPTY: Fault = re.compile(r"\A\Z"), "must not be empty"
SLASHES: tuple[Fault, ...] = (
    (re.compile(r"(?<=.)/\Z"), "must not end with a '/'"),
    (re.compile(r"(?<=/)/"), "must not contain two '/' in a row"),
)
FULL_FAULTS: tuple[Fault, ...] = (
    EMPTY,
    (re.compile(r"\A[^/]"), "must be absolute: it must begin with a '/'"),
    (
        re.compile(r"[^A-Za-z0-9_/]"),
        "must not contain characters other than letters, digits, '_', '/'",
    ),
    *SLASHES,
    (re.compile(r"(?<=/)[0-9]"), "must not contain parts that must not start with a number"),
)
RELATIVE_FAULTS: tuple[Fault, ...] = (
    EMPTY,
    (
        re.compile(r"[^A-Za-z0-9_/~{}]"),
        "must not contain characters other than letters, digits, '_', '/', '~', '{', '}'",
    ),
    *SLASHES,
    (re.compile(r"(?<!\A)~"), "must not contain a '~' except at the beginning"),
    (re.compile(r"(?<=\A~)[^/]"), "must have a '/' after a '~'"),
    (re.compile(r"(?:\A|(?<=/))[0-9]"), "parts must not start with a number"),
    (re.compile(r"\{[^}]*\Z|\A[^{]*\}"), "must not contain a brace without its other half"),
)
NODE_FAULTS: tuple[Fault, ...] = (
    EMPTY,
    (re.compile(r"[^A-Za-z0-9_]"), "must not contain characters other than letters, digits, '_'"),
    (re.compile(r"\A[0-9]"), "must not start with a number"),
    (re.compile(r"(?<=\A.{255})."), "must not be longer than 255 characters"),
)


def validate_topic_name(name: str, *, is_service: bool = False) -> bool:
    """Check the name of a topic or service, which may be relative, and return True.

    Raises:
        InvalidTopicNameException: if the name of a topic breaks the rules.
        InvalidServiceNameException: if the name of a service breaks the rules.
    """
    return _check(name, RELATIVE_FAULTS, _error(is_service))


def validate_full_topic_name(name: str, *, is_service: bool = False) -> bool:
    """Check an absolute name, and return True. `validate_topic_name` lists the errors."""
    return _check(name, FULL_FAULTS, _error(is_service))


def validate_namespace(namespace: str) -> bool:
    """Check a namespace, and return True.

    Raises:
        InvalidNamespaceException: if the namespace breaks the rules.
    """
    return _check(namespace, FULL_FAULTS, InvalidNamespaceException)


def validate_node_name(node_name: str) -> bool:
    """Check the name of a node, and return True.

    Raises:
        InvalidNodeNameException: if the name breaks the rules.
    """
    return _check(node_name, NODE_FAULTS, InvalidNodeNameException)


def validate_parameter_name(name: str) -> bool:
    """Check the name of a parameter, and return True.

    Raises:
        InvalidParameterException: if the name is empty.
    """
    if not name:
        raise InvalidParameterException(name)
    return True


def expand_topic_name(topic_name: str, node_name: str, node_namespace: str) -> str:
    """Return the absolute form of a name of a topic or service.

    Args:
        topic_name: The name. A ``~`` at the beginning stands for the full name of the node,
            ``{node}`` for its name, and ``{ns}`` or ``{namespace}`` for its namespace.
        node_name: The name of the node.
        node_namespace: The namespace of the node.

    Raises:
        ValueError: if a name breaks the rules, or ``topic_name`` has any other text in braces.
    """
    try:
        validate_topic_name(topic_name)
        validate_node_name(node_name)
        validate_namespace(node_namespace)
    except NameValidationException as error:
        raise ValueError(str(error)) from error
    base = node_namespace.rstrip("/")
    known = {"node": node_name, "ns": node_namespace, "namespace": node_namespace}

    def substitute(match: re.Match[str]) -> str:
        if match[1] not in known:
            raise ValueError(f"unknown substitution: '{match[0]}'")
        return known[match[1]]

    name = re.sub(r"\{([^}]*)\}", substitute, topic_name)
    if name.startswith("~"):
        return f"{base}/{node_name}{name[1:]}"
    return name if name.startswith("/") else f"{base}/{name}"


def topic_or_service_is_hidden(name: str) -> bool:
    """Whether a part of a name begins with an underscore."""
    return any(part.startswith(HIDDEN_TOPIC_PREFIX) for part in name.split("/") if part)


def _check(name: str, faults: Iterable[Fault], error: type[NameOfKind]) -> bool:
    """Raise an error about the first fault of a name. Return True if the name has no fault."""
    for pattern, problem in faults:
        match = pattern.search(name)
        if match is not None:
            raise error(name, f"{error.KIND} {problem}", match.start())
    return True


def _error(is_service: bool) -> type[NameOfKind]:
    return InvalidServiceNameException if is_service else InvalidTopicNameException
