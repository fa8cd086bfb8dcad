"""A node: one participant of a graph.

`node` opens topics, services and actions by their names, and `belongings` has all that was opened,
to be closed with it.
"""

from turtleact.node.node import Node, open_node

__all__ = ["Node", "open_node"]
