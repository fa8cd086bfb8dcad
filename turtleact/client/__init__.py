"""The client side of actions: sends goals, reads their feedback, awaits and cancels them."""

from turtleact.client.action_client import ActionClient, Attach, SendGoal
from turtleact.client.goal_handle import (
    Accepted,
    ClientGoalHandle,
    Event,
    FeedbackReceived,
    Outcome,
    ResultReceived,
    StatusChanged,
)

__all__ = [
    "Accepted",
    "ActionClient",
    "Attach",
    "ClientGoalHandle",
    "Event",
    "FeedbackReceived",
    "Outcome",
    "ResultReceived",
    "SendGoal",
    "StatusChanged",
]
