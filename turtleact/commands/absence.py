"""Why somebody whom the user expects is not there, and what to do about it.

A command finds no router, an empty domain, or an action that nobody serves. A server that is off
and one in another domain look the same from here, so these texts name what is in reach instead.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from turtleact.commands.output import note
from turtleact.errors import ServerUnavailable
from turtleact.graph import is_hidden_node
from turtleact.interfaces.definition import nearest

if TYPE_CHECKING:
    from turtleact.commands.settings import Reach
    from turtleact.transports import Transport

__all__ = [
    "no_router",
    "none_in_domain",
    "not_in_world",
    "not_served",
    "note_empty",
    "world_started",
]

ROUTER = "tcp/localhost:7447"
"""Where a command looks for a router unless ``--connect`` says otherwise."""

MOST_SHOWN = 10
"""How many names are listed if none is like the one that was looked for."""


def no_router(reach: Reach) -> str:
    """Say that there is no router where the nodes of this machine look for one."""
    rest = "answers" if reach.config is None else "answers, or lets in this --config,"
    return f"no router {rest} at {ROUTER} ('turtleact serve' starts one)"


async def note_empty(transport: Transport, reach: Reach) -> None:
    """Tell the user if a domain has no nodes: most verbs print nothing then."""
    from turtleact.transports import ZenohTransport  # an embedded world does without Zenoh

    if isinstance(transport, ZenohTransport) and all(map(is_hidden_node, transport.nodes())):
        note(await none_in_domain(transport, reach))


async def none_in_domain(transport: Transport, reach: Reach, what: str = "nodes") -> str:
    """Say that a domain has none of something, and in which domains there are nodes.

    Args:
        transport: The graph.
        reach: Which graph it is.
        what: What the domain has none of.
    """
    from turtleact.transports import ZenohTransport

    lack = f"domain {reach.domain} has no {what}"
    known = await transport.domains() if isinstance(transport, ZenohTransport) else ()
    others = [str(each) for each in known if each != reach.domain]
    if not others:
        return f"{lack}; is your server running?"
    there = f"domain {others[0]} has" if len(others) == 1 else f"domains {', '.join(others)} have"
    return f"{lack} ({there} nodes: try --domain {others[0]})"


def world_started(why: str = "") -> str:
    """Say that a command has started a world of its own.

    Args:
        why: Why it has; empty if the user asked for one.
    """
    reason = f", because {why}" if why else ""
    return f"started an embedded world, which ends with this command{reason}"


def not_served(name: str, served: Iterable[str], where: str = "in reach") -> ServerUnavailable:
    """The error for an action that nobody serves; it asks for the server and says what is there.

    Args:
        name: The full name of the action.
        served: The actions that are served.
        where: Where they are.
    """
    if near := nearest(name, served := sorted(set(served))):
        hint = f"is your server running, or did you mean '{near}'?"
    else:
        hint = f"is your server running? The actions {where}: {_some(served)}"
    return ServerUnavailable(name, "nobody serves it", hint=hint)


def not_in_world(name: str, served: Iterable[str]) -> ServerUnavailable:
    """The error for an action that the embedded world lacks, if the user asked for that world."""
    near = nearest(name, served := sorted(set(served)))
    there = f"did you mean '{near}'?" if near else f"it serves {_some(served)};"
    hint = f"{there} --embedded, --speed and --seed use no other server"
    return ServerUnavailable(name, "the embedded world does not serve it", hint=hint)


def _some(names: list[str]) -> str:
    shown = [*names[:MOST_SHOWN], "…"] if len(names) > MOST_SHOWN else names
    return ", ".join(shown) or "none"
