"""Nodes: the participants of a graph.

`node` opens `topics`, services and actions by name. `parameters` serves the parameters of a node by
the rules of `parameter_rules`, and `timers` makes ticks at a fixed rate. `learning` learns types
from other nodes, and describes those of a node to them. `resources` tracks everything that a node
has opened, and closes it with the node. `conflicts` ensures that only one node serves an action
name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from turtleact.names import resolve_name
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
from turtleact.tasks.clock import check_timeout

if TYPE_CHECKING:
    from turtleact.interfaces.types import Interface
    from turtleact.transports.graph import Kind

__all__ = [
    "ActionServer",
    "Node",
    "ServerGoalHandle",
    "Tick",
    "Timer",
    "Transition",
    "check_open",
    "close_withdrawn",
    "learn_interface",
    "local_server_of",
    "open_node",
    "resources_of",
]


async def learn_interface(
    node: Node, name: str, kind: Kind | None = None, timeout: float | None = None
) -> Interface:
    """Return the class of an action, a service or a topic on the graph, whatever its type.

    If this process does not know the type, or knows another definition of it, the type is learned
    from the nodes that use it. `get_interface` does not return a learned class. Cancelling: safe.

    Args:
        node: A node on the graph.
        name: The name of the action, service or topic. A relative name is resolved in the node's
            namespace.
        kind: ``"action"``, ``"service"`` or ``"topic"``; None for the one that has this name.
        timeout: How long to wait for the name, and for nodes that do not answer (s, event loop
            time). If left out, the name is awaited without a limit, and each node gets 2 s.

    Raises:
        NotLearned: if no node describes the type, or a description cannot be used.
        TurtleactError: if nobody uses the name within ``timeout``, or if the name has several types
            or kinds. The error lists them.
    """
    check_timeout(timeout)
    return await node.learner.wait_for(resolve_name(name, node.namespace, node.name), kind, timeout)
