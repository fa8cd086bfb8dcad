"""ROS 2 actions for asyncio.

Open a node with `open_node`, serve an action with `Node.serve`, send goals with a client of
`Node.action_client`. The worlds of turtles are in `turtleact.app`, the types of fields in
`turtleact.interfaces`, virtual time for tests in `turtleact.testing`. What is built on what stands
in docs/architecture.md.

A name is imported when it is first used, so that what needs little starts fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from turtleact.body import action
    from turtleact.client import ActionClient
    from turtleact.client_goal import ClientGoalHandle, Outcome
    from turtleact.errors import (
        Abort,
        Canceled,
        GoalAborted,
        GoalCanceled,
        GoalError,
        GoalRejected,
        InvalidGoal,
        InvalidMessage,
        InvalidName,
        InvalidOption,
        InvalidTransition,
        Reject,
        ServerUnavailable,
        ServiceError,
        ServiceTimeout,
        TurtleactError,
        UnknownGoal,
    )
    from turtleact.goal import CancelResponse, GoalResponse, GoalStatus
    from turtleact.interfaces import Action, Message, Service, load_interface
    from turtleact.node import Node, open_node
    from turtleact.server import ActionServer
    from turtleact.server_goal import ServerGoalHandle
    from turtleact.services import ServiceClient, ServiceServer
    from turtleact.transports import QoS

__all__ = [
    # a node and what is opened on it
    "open_node",
    "Node",
    "ActionServer",
    "ActionClient",
    "ServerGoalHandle",
    "ClientGoalHandle",
    "Outcome",
    "ServiceServer",
    "ServiceClient",
    "QoS",
    # bodies and what they answer
    "action",
    "GoalResponse",
    "CancelResponse",
    "GoalStatus",
    "Abort",
    "Canceled",
    "Reject",
    # interfaces
    "Action",
    "Message",
    "Service",
    "load_interface",
    # errors
    "TurtleactError",
    "GoalError",
    "GoalRejected",
    "GoalAborted",
    "GoalCanceled",
    "UnknownGoal",
    "ServerUnavailable",
    "ServiceError",
    "ServiceTimeout",
    "InvalidGoal",
    "InvalidMessage",
    "InvalidName",
    "InvalidOption",
    "InvalidTransition",
]

__version__ = "0.1.0"

_HOMES = {
    "body": ("action",),
    "client": ("ActionClient",),
    "client_goal": ("ClientGoalHandle", "Outcome"),
    "goal": ("CancelResponse", "GoalResponse", "GoalStatus"),
    "interfaces": ("Action", "Message", "Service", "load_interface"),
    "node": ("Node", "open_node"),
    "server": ("ActionServer",),
    "server_goal": ("ServerGoalHandle",),
    "services": ("ServiceClient", "ServiceServer"),
    "transports": ("QoS",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    """Import a public name from the module that it lives in."""
    if name not in __all__:
        raise AttributeError(f"module 'turtleact' has no attribute '{name}'")
    module = importlib.import_module(f"turtleact.{_HOME.get(name, 'errors')}")
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    """What can be asked for."""
    return sorted([*globals(), *__all__])
