"""A goal that a server elsewhere holds, kept up to date here by what messages say.

Source: rcl_action ``goal_state_machine.c`` for the steps between states.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Final, cast

from turtleact.feedback import FeedbackLog
from turtleact.goal import Cancelable, Goal, GoalEvent, GoalStatus
from turtleact.summaries import STOPS

if TYPE_CHECKING:
    from turtleact.interfaces import Message
    from turtleact.transports.base import Asked

__all__ = ["Followed", "move"]

logger = logging.getLogger("turtleact.client")

MOST_UNREAD: Final = 1 << 16
"""A reader that lags further behind loses the oldest feedback messages."""


class Followed:
    """A goal that is kept up to date.

    Attributes:
        goal: The goal.
        goal_id: Its id.
        log: Its feedback.
        is_sender: Whether it was sent from here.
        is_accepted: Whether the server has taken it.
        is_given_up: Whether it is to be canceled as soon as that is possible.
        received: How many feedback messages have come.
        sent: The request that has it taken, if that was sent early.
        asked: The request for its result, if that was sent together with the goal.
        task: What keeps it up to date, where that takes waiting.
    """

    def __init__(self, goal: Goal, *, is_sender: bool) -> None:
        self.goal = goal
        self.goal_id = cast("bytes", goal.id)
        self.log = goal.feedback = FeedbackLog()
        goal.is_streamed = True
        self.is_sender = is_sender
        self.is_accepted = not is_sender
        self.is_given_up = False
        self.received = 0
        self.sent: Asked | None = None
        self.asked: Asked | None = None
        self.task: Cancelable | None = None

    def drop(self) -> None:
        """Want no answer to what was asked early."""
        for early in (self.sent, self.asked):
            if early is not None:
                early.drop()
        self.sent = self.asked = None

    def take(self, feedback: Message) -> None:
        """Note a feedback message, and tell the sender's callback."""
        goal, log = self.goal, self.log
        if goal.status < _EXECUTING:
            move(goal, _EXECUTING)
        self.received += 1
        goal.last_feedback = feedback
        log.append(feedback)
        if log.read is not None and log.count - log.read > MOST_UNREAD:
            log.read = log.count - MOST_UNREAD
        if goal.on_feedback is not None:
            try:
                goal.on_feedback(feedback)
            except STOPS:
                raise
            except BaseException:  # a cancellation too: nobody has canceled the callback
                logger.exception("the feedback_callback of goal %s failed", goal.hex)


_EXECUTING: Final = GoalStatus.EXECUTING

_EVENTS: Final = {
    GoalStatus.SUCCEEDED: GoalEvent.SUCCEED,
    GoalStatus.CANCELED: GoalEvent.CANCELED,
    GoalStatus.ABORTED: GoalEvent.ABORT,
}


def move(goal: Goal, status: GoalStatus) -> None:
    """Bring a goal into a state, by way of those that must have come before; never backwards."""
    if status <= goal.status or goal.status.is_terminal:
        return
    if goal.status is GoalStatus.ACCEPTED:
        goal.apply(GoalEvent.EXECUTE)
    if status in (GoalStatus.CANCELING, GoalStatus.CANCELED) and (
        goal.status is not GoalStatus.CANCELING
    ):
        goal.apply(GoalEvent.CANCEL_GOAL)
    if status in _EVENTS:
        goal.apply(_EVENTS[status])
