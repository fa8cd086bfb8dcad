"""A node: one participant of a graph.

`node` opens topics, services and actions by their names. `resources` holds all that was opened, to
be closed with the node, and `conflicts` sees to it that one node serves an action name.
"""

from turtleact.node.node import ActionServer, Node, ServerGoalHandle, Transition, open_node

__all__ = ["ActionServer", "Node", "ServerGoalHandle", "Transition", "open_node"]
