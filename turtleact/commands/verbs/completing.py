"""Which arguments are completed by what, as Typer asks for it.

Each function takes, by these names, Typer's context (``ctx``), which holds the arguments that stand
there already, and what is begun (``incomplete``). It gives what may stand there; it may raise, and
`turtleact.commands.completion` is silent then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, TypeAlias

import typer

from turtleact.errors import TurtleactError

if TYPE_CHECKING:
    from turtleact.commands.graph_names import Kind
    from turtleact.commands.verbs.arguments import Reach

__all__ = [
    "actions",
    "goal_ids",
    "interfaces",
    "messages",
    "nodes",
    "packages",
    "parameters",
    "services",
    "targets",
    "topics",
    "types",
    "words",
]

Candidates: TypeAlias = list[str] | list[tuple[str, str]]
Complete: TypeAlias = Callable[..., Candidates]

SUFFIXES = {"action": "action", "service": "srv", "topic": "msg"}
"""What the kinds of interfaces are called in their names."""


def words(*known: str) -> Complete:
    """One of these words."""
    return lambda: list(known)


def actions(ctx: typer.Context, incomplete: str) -> Candidates:
    """The actions in reach."""
    return _names(ctx, "action", incomplete)


def topics(ctx: typer.Context, incomplete: str) -> Candidates:
    """The topics on the graph."""
    return _names(ctx, "topic", incomplete)


def services(ctx: typer.Context, incomplete: str) -> Candidates:
    """The services on the graph."""
    return _names(ctx, "service", incomplete)


def nodes(ctx: typer.Context, incomplete: str) -> Candidates:
    """The nodes on the graph."""
    from turtleact.commands import candidates

    return _as_begun(candidates.nodes(_needed(ctx)), incomplete)


def parameters(ctx: typer.Context) -> Candidates:
    """The parameters of the node that stands before."""
    from turtleact.commands import candidates

    return candidates.parameters(_needed(ctx), ctx.params["node_name"])


def goal_ids(ctx: typer.Context, incomplete: str) -> Candidates:
    """The goals that servers hold; behind ``--all`` and ``--before`` the actions."""
    if ctx.params.get("all_") or ctx.params.get("before"):
        return _names(ctx, "action", incomplete)
    from turtleact.commands import candidates

    return list(candidates.goals(_needed(ctx)).items())


def types(kind: Kind, *, of_name: bool = True) -> Complete:
    """The types of the name that stands before, else all interfaces of that kind."""

    def complete(ctx: typer.Context) -> Candidates:
        from turtleact.commands import candidates

        known: tuple[str, ...] = ()
        if of_name:
            name = "/" + str(ctx.params["name"]).removeprefix("/")
            known = _types_by_name(ctx, kind).get(name, ())
        return list(known) or candidates.interfaces(SUFFIXES[kind], ctx.params.get("interfaces"))

    return complete


def interfaces(ctx: typer.Context) -> Candidates:
    """All interfaces."""
    from turtleact.commands import candidates

    return candidates.interfaces(None, ctx.params["interfaces"])


def packages(ctx: typer.Context) -> Candidates:
    """All packages that have interfaces."""
    from turtleact.commands import candidates

    return candidates.packages(ctx.params["interfaces"])


def messages(ctx: typer.Context) -> Candidates:
    """A message to begin with, of the type that stands before."""
    from turtleact.commands import candidates

    return [candidates.prototype(ctx.params["type_name"], ctx.params["interfaces"])]


def targets(incomplete: str) -> Candidates:
    """Modules of the working directory, and the actions in them."""
    from turtleact.commands import candidates

    return list(candidates.targets(incomplete))


def _names(ctx: typer.Context, kind: Kind, begun: str) -> Candidates:
    return _as_begun(_types_by_name(ctx, kind), begun)


def _types_by_name(ctx: typer.Context, kind: Kind) -> dict[str, tuple[str, ...]]:
    from turtleact.commands import candidates

    try:
        return candidates.endpoint_types(_reach(ctx), kind)
    except TurtleactError:
        return {}


def _as_begun(names: Iterable[str], begun: str) -> list[str]:
    """Names as the user has begun to write them: with a slash before, or without."""
    is_relative = begun != "" and not begun.startswith("/")
    return [name.removeprefix("/") if is_relative else name for name in names]


def _needed(ctx: typer.Context) -> Reach:
    """The graph that is meant."""
    from turtleact.commands.verbs.arguments import reach

    given = ctx.params
    return reach(given.get("connect"), given.get("domain"), given.get("config"))


def _reach(ctx: typer.Context) -> Reach | None:
    """The graph that is meant; None for the embedded world of ``send-goal``."""
    given = ctx.params
    is_embedded = given.get("embedded") or given.get("seed") or given.get("speed")
    return None if is_embedded else _needed(ctx)
