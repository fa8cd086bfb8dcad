"""Who watches the goals of a server or client: one list for each, whatever the purpose.

The status topic and the hooks of users are observers; recordings and telemetry will be. An observer
only watches. What it raises is logged and never reaches a goal.

Order: all observers hear of one change before any hears of the next. An observer may cause a
change, say by canceling a goal; that change is told after the present one.
"""

from __future__ import annotations

import logging
from collections import deque

from turtleact.goal import Goal, GoalStatus
from turtleact.summaries import STOPS, loggable

__all__ = ["GoalObserver", "Observers"]

logger = logging.getLogger("turtleact")


class GoalObserver:
    """Watches goals. A subclass overrides what it wants to hear of."""

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Called after a goal has changed its state; a new goal comes from UNKNOWN."""

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        """Called with each feedback message; ``feedback`` must not be changed."""


class Observers:
    """The observers of one server or client.

    Args:
        action: The name of the action, for the log.

    Attributes:
        are_any: Whether there is anybody to tell. A server looks here before it calls anything.
        want_feedback: Whether any of them wants to hear of feedback.
    """

    __slots__ = ("_action", "_observers", "_untold", "are_any", "want_feedback")

    def __init__(self, action: str) -> None:
        self._action = action
        self._observers: tuple[GoalObserver, ...] = ()
        self._untold: deque[tuple[Goal, GoalStatus, GoalStatus] | tuple[Goal, object]] = deque()
        self.are_any = False
        self.want_feedback = False

    def add(self, observer: GoalObserver) -> None:
        """Tell ``observer`` of every change from now on."""
        self._set((*self._observers, observer))

    def remove(self, observer: GoalObserver) -> None:
        """Tell it nothing any more; an unknown observer is ignored."""
        self._set(tuple(each for each in self._observers if each is not observer))

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Tell all observers of a goal's new state."""
        self._untold.append((goal, before, after))
        if len(self._untold) == 1:
            self._tell()

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        """Tell all observers of a feedback message."""
        self._untold.append((goal, feedback))
        if len(self._untold) == 1:
            self._tell()

    def _set(self, observers: tuple[GoalObserver, ...]) -> None:
        self._observers = observers
        self.are_any = bool(observers)
        self.want_feedback = any(
            type(each).feedback_published is not GoalObserver.feedback_published
            for each in observers
        )

    def _tell(self) -> None:
        """Tell the first news, and what observers cause meanwhile after it."""
        while self._untold:
            news = self._untold[0]
            for observer in self._observers:
                try:
                    if len(news) == 3:
                        observer.goal_changed(*news)
                    else:
                        observer.feedback_published(*news)
                except STOPS:
                    self._untold.clear()
                    raise
                except BaseException as error:  # a cancellation too: nobody has cancelled it
                    problem = "an observer of the goals of %s failed"
                    logger.error(problem, self._action, exc_info=loggable(error))
            self._untold.popleft()
