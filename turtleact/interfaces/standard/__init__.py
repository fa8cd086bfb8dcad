"""Contains the built-in interfaces, as .msg, .srv and .action files and as Python classes.

As in ROS 2, each ROS package is a Python package with one module per kind:
``turtleact.interfaces.standard.geometry_msgs.msg``. The modules are generated from the files beside
them, and ``scripts/check`` compares modules and files. This module has shortcuts to the most used
classes, each imported on first use. Three shortcuts have other names than in ROS, because the ROS
names are ambiguous: ``TurtlePose``, ``GoalStatusMessage`` and ``ExampleFibonacci``.

Source: ROS 2 Jazzy; see the README in this folder.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as in `typing`, which is slow to import
if TYPE_CHECKING:
    from turtleact.interfaces.standard.action_msgs.msg import GoalInfo, GoalStatusArray
    from turtleact.interfaces.standard.action_msgs.msg import GoalStatus as GoalStatusMessage
    from turtleact.interfaces.standard.action_msgs.srv import CancelGoal
    from turtleact.interfaces.standard.action_tutorials_interfaces.action import Fibonacci
    from turtleact.interfaces.standard.builtin_interfaces.msg import Duration, Time
    from turtleact.interfaces.standard.example_interfaces.action import (
        Fibonacci as ExampleFibonacci,
    )
    from turtleact.interfaces.standard.geometry_msgs.msg import Point, Twist, Vector3
    from turtleact.interfaces.standard.patrol_interfaces.action import PatrolCommandInterface
    from turtleact.interfaces.standard.service_msgs.msg import ServiceEventInfo
    from turtleact.interfaces.standard.std_srvs.srv import Empty
    from turtleact.interfaces.standard.turtlesim.action import RotateAbsolute
    from turtleact.interfaces.standard.turtlesim.msg import Color
    from turtleact.interfaces.standard.turtlesim.msg import Pose as TurtlePose
    from turtleact.interfaces.standard.turtlesim.srv import (
        Kill,
        SetPen,
        Spawn,
        TeleportAbsolute,
        TeleportRelative,
    )
    from turtleact.interfaces.standard.unique_identifier_msgs.msg import UUID

__all__ = [
    "UUID",
    "CancelGoal",
    "Color",
    "Duration",
    "Empty",
    "ExampleFibonacci",
    "Fibonacci",
    "GoalInfo",
    "GoalStatusArray",
    "GoalStatusMessage",
    "Kill",
    "PatrolCommandInterface",
    "Point",
    "RotateAbsolute",
    "ServiceEventInfo",
    "SetPen",
    "Spawn",
    "TeleportAbsolute",
    "TeleportRelative",
    "Time",
    "TurtlePose",
    "Twist",
    "Vector3",
]

#: The names of each module.
_HOMES = {
    "action_msgs.msg": ("GoalInfo", "GoalStatusMessage", "GoalStatusArray"),
    "action_msgs.srv": ("CancelGoal",),
    "action_tutorials_interfaces.action": ("Fibonacci",),
    "builtin_interfaces.msg": ("Duration", "Time"),
    "example_interfaces.action": ("ExampleFibonacci",),
    "geometry_msgs.msg": (
        "Point",
        "Twist",
        "Vector3",
    ),
    "patrol_interfaces.action": ("PatrolCommandInterface",),
    "service_msgs.msg": ("ServiceEventInfo",),
    "std_srvs.srv": ("Empty",),
    "turtlesim.action": ("RotateAbsolute",),
    "turtlesim.msg": ("Color", "TurtlePose"),
    "turtlesim.srv": ("Kill", "SetPen", "Spawn", "TeleportAbsolute", "TeleportRelative"),
    "unique_identifier_msgs.msg": ("UUID",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

#: The ROS names of shortcuts that are called differently here.
_IN_ROS = {
    "GoalStatusMessage": "GoalStatus",
    "ExampleFibonacci": "Fibonacci",
    "TurtlePose": "Pose",
}


def __getattr__(name: str) -> object:
    """Import a class from the generated module of its package."""
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    module = importlib.import_module(f"{__name__}.{home}")
    value = globals()[name] = getattr(module, _IN_ROS.get(name, name))
    return value


def __dir__() -> list[str]:
    """List the module's names and all shortcuts, including those that are not imported yet."""
    return sorted([*globals(), *__all__])
