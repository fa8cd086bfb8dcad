"""The built-in actions. They drive turtles through a node's topics and actions only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from turtleact.actions import fibonacci, go_to, patrol
from turtleact.actions.driving import Turtles
from turtleact.actions.robots import Robot
from turtleact.actions.steering import Area
from turtleact.body import ServerOptions

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["Area", "Robot", "Turtles", "serve_built_ins"]

BUILT_IN = (go_to.serve, patrol.serve)
"""The actions that drive turtles: `Turtles` of any kind of `Robot`, in any `Area`."""


def serve_built_ins(node: Node, *, side: float, **options: Unpack[ServerOptions]) -> None:
    """Serve all built-in actions on a node.

    Each makes way for another server of its name, in any process: it takes no more goals as soon as
    discovery shows the other one, and its running goals finish. It comes back when the other one
    has gone. The log reports both.

    Args:
        node: Where they are served.
        side: The side of the square in which targets must lie (m).
        **options: As for `Node.action_server`, such as a ``journal``.
    """
    fibonacci.serve(node, on_conflict="withdraw", **options)
    turtles = Turtles(node, Area(0.0, 0.0, side, side))
    for serve in BUILT_IN:
        serve(node, turtles, on_conflict="withdraw", **options)
