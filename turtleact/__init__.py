"""ROS 2 actions for asyncio.

The layers, each built on those below it::

    cli, commands               the command line
    web, rclpy, mcp             a page and rosbridge; rclpy without ROS; tools for language models
    sim, actions                the turtles; fibonacci, go_to, patrol
    node                        one participant's topics, services, actions and parameters
    goals                       goal states; servers that run goals; clients that send them
    transports                  delivery of messages
    tasks                       tasks, wake-ups and clocks of the event loop
    interfaces                  messages, services and actions as classes
    names, geometry, errors

Each name is imported on first use, so that small programs start fast. Importing the package loads
no other module, because the command line sets its signal handlers only afterwards. Until the
handlers are set, Ctrl-C prints a traceback.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as in `typing`, which is slow to import
if TYPE_CHECKING:
    from turtleact.errors import (
        Abort,
        ActionConflict,
        Cancel,
        GoalAborted,
        GoalCanceled,
        GoalError,
        GoalRejected,
        InvalidBody,
        InvalidGoal,
        InvalidGoalId,
        InvalidInterface,
        InvalidMessage,
        InvalidName,
        InvalidOption,
        InvalidParameter,
        InvalidTransition,
        NotLearned,
        PauseRefused,
        Reject,
        ServerUnavailable,
        ServiceError,
        ServiceTimeout,
        SimError,
        TurtleactError,
        UnknownGoal,
        UnknownInterface,
        UsageError,
        Verdict,
    )
    from turtleact.goals.body import action, background
    from turtleact.goals.client import (
        Accepted,
        ActionClient,
        ClientGoalHandle,
        Event,
        FeedbackReceived,
        Outcome,
        ResultReceived,
        StatusChanged,
    )
    from turtleact.goals.records import Resumed
    from turtleact.goals.state import CancelResponse, GoalResponse, GoalStatus
    from turtleact.interfaces import (
        Action,
        Message,
        Service,
        get_action,
        get_interface,
        get_message,
        get_service,
        load_action,
        load_interface,
        load_message,
        load_service,
    )
    from turtleact.journal import Journal, JournalError, open_journal
    from turtleact.node import (
        ActionServer,
        Node,
        ServerGoalHandle,
        Tick,
        Timer,
        learn_interface,
        open_node,
    )
    from turtleact.node.parameter_rules import parameter
    from turtleact.node.parameters import Parameter
    from turtleact.node.services import ServiceClient, ServiceServer
    from turtleact.node.topics import Publisher, Subscription
    from turtleact.sim.world_node import WorldNode, open_world
    from turtleact.transports import QoS, open_zenoh

__all__ = [
    # a node and what you open on it
    "open_node",
    "open_zenoh",
    "open_world",
    "Node",
    "WorldNode",
    "ActionServer",
    "ActionClient",
    "ServerGoalHandle",
    "ClientGoalHandle",
    "Outcome",
    "ServiceServer",
    "ServiceClient",
    "Publisher",
    "Subscription",
    "QoS",
    "Parameter",
    "Timer",
    "Tick",
    # goals on disk
    "open_journal",
    "Journal",
    "JournalError",
    "Resumed",
    # bodies and callbacks
    "action",
    "background",
    "parameter",
    "GoalResponse",
    "CancelResponse",
    "GoalStatus",
    "Abort",
    "Cancel",
    "Reject",
    # events of a goal, from `ClientGoalHandle.events`
    "Event",
    "Accepted",
    "StatusChanged",
    "FeedbackReceived",
    "ResultReceived",
    # interfaces
    "Action",
    "Message",
    "Service",
    "load_interface",
    "load_action",
    "load_message",
    "load_service",
    "get_interface",
    "get_action",
    "get_message",
    "get_service",
    "learn_interface",
    # errors
    "TurtleactError",
    "GoalError",
    "GoalRejected",
    "GoalAborted",
    "GoalCanceled",
    "PauseRefused",
    "UnknownGoal",
    "ActionConflict",
    "ServerUnavailable",
    "ServiceError",
    "ServiceTimeout",
    "InvalidBody",
    "InvalidGoal",
    "InvalidGoalId",
    "InvalidInterface",
    "InvalidMessage",
    "InvalidName",
    "InvalidOption",
    "InvalidParameter",
    "InvalidTransition",
    "UnknownInterface",
    "NotLearned",
    "SimError",
    "UsageError",
    "Verdict",
]

__version__ = "0.1.0"

_HOMES = {
    "sim.world_node": ("WorldNode", "open_world"),
    "goals.body": ("action", "background"),
    "goals.client": (
        "Accepted",
        "ActionClient",
        "ClientGoalHandle",
        "Event",
        "FeedbackReceived",
        "Outcome",
        "ResultReceived",
        "StatusChanged",
    ),
    "goals.state": ("CancelResponse", "GoalResponse", "GoalStatus"),
    "goals.records": ("Resumed",),
    "interfaces": (
        "Action",
        "Message",
        "Service",
        "get_action",
        "get_interface",
        "get_message",
        "get_service",
        "load_action",
        "load_interface",
        "load_message",
        "load_service",
    ),
    "journal": ("Journal", "JournalError", "open_journal"),
    "node": (
        "ActionServer",
        "Node",
        "ServerGoalHandle",
        "Tick",
        "Timer",
        "learn_interface",
        "open_node",
    ),
    "node.parameters": ("Parameter",),
    "node.parameter_rules": ("parameter",),
    "node.services": ("ServiceClient", "ServiceServer"),
    "node.topics": ("Publisher", "Subscription"),
    "transports": ("QoS", "open_zenoh"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    """Import a public name from its module on first use."""
    if name not in __all__:
        raise AttributeError(f"module 'turtleact' has no attribute '{name}'")
    import importlib

    module = importlib.import_module(f"turtleact.{_HOME.get(name, 'errors')}")
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    """List the names in the module and all public names, even those not imported yet."""
    return sorted([*globals(), *__all__])
