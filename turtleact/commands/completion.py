"""Completes words for the Tab key: functions for Typer's ``autocompletion=``.

Each completion function takes Typer's context, which holds the arguments typed so far, and the word
that the user has begun. Each completion function returns the possible values. Typer drops the
values that do not begin with the user's word, and passes the others to the shell. The functions
look the values up again at each press of Tab, but start no server and no world. If a completion
function fails, `turtleact.cli` prints nothing, because an error would disturb the user's input.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

import typer

from turtleact.commands.settings import ConnectOptions, Owner
from turtleact.errors import TurtleactError, UnknownInterface

if TYPE_CHECKING:
    from turtleact.node import Node
    from turtleact.transports.graph import Kind
    from turtleact.transports.rmw_zenoh.wire import Graph

__all__ = [
    "EMBEDDED",
    "SUFFIXES",
    "actions",
    "executables",
    "goal_ids",
    "interfaces",
    "messages",
    "nodes",
    "packages",
    "parameters",
    "runnable_packages",
    "services",
    "targets",
    "topics",
    "types",
    "words",
]

Candidates: TypeAlias = list[str] | list[tuple[str, str]]
"""Possible values, or pairs of a value and a short description."""

Complete: TypeAlias = Callable[[typer.Context, str], Candidates]

SUFFIXES: Final = {"action": "action", "service": "srv", "topic": "msg"}
"""The middle part of type names, such as ``srv`` in ``pkg/srv/Name``, by kind."""

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
"""The actions, with their types, of the world that ``send-goal`` starts if it finds no graph."""

_FOR_BASH: Final = str.maketrans({each: f"\\{each}" for each in '"\\$`'})


def words(*known: str) -> Callable[[], list[str]]:
    """Return a completion function that offers the words ``known``."""
    return lambda: list(known)


# the graph


def _names(kind: Kind) -> Complete:
    """Return a completion function for the actions, services or topics on the graph.

    If there is no graph, it offers the actions of the embedded world.
    """

    def complete(ctx: typer.Context, incomplete: str) -> Candidates:
        return _as_begun(_types_by_name(ctx, kind), incomplete)

    return complete


actions = _names("action")
services = _names("service")
topics = _names("topic")


def nodes(ctx: typer.Context, incomplete: str) -> Candidates:
    """Offer the nodes on the graph that are not hidden."""
    from turtleact.transports.graph import is_hidden_node

    names = {name for name in _look(_reach(ctx)).nodes() if not is_hidden_node(name)}
    return _as_begun(sorted(names), incomplete)


def parameters(ctx: typer.Context, incomplete: str) -> Candidates:  # noqa: ARG001  # Typer filters
    """Offer the parameters of the node given earlier on the command line."""
    from turtleact.commands import graph
    from turtleact.commands.node_parameters import ParameterClient

    found: list[str] = []

    async def look(node: Node) -> int:
        client = await ParameterClient.find(node, Owner(ctx.params["node_name"]))
        found.extend(await client.names())
        return 0

    graph.run(_reach(ctx), look)
    return found


def goal_ids(ctx: typer.Context, incomplete: str) -> Candidates:
    """Offer the ids of the goals that servers hold, newest first.

    If the command line has ``--all`` or ``--before``, offer the names of actions instead.
    """
    if ctx.params.get("all_") or ctx.params.get("before"):
        return _as_begun(_types_by_name(ctx, "action"), incomplete)
    from turtleact.commands import graph
    from turtleact.commands.held_goals import held_goals

    found: dict[str, str] = {}

    async def look(node: Node) -> int:
        goals, _ = await held_goals(node)
        for goal in reversed(goals):
            found[goal.goal_id.hex()] = f"{goal.action} {goal.status.name}"
        return 0

    graph.run(_reach(ctx), look)
    return list(found.items())


# interfaces


def types(kind: Kind, *, of_name: bool = True) -> Complete:
    """Return a completion function for the type of an action, service or topic.

    The function offers the types that the graph has for the name given earlier on the command line.
    If the graph has no type for the name, or ``of_name`` is False, the function offers all
    interfaces of the kind.
    """

    def complete(ctx: typer.Context, incomplete: str) -> Candidates:  # noqa: ARG001  # as above
        known: tuple[str, ...] = ()
        if of_name:
            name = "/" + str(ctx.params["name"]).removeprefix("/")
            known = _types_by_name(ctx, kind).get(name, ())
        return list(known) or _interfaces(ctx, SUFFIXES[kind])

    return complete


def interfaces(ctx: typer.Context, incomplete: str) -> Candidates:  # noqa: ARG001  # as above
    """Offer the names of all interfaces."""
    return _interfaces(ctx)


def packages(ctx: typer.Context, incomplete: str) -> Candidates:  # noqa: ARG001  # as above
    """Offer the names of all packages that have interfaces."""
    return sorted({name.partition("/")[0] for name in _interfaces(ctx)})


def messages(ctx: typer.Context, incomplete: str) -> Candidates:  # as above
    """Offer one message, with default values, of the type given earlier on the command line."""
    from turtleact.commands.message_text import first_message, make_found, make_known
    from turtleact.interfaces import get_interface, to_dict
    from turtleact.interfaces.text import flow

    type_name = ctx.params["type_name"]
    make_found(_folder(ctx), is_silent=True)
    try:  # most interfaces are known without what `make_known` imports
        get_interface(type_name)
    except UnknownInterface:
        make_known(_folder(ctx), is_silent=True)
        from turtleact.interfaces.learned import cached, remember

        for each in cached(type_name):
            remember(each)
    text = flow(to_dict(first_message(type_name)))
    # Only bash inserts a value as it is, so there the quotes must be part of it.
    is_bash = os.environ.get("_TURTLEACT_COMPLETE") == "complete_bash"
    return [f'"{text.translate(_FOR_BASH)}"' if is_bash and not incomplete else text]


# modules


def targets(ctx: typer.Context, incomplete: str) -> Candidates:  # noqa: ARG001  # as above
    """Offer the Python files, those of the working directory as modules."""
    folder, slash, begun = incomplete.rpartition("/")
    files = sorted(Path(folder or slash).glob("*.py"))
    if slash or "." in begun:
        return [f"{folder}{slash}{each.name}" for each in files]
    return [each.stem if each.stem.isidentifier() else each.name for each in files]


# programs


def runnable_packages(ctx: typer.Context, incomplete: str) -> Candidates:  # noqa: ARG001  # as above
    """Offer the packages with something to run, and the Python files in the working directory."""
    from turtleact.commands.user_code import runnable_here

    known = runnable_here()
    files = sorted(each.name for each in Path().glob("*.py"))
    return [*sorted(name for name, programs in known.items() if programs), *files]


def executables(ctx: typer.Context, incomplete: str) -> Candidates:  # noqa: ARG001  # as above
    """Offer the executables of the package given earlier on the command line."""
    from turtleact.commands.user_code import runnable_here

    return list(runnable_here().get(ctx.params["package"], ()))


# what they share


def _types_by_name(ctx: typer.Context, kind: Kind) -> dict[str, tuple[str, ...]]:
    """Return the names of the actions, services or topics on the graph, with their types.

    If there is no graph, or an option selects the embedded world, return the actions of that world,
    but no services or topics.
    """
    from turtleact.transports.graph import types_by_name  # help does without it

    given = ctx.params
    embedded = EMBEDDED if kind == "action" else {}
    if given.get("embedded") or given.get("seed") or given.get("speed"):
        return embedded

    where = _reach(ctx)
    try:
        return types_by_name(_look(where).endpoints(), kind)
    except TurtleactError:
        return {} if where.connect else embedded


def _as_begun(names: Iterable[str], begun: str) -> list[str]:
    """Return the names. If the user has begun a relative name, remove the leading slash of each."""
    is_relative = begun != "" and not begun.startswith("/")
    return [name.removeprefix("/") if is_relative else name for name in names]


def _interfaces(ctx: typer.Context, kind: str | None = None) -> list[str]:
    """Return the names of all interfaces; with a ``kind``, such as ``"msg"``, only of that kind."""
    from turtleact.commands.message_text import make_known
    from turtleact.interfaces import known_interfaces

    make_known(_folder(ctx), is_silent=True)
    return [name for name in known_interfaces() if kind in (None, name.split("/")[1])]


def _folder(ctx: typer.Context) -> str | None:
    folder = ctx.params.get("interfaces")
    return None if folder is None else str(folder)


def _reach(ctx: typer.Context) -> ConnectOptions:
    """Return the graph that the options on the command line select."""
    given = ctx.params
    config = given.get("config")
    return ConnectOptions.of(
        given.get("connect"), given.get("domain") or 0, None if config is None else str(config)
    )


def _look(where: ConnectOptions) -> Graph:
    """Return the nodes and endpoints on the graph.

    Raises:
        TurtleactError: if no graph can be reached.
    """
    from turtleact.commands.access_config import mode_of
    from turtleact.transports.rmw_zenoh.session import census

    access = where.access()
    mode = mode_of(where.connect, access)
    return census(where.connect or None, where.domain, access.settings(), mode)
