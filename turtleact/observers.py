"""Observers of the goals of a server or client: one list for all purposes.

The status topic and users' hooks are observers; recordings and telemetry can be. An observer only
watches. The list logs whatever an observer raises, so that it never affects a goal.

Order: all observers hear of one change before any hears of the next. If an observer causes a
change, for example by canceling a goal, all observers hear of the current change first.
"""

from __future__ import annotations

import logging
from collections import deque

from turtleact.goal import Goal, GoalStatus
from turtleact.summaries import STOPS, loggable

__all__ = ["GoalObserver", "Observers"]

logger = logging.getLogger("turtleact")


class GoalObserver:
    """Watches goals. A subclass overrides the methods it needs."""

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Called after a goal has changed its state. For a new goal, ``before`` is UNKNOWN."""

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        """Called with each feedback message, which must not be changed."""


class Observers:
    """The observers of one server or client.

    Args:
        action: The name of the action, for the log.

    Attributes:
        are_any: Whether there are any observers. A server checks this before it calls anything.
        want_feedback: Whether any observer overrides `feedback_published`.
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
        """Stop telling ``observer``; an unknown observer is ignored."""
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
        """Tell the oldest news, then whatever the observers cause meanwhile."""
        # An observer may cause a change, which appends more news while this loop runs. The methods
        # above do not call `_tell` then; the loop gets there after the current news.
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
                except BaseException as error:  # also a stray cancellation
                    problem = "an observer of the goals of %s failed"
                    logger.error(problem, self._action, exc_info=loggable(error))
            self._untold.popleft()
