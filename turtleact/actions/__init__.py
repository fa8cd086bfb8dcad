"""The built-in actions.

The actions reach turtles only through the topics of a node. They import nothing from the simulator.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from turtleact.actions import fibonacci, go_to, patrol
from turtleact.actions.driving import Turtles
from turtleact.actions.robots import Robot
from turtleact.actions.steering import Area
from turtleact.goals.body import ServerOptions

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["Area", "Robot", "Turtles", "serve_built_ins"]

BUILT_IN = (go_to.serve, patrol.serve)
"""The built-in actions that drive turtles.

The actions can drive any kind of `Robot`, in any `Area`.
"""


def serve_built_ins(node: Node, *, side: float, **options: Unpack[ServerOptions]) -> None:
    """Serve all built-in actions on a node.

    A built-in action is withdrawn if another server, in any process, serves an action of the same
    name. As soon as discovery shows that server, the built-in action accepts no more goals, but its
    running goals finish. When the other server is gone, the built-in action is served again. The
    log reports each withdrawal and each return of a built-in action.

    Args:
        node: The node that serves the actions.
        side: The side length of the square in which targets must lie (m).
        **options: Options of `Node.action_server` for every action, such as ``journal``.
    """
    fibonacci.serve(node, on_conflict="withdraw", **options)
    turtles = Turtles(node, Area(0.0, 0.0, side, side))
    for serve in BUILT_IN:
        serve(node, turtles, on_conflict="withdraw", **options)
