"""Nodes: the participants of a graph.

`node` opens `topics`, services and actions by name. `parameters` serves the parameters of a node by
the rules of `parameter_rules`, and `timers` makes ticks at a fixed rate. `type_descriptions`
describes the types that a node uses. `resources` tracks everything that a node has opened, and
closes it with the node. `conflicts` ensures that only one node serves an action name.
"""

from turtleact.node.node import (
    ActionServer,
    Node,
    ServerGoalHandle,
    Transition,
    check_open,
    close_withdrawn,
    local_server_of,
    open_node,
    resources_of,
)
from turtleact.node.timers import Tick, Timer

__all__ = [
    "ActionServer",
    "Node",
    "ServerGoalHandle",
    "Tick",
    "Timer",
    "Transition",
    "check_open",
    "close_withdrawn",
    "local_server_of",
    "open_node",
    "resources_of",
]
