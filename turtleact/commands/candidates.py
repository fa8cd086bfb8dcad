"""What an argument may be: names on the graph, their types, messages to begin with, goals, modules.

For the completion of command lines: all is asked anew, as fast as can be, and nothing is started.
Whatever is not to be had raises; the one who asks gives up then.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from turtleact.commands.graph_names import is_hidden_node, types_by_name
from turtleact.errors import TurtleactError, UnknownInterface

if TYPE_CHECKING:
    from turtleact.commands.graph_names import Kind
    from turtleact.commands.verbs.arguments import Reach
    from turtleact.node import Node
    from turtleact.transports.rmw_zenoh.keys import Graph

__all__ = [
    "EMBEDDED",
    "endpoint_types",
    "goals",
    "interfaces",
    "nodes",
    "packages",
    "parameters",
    "prototype",
    "targets",
]

EMBEDDED: Final = {
    "/command_turtle": ("patrol_interfaces/action/PatrolCommandInterface",),
    "/fibonacci": (
        "action_tutorials_interfaces/action/Fibonacci",
        "example_interfaces/action/Fibonacci",
    ),
    "/go_to": ("turtleact_interfaces/action/GoTo",),
    "/patrol": ("turtleact_interfaces/action/Patrol",),
    "/turtle1/rotate_absolute": ("turtlesim/action/RotateAbsolute",),
    "/world/simulate_steps": ("simulation_interfaces/action/SimulateSteps",),
}
"""The actions of the world that ``send-goal`` starts if it finds no graph, with their types."""

LARGEST: Final = 100_000
"""A module with more characters is not looked into."""

_DECLARING: Final = re.compile(r"\bturtleact\b")


# the graph


def endpoint_types(where: Reach | None, kind: Kind) -> dict[str, tuple[str, ...]]:
    """The names of a kind on a graph, with their types.

    Args:
        where: The graph; None for the embedded world.
        kind: What goes by the names. Where no graph is said nor found, actions are those of the
            embedded world.

    Raises:
        TurtleactError: if there is no such graph in reach.
    """
    if where is None:
        return EMBEDDED if kind == "action" else {}
    try:
        endpoints = _census(where).endpoints()
    except TurtleactError:
        if kind != "action" or where.connect:
            raise
        return EMBEDDED
    return types_by_name(endpoints, kind)


def nodes(where: Reach) -> list[str]:
    """The nodes of a graph that are not hidden.

    Raises:
        TurtleactError: if there is no such graph in reach.
    """
    return sorted({name for name in _census(where).nodes() if not is_hidden_node(name)})


def goals(where: Reach) -> dict[str, str]:
    """The ids of the goals that servers hold, with their action and state; the newest first.

    Raises:
        TurtleactError: if there is no such graph in reach.
    """
    from turtleact.commands import graph
    from turtleact.commands.held_goals import held_goals, served_actions
    from turtleact.commands.interrupts import Interrupts

    found: dict[str, str] = {}

    async def look(node: Node) -> int:
        goals, _ = await held_goals(node, served_actions(node, None))
        for goal in reversed(goals):
            found[goal.goal_id.hex()] = f"{goal.action} {goal.status.name}"
        return 0

    graph.run(where, look, Interrupts())
    return found


def parameters(where: Reach, owner: str) -> list[str]:
    """The names of a node's parameters.

    Raises:
        TurtleactError: if there is no such graph or node, or it has none.
    """
    from turtleact.commands import graph
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.node_parameters import names_of

    found: list[str] = []

    async def look(node: Node) -> int:
        found.extend(await names_of(node, owner))
        return 0

    graph.run(where, look, Interrupts())
    return found


def _census(where: Reach) -> Graph:
    from turtleact.commands.locks import mode_of
    from turtleact.transports.rmw_zenoh.session import census

    locks = where.locks()
    mode = mode_of(where.connect, locks)
    return census(where.connect or None, where.domain, locks.settings(), mode)


# interfaces


def interfaces(kind: str | None, folder: str | None) -> list[str]:
    """The names of all interfaces of a kind (``msg``, ``srv``, ``action``), or of all kinds."""
    from turtleact.commands.interfaces import make_known
    from turtleact.interfaces import known_interfaces

    make_known(folder)
    return [name for name in known_interfaces() if kind in (None, name.split("/")[1])]


def packages(folder: str | None) -> list[str]:
    """The packages that have interfaces."""
    return sorted({name.partition("/")[0] for name in interfaces(None, folder)})


def prototype(type_name: str, folder: str | None) -> str:
    """A message of an interface's defaults on one line: of an action the goal, and so on.

    Raises:
        TurtleactError: if the interface is not known.
    """
    from turtleact.commands.interfaces import first_message, make_known
    from turtleact.interfaces import get_interface, to_dict
    from turtleact.interfaces.text import flow

    try:  # most are found without all that `make_known` imports
        get_interface(type_name)
    except UnknownInterface:
        make_known(folder)
    return flow(to_dict(first_message(type_name)))


# modules


def targets(begun: str) -> Iterator[str]:
    """The modules in the working directory that name turtleact; behind a colon their actions.

    Nothing is imported: a function with a decorator ``action`` counts, whosever that is.

    Args:
        begun: What stands there already.
    """
    name, separator, _ = begun.partition(":")
    if separator:
        yield from (f"{name}:{each}" for each in _actions(Path(*name.split("."))))
        return
    for path in sorted(Path().glob("*.py")):
        if path.stem.isidentifier() and _DECLARING.search(_text(path)):
            yield path.stem


def _actions(module: Path) -> Iterator[str]:
    file = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
    for statement in ast.parse(_text(file)).body:
        if isinstance(statement, ast.AsyncFunctionDef | ast.FunctionDef) and any(
            re.search(r"\baction\(", ast.unparse(each)) for each in statement.decorator_list
        ):
            yield statement.name


def _text(path: Path) -> str:
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(LARGEST)
