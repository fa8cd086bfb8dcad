"""The client's side of an action: goals are sent, read, waited for and canceled."""

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
