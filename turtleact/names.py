"""The rules for graph names: validation, resolution in a namespace, and an action's five endpoints.

All functions are pure. A name consists of parts separated by slashes. A leading ``~`` stands for
the node's fully qualified name, and a leading slash makes the name absolute. Substitutions in
braces are not supported.

Source: the ROS 2 article "Topic and Service name mapping to DDS", and ``rmw/validate_*_name.c``.
"""

from __future__ import annotations

import re

import msgspec

from turtleact.errors import InvalidName

__all__ = [
    "DESCRIBE",
    "EVENT_SUFFIX",
    "PARAMETER_SERVICES",
    "ActionNames",
    "action_names",
    "event_topic",
    "resolve_name",
    "validate_name",
    "validate_node_name",
]

DESCRIBE = "get_type_description"
"""The service that describes the types of a node, after the node's name."""

PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
"""The services for the parameters of a node, after the node's name."""

EVENT_SUFFIX = "/_service_event"
"""The suffix that turns a service's name into the name of the service's event topic."""

#: Each pattern finds a forbidden part of a name. The error shows the match that comes first.
FAULTS = (
    (re.compile(r"\A\Z"), "it is empty"),
    (
        re.compile(r"[^A-Za-z0-9_/~]"),
        "only letters, digits, '_', '/' and a leading '~' are allowed",
    ),
    (re.compile(r"(?<!\A)~"), "'~' is only allowed at the beginning"),
    (re.compile(r"(?<=\A~)[^/]"), "'~' must be followed by a slash"),
    (re.compile(r"(?<=/)/"), "a slash follows a slash"),
    (re.compile(r"(?:(?<=/)|\A)[0-9]"), "a part begins with a digit"),
    (re.compile(r"(?<=_)_"), "an underscore follows an underscore"),
    (re.compile(r"/\Z"), "it ends in a slash"),
)
NODE_FAULTS = (
    (re.compile(r"\A\Z"), "it is empty"),
    (re.compile(r"[^A-Za-z0-9_]"), "only letters, digits and '_' are allowed in a node's name"),
    (re.compile(r"\A[0-9]"), "it begins with a digit"),
)


class ActionNames(msgspec.Struct, frozen=True):
    """The names of an action's endpoints.

    Attributes:
        name: The absolute name of the action.
        send_goal: The service that accepts or rejects goals.
        cancel_goal: The service that cancels goals.
        get_result: The service that returns results.
        feedback: The topic with the feedback of all goals.
        status: The topic with the states of all goals.
    """

    name: str
    send_goal: str
    cancel_goal: str
    get_result: str
    feedback: str
    status: str


def validate_name(name: str) -> None:
    """Check the name of a topic, service or action, relative or absolute.

    A part may begin with an underscore, which hides the name from listings.

    Raises:
        InvalidName: if the name breaks a rule. The error has the position of the first mistake.
    """
    refuse(name, FAULTS)


def validate_node_name(name: str) -> None:
    """Check the name of a node: a single part, without slashes.

    Raises:
        InvalidName: if the name breaks a rule. The error has the position of the first mistake.
    """
    refuse(name, NODE_FAULTS)


def resolve_name(name: str, namespace: str = "/", node: str = "") -> str:
    """Return the absolute form of a name.

    Args:
        name: A relative, absolute or private name. A private name begins with ``~``, as in
            ``~/pose``.
        namespace: The namespace in which a relative or private name is resolved.
        node: The node's name. Only a private name needs it.

    Raises:
        InvalidName: if a name breaks the rules, or if ``name`` is private and ``node`` is empty.

    >>> resolve_name("pose", "/sim"), resolve_name("~/pose", "/sim", "turtle")
    ('/sim/pose', '/sim/turtle/pose')
    """
    validate_name(name)
    if name.startswith("/"):
        return name
    if namespace != "/":
        validate_name(namespace)
    if namespace[0] != "/":
        raise InvalidName(namespace, "a namespace begins with a slash", 0)
    if not name.startswith("~"):
        return f"{namespace.rstrip('/')}/{name}"
    if not node:
        raise InvalidName(name, "'~' stands for a node's name, and there is no node here", 0)
    validate_node_name(node)
    private = f"{namespace.rstrip('/')}/{node}{name[1:]}"
    validate_name(private)  # some legal node names are not legal in a topic name
    return private


def action_names(name: str) -> ActionNames:
    """Return the names of the endpoints that make up an action.

    Args:
        name: The absolute name of the action.

    Raises:
        InvalidName: if the name is not absolute, or breaks the rules.

    >>> action_names("/fibonacci").send_goal
    '/fibonacci/_action/send_goal'
    """
    validate_name(name)
    if name[0] != "/":
        raise InvalidName(name, "an absolute name begins with a slash", 0)
    endpoints = ActionNames.__struct_fields__[1:]
    return ActionNames(name, *(f"{name}/_action/{endpoint}" for endpoint in endpoints))


def refuse(name: str, faults: tuple[tuple[re.Pattern[str], str], ...]) -> None:
    """Raise `InvalidName` for the first mistake in a name, or for a name that is not a string."""
    if not isinstance(name, str):  # a type and a name may have been mixed up
        raise InvalidName(repr(name), "expected text such as 'patrol'", 0)
    found = [(match.start(), problem) for fault, problem in faults if (match := fault.search(name))]
    if found:
        position, problem = min(found)
        raise InvalidName(name, problem, position)


def event_topic(service: str) -> str:
    """Return the name of the topic on which the events of a service are published.

    >>> event_topic("/spawn")
    '/spawn/_service_event'
    """
    return f"{service}{EVENT_SUFFIX}"
