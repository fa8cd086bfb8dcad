"""Observers of the goals of a server or client: one list for all purposes.

The status topic and users' hooks are observers; recordings and telemetry can be. An observer only
watches. The list logs whatever an observer raises, so that it never affects a goal.

Order: all observers hear of one change before any hears of the next. If an observer causes a
change, for example by canceling a goal, all observers hear of the current change first.
"""

from __future__ import annotations

import logging
from collections import deque
from typing import TypeAlias

from turtleact.goal import Goal, GoalStatus
from turtleact.summaries import STOPS, loggable

__all__ = ["GoalObserver", "Observers"]

logger = logging.getLogger("turtleact")

_News: TypeAlias = tuple[Goal, GoalStatus, GoalStatus] | tuple[Goal, object] | tuple[Goal]


class GoalObserver:
    """Watches goals. A subclass overrides the methods it needs."""

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Called after a goal has changed its state. For a new goal, ``before`` is UNKNOWN."""

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        """Called with each feedback message, which must not be changed."""

    def pause_changed(self, goal: Goal) -> None:
        """Called after a server has paused or resumed a goal; ``is_paused`` tells which."""


class Observers:
    """The observers of one server or client.

    Args:
        action: The name of the action, for the log.

    Attributes:
        are_any: Whether there are any observers. A server checks this before it calls anything.
        want_feedback: Whether any observer overrides `feedback_published`.
    """

    __slots__ = ("_action", "_is_telling", "_observers", "_untold", "are_any", "want_feedback")

    def __init__(self, action: str) -> None:
        self._action = action
        self._observers: tuple[GoalObserver, ...] = ()
        self._untold: deque[_News] = deque()
        self._is_telling = False
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
        self._tell((goal, before, after))

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        """Tell all observers of a feedback message."""
        self._tell((goal, feedback))

    def pause_changed(self, goal: Goal) -> None:
        """Tell all observers that a goal was paused or resumed."""
        self._tell((goal,))

    def _set(self, observers: tuple[GoalObserver, ...]) -> None:
        self._observers = observers
        self.are_any = bool(observers)
        self.want_feedback = any(
            type(each).feedback_published is not GoalObserver.feedback_published
            for each in observers
        )

    def _tell(self, news: _News) -> None:
        """Tell all observers one piece of news, then whatever they cause meanwhile."""
        if self._is_telling:  # an observer has caused this; the call below tells it next
            self._untold.append(news)
            return
        self._is_telling = True
        try:
            while True:
                for observer in self._observers:
                    try:
                        if len(news) == 3:
                            observer.goal_changed(*news)
                        elif len(news) == 2:
                            observer.feedback_published(*news)
                        else:
                            observer.pause_changed(*news)
                    except STOPS:
                        raise
                    except BaseException as error:  # also a stray cancellation
                        problem = "an observer of the goals of %s failed"
                        logger.error(problem, self._action, exc_info=loggable(error))
                if not self._untold:
                    return
                news = self._untold.popleft()
        finally:
            self._untold.clear()  # not empty only if the program ends
            self._is_telling = False
