"""The messages with which nodes of turtleact pause goals over the wire. ROS 2 has none.

======================  ==============================  =========================================
``…/_action/set_paused``  `SetPaused`                    pauses or resumes one goal
``…/_action/paused``      `PausedGoals`                  all goals that are paused, at each change
``NAME/pause``            ``std_srvs/srv/Trigger``       pauses all goals, for users of ROS 2
``NAME/resume``           ``std_srvs/srv/Trigger``       resumes them
======================  ==============================  =========================================
"""

from __future__ import annotations

from turtleact.interfaces import Message, Service, bool_, float64, string
from turtleact.interfaces.standard import UUID

__all__ = ["PausedGoals", "SetPaused", "paused_topic", "set_paused_service"]


class SetPaused(Service, type_name="turtleact_interfaces/srv/SetPaused"):
    """Pauses or resumes one goal."""

    class Request(Message):
        """Which goal, and what to do with it.

        Attributes:
            goal_id: The goal.
            is_paused: Whether to pause the goal (true) or to resume it (false).
            timeout: How long its body may take to stand still (s).
        """

        goal_id: UUID = UUID()
        is_paused: bool_ = True
        timeout: float64 = 5.0

    class Response(Message):
        """Whether the request was carried out.

        Attributes:
            success: Whether the goal is now paused, or resumed, as requested.
            message: Why the request failed; empty if it did not.
        """

        success: bool_ = False
        message: string = ""


class PausedGoals(Message, type_name="turtleact_interfaces/msg/PausedGoals"):
    """The goals of an action that are paused.

    Attributes:
        goal_ids: Their ids.
    """

    goal_ids: list[UUID] = []


def set_paused_service(action: str) -> str:
    """Return the name of an action's service that pauses and resumes goals."""
    return f"{action}/_action/set_paused"


def paused_topic(action: str) -> str:
    """Return the name of the topic that lists an action's paused goals."""
    return f"{action}/_action/paused"
