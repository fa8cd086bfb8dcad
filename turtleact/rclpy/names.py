"""Checks names of topics, services, nodes, namespaces and parameters by rclpy's rules.

In rclpy, each of these functions has a module of its own. The import hook of
`turtleact.rclpy.finder` imports this module in place of each of them.

Source: rmw ``validate_*_name.c``; rcl ``expand_topic_name.c``.
"""

from __future__ import annotations

import re

from turtleact.rclpy.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidParameterException,
    InvalidServiceNameException,
    InvalidTopicNameException,
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

FULL_FAULTS = (
    (re.compile(r"\A\Z"), "must not be empty"),
    (re.compile(r"\A[^/]"), "must be absolute: it must begin with a '/'"),
    (
        re.compile(r"[^A-Za-z0-9_/]"),
        "must not contain characters other than letters, digits, '_', '/'",
    ),
    (re.compile(r"(?<=.)/\Z"), "must not end with a '/'"),
    (re.compile(r"(?<=/)/"), "must not contain two '/' in a row"),
    (re.compile(r"(?<=/)[0-9]"), "must not contain parts that must not start with a number"),
)
RELATIVE_FAULTS = (
    (re.compile(r"\A\Z"), "must not be empty"),
    (
        re.compile(r"[^A-Za-z0-9_/~{}]"),
        "must not contain characters other than letters, digits, '_', '/', '~', '{', '}'",
    ),
    (re.compile(r"(?<=.)/\Z"), "must not end with a '/'"),
    (re.compile(r"(?<=/)/"), "must not contain two '/' in a row"),
    (re.compile(r"(?<!\A)~"), "must not contain a '~' except at the beginning"),
    (re.compile(r"(?<=\A~)[^/]"), "must have a '/' after a '~'"),
    (re.compile(r"(?:\A|(?<=/))[0-9]"), "parts must not start with a number"),
    (re.compile(r"\{[^}]*\Z|\A[^{]*\}"), "must not contain a brace without its other half"),
)
NODE_FAULTS = (
    (re.compile(r"\A\Z"), "must not be empty"),
    (re.compile(r"[^A-Za-z0-9_]"), "must not contain characters other than letters, digits, '_'"),
    (re.compile(r"\A[0-9]"), "must not start with a number"),
)

LONGEST = 255
"""The maximum number of characters in a node's name."""


def validate_topic_name(name: str, *, is_service: bool = False) -> bool:
    """Check the name of a topic or service, which may be relative, and return True.

    Raises:
        InvalidTopicNameException: if the name of a topic breaks the rules.
        InvalidServiceNameException: if the name of a service breaks the rules.
    """
    fault = _fault(name, RELATIVE_FAULTS)
    if fault is not None:
        raise _error(is_service)(name, f"{_noun(is_service)} {fault[0]}", fault[1])
    return True


def validate_full_topic_name(name: str, *, is_service: bool = False) -> bool:
    """Check an absolute name, and return True. `validate_topic_name` lists the errors."""
    fault = _fault(name, FULL_FAULTS)
    if fault is not None:
        raise _error(is_service)(name, f"{_noun(is_service)} {fault[0]}", fault[1])
    return True


def validate_namespace(namespace: str) -> bool:
    """Check a namespace, and return True.

    Raises:
        InvalidNamespaceException: if the namespace breaks the rules.
    """
    fault = _fault(namespace, FULL_FAULTS)
    if fault is not None:
        raise InvalidNamespaceException(namespace, f"namespace {fault[0]}", fault[1])
    return True


def validate_node_name(node_name: str) -> bool:
    """Check the name of a node, and return True.

    Raises:
        InvalidNodeNameException: if the name breaks the rules.
    """
    fault = _fault(node_name, NODE_FAULTS)
    if fault is None and len(node_name) > LONGEST:
        fault = f"must not be longer than {LONGEST} characters", LONGEST
    if fault is not None:
        raise InvalidNodeNameException(node_name, f"node name {fault[0]}", fault[1])
    return True


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
    if _fault(topic_name, RELATIVE_FAULTS) is not None:
        raise ValueError(f"topic name is invalid: '{topic_name}'")
    if _fault(node_name, NODE_FAULTS) is not None:
        raise ValueError(f"node name is invalid: '{node_name}'")
    if _fault(node_namespace, FULL_FAULTS) is not None:
        raise ValueError(f"namespace is invalid: '{node_namespace}'")
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


def _fault(name: str, faults: tuple[tuple[re.Pattern[str], str], ...]) -> tuple[str, int] | None:
    """Return the first fault of a name, and where it begins; None if the name has no fault."""
    for pattern, problem in faults:
        match = pattern.search(name)
        if match is not None:
            return problem, match.start()
    return None


def _noun(is_service: bool) -> str:
    return "service name" if is_service else "topic name"


def _error(is_service: bool) -> type[InvalidTopicNameException] | type[InvalidServiceNameException]:
    return InvalidServiceNameException if is_service else InvalidTopicNameException
