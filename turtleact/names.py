"""Graph names: what is one, what it means in a namespace, and which five make up an action.

Pure text. A name is tokens with slashes between; ``~`` at its beginning stands for the node's own
name, a slash there for the root. Substitutions in braces are not taken.

Source: the ROS 2 article "Topic and Service name mapping to DDS", and ``rmw/validate_*_name.c``.
"""

from __future__ import annotations

import re

import msgspec

from turtleact.errors import InvalidName

__all__ = ["ActionNames", "action_names", "resolve_name", "validate_name", "validate_node_name"]

#: What a name must not hold: where it stands, and why. The first of them that matches is told.
FAULTS = (
    (re.compile(r"\A\Z"), "it is empty"),
    (
        re.compile(r"[^A-Za-z0-9_/~]"),
        "only letters, digits, '_', '/' and a leading '~' are allowed",
    ),
    (re.compile(r"(?<!\A)~"), "'~' stands at the beginning only"),
    (re.compile(r"(?<=\A~)[^/]"), "'~' is followed by a slash"),
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
        name: The action's own, absolute.
        send_goal: The service that takes goals.
        cancel_goal: The service that cancels them.
        get_result: The service that answers with results.
        feedback: The topic of feedback.
        status: The topic of the states of all goals.
    """

    name: str
    send_goal: str
    cancel_goal: str
    get_result: str
    feedback: str
    status: str


def validate_name(name: str) -> None:
    """Refuses what is no name of a topic, service or action, relative or absolute.

    A part that begins with an underscore hides the name; it is legal.

    Raises:
        InvalidName: with the position of the first wrong character.
    """
    refuse(name, FAULTS)


def validate_node_name(name: str) -> None:
    """Refuses what is no name of a node: one part, without slashes.

    Raises:
        InvalidName: with the position of the first wrong character.
    """
    refuse(name, NODE_FAULTS)


def resolve_name(name: str, namespace: str = "/", node: str = "") -> str:
    """The absolute form of a name.

    Args:
        name: Relative, absolute or private (``~/pose``).
        namespace: What a relative name is put into.
        node: The node that a ``~`` stands for.

    Raises:
        InvalidName: if a part breaks the rules, or a ``~`` stands for no node.

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
    validate_name(private)  # a node's name may hold what a topic's may not
    return private


def action_names(name: str) -> ActionNames:
    """The endpoints that make up an action of this absolute name.

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
    """Raises for the fault that comes first in the name, or if it is no text at all."""
    if not isinstance(name, str):  # a type and a name may have been mixed up
        raise InvalidName(repr(name), "expected text such as 'patrol'", 0)
    found = [(match.start(), problem) for fault, problem in faults if (match := fault.search(name))]
    if found:
        position, problem = min(found)
        raise InvalidName(name, problem, position)
