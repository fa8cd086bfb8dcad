"""The verb ``doctor``, which prints a line for each fault of the graph, with advice."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.app import SETTINGS, verb
from turtleact.commands.options import flag
from turtleact.commands.output import say_lines
from turtleact.errors import TurtleactError, UsageError

if TYPE_CHECKING:
    from turtleact.commands.settings import ConnectOptions
    from turtleact.doctor.checks import Fault, Snapshot
    from turtleact.node import Node

__all__ = ["app", "fact_lines"]

app = typer.Typer(**SETTINGS)


@verb(app, knows=True, help=VERBS["doctor"])
def doctor(
    reach: ConnectOptions,
    *,
    as_json: Annotated[bool, flag("--json", text="Print a line of JSON for each fault.")] = False,
    verbose: Annotated[
        bool,
        flag(
            *("--verbose", "-v"),
            text="Print facts too: routers, versions, sessions, domains in use.",
        ),
    ] = False,
) -> int:
    """``doctor``."""
    from turtleact.commands import graph
    from turtleact.commands.interrupts import Interrupts
    from turtleact.doctor.checks import Fault, find_faults
    from turtleact.doctor.gathering import take_snapshot

    async def look(node: Node) -> int:
        snapshot = await take_snapshot(node, with_domains=verbose)
        return _print(find_faults(snapshot), snapshot if verbose else None, as_json=as_json)

    # The node is a client, which connects only to the router. The router also shows nodes that
    # hang, until their lease ends. A peer would have to connect to such a node to see it.
    try:
        return Interrupts().run(graph.use(graph.open_graph(reach, "client"), look))
    except UsageError:
        raise
    except TurtleactError as error:
        problem = str(error).partition("; ")[0]
        return _print([Fault("no-router", (), problem, START)], None, as_json=as_json)


HEALTHY, FAULTY = 0, 1
"""The exit statuses without and with faults."""

START = (
    "start a router there, with 'turtleact serve' or rmw_zenohd, or give its address with --connect"
)


def _print(faults: list[Fault], seen: Snapshot | None, *, as_json: bool) -> int:
    """Print faults, and the facts in a snapshot if there is one. Return the exit status."""
    if as_json:
        lines = [json.dumps(_as_dict(each)) for each in faults]
        lines += [] if seen is None else [json.dumps({"facts": _facts(seen)})]
    else:
        lines = list(map(str, faults)) or ["no faults found"]
        lines += [] if seen is None else fact_lines(seen)
    say_lines(lines)
    return FAULTY if faults else HEALTHY


def _as_dict(fault: Fault) -> dict[str, object]:
    return {
        "fault": fault.kind,
        "names": list(fault.names),
        "problem": fault.problem,
        "advice": fault.advice,
    }


def _facts(snapshot: Snapshot) -> dict[str, object]:
    """Return facts about a graph, such as its number of nodes, as values for JSON."""
    return {
        "domain": snapshot.domain,
        "domains in use": list(snapshot.domains),
        "routers": [
            {"zid": each.zid, "zenoh": each.version, "sessions": each.sessions}
            for each in snapshot.routers or ()
        ],
        "zenoh": snapshot.zenoh,
        "sessions with nodes": len(_sessions(snapshot)),
        "nodes": len(snapshot.nodes),
        "endpoints": len(snapshot.endpoints),
        "clocks": {
            each.node: round(each.offset, 4) for each in snapshot.answers if each.offset is not None
        },
    }


def _sessions(snapshot: Snapshot) -> set[str]:
    """Return the ids of the Zenoh sessions that have nodes."""
    return {each.session for each in snapshot.nodes}


def fact_lines(snapshot: Snapshot) -> Iterator[str]:
    """Yield the facts about a graph as lines of text."""
    others = ", ".join(str(each) for each in snapshot.domains if each != snapshot.domain)
    if snapshot.domain is not None:
        yield f"domain: {snapshot.domain} (others in use: {others or 'none'})"
    for router in snapshot.routers or ():
        version = router.version or "unknown"
        sessions = "unknown" if router.sessions is None else router.sessions
        yield f"router: {router.zid}, Zenoh {version}, sessions: {sessions}"
    yield f"Zenoh here: {snapshot.zenoh or 'none'}"
    yield f"nodes: {len(snapshot.nodes)} in {len(_sessions(snapshot))} sessions"
    yield f"endpoints: {len(snapshot.endpoints)}"
    for answer in snapshot.answers:
        if answer.offset is not None:
            where = "ahead" if answer.offset > 0 else "behind"
            off, doubt = abs(answer.offset), answer.uncertainty
            yield f"clock of {answer.node}: {off:.4f} s {where} (± {doubt:.4f} s)"
