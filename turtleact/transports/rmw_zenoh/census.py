"""Who is on the graph, asked once: no event loop, no node, and nobody sees us there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from turtleact.transports.rmw_zenoh.config import Mode, session_config
from turtleact.transports.rmw_zenoh.discovery import Graph
from turtleact.transports.rmw_zenoh.keys import all_tokens
from turtleact.transports.rmw_zenoh.session import Session

__all__ = ["census"]


def census(
    connect: Sequence[str] | None,
    domain: int,
    config: Mapping[str, object] | None = None,
    mode: Mode = "peer",
) -> Graph:
    """The nodes and endpoints of a graph; blocks, some hundredths of a second as a rule.

    Args:
        connect: Endpoints of the graph; the router of this machine if None.
        domain: Its ROS domain.
        config: Paths and values of Zenoh's configuration.
        mode: As for `open_zenoh`.

    Raises:
        InvalidOption: if one of them has a value that it cannot have.
        TurtleactError: if there is no graph in reach.
    """
    session = Session.open(session_config(connect, None, mode, domain, config or {}))
    try:
        graph = Graph(session.zid)
        for key in session.tokens(all_tokens(domain)):
            graph.add(key)
        return graph
    finally:
        session.close()
