"""The list of observers: what it calls, and what it spares servers."""

from __future__ import annotations

import pytest

from turtleact.goals.observers import FeedbackLost, GoalObserver, Lost, News, Observers
from turtleact.goals.state import Goal, GoalStatus

from ..lab import bare_goal


class OfPauses(GoalObserver):
    def pause_changed(self, goal: Goal, is_paused: bool) -> None:
        """Hear of it."""


class OfNews(GoalObserver):
    def __init__(self) -> None:
        self.heard: list[object] = []

    def noted(self, goal: Goal, news: News) -> None:
        self.heard.append(news)

    def goal_rejected(self, reason: str) -> None:
        self.heard.append(reason)

    def closed(self) -> None:
        self.heard.append("closed")


class OfBodies(GoalObserver):
    def enter_body(self, goal: Goal) -> None:
        raise ValueError("a bad observer")


def test_an_observer_hears_of_all_that_happens():
    observers = Observers("/count")
    observers.add(observer := OfNews())
    observers.noted(bare_goal(), FeedbackLost(3))
    observers.noted(bare_goal(), Lost(GoalStatus.EXECUTING))
    observers.goal_rejected("busy")
    observers.closed()
    assert observer.heard == [FeedbackLost(3), Lost(GoalStatus.EXECUTING), "busy", "closed"]


@pytest.mark.parametrize(("kind", "wanted"), [(OfPauses, False), (OfNews, True)])
def test_an_observer_of_pauses_costs_goals_nothing(kind, wanted):
    observers = Observers("/count")
    observers.add(kind())
    assert observers.are_any is wanted


def test_an_observer_that_fails_as_a_body_begins_is_logged(caplog):
    observers = Observers("/count")
    assert "enter_body" not in observers.wanted
    observers.add(OfBodies())
    assert "enter_body" in observers.wanted
    observers.enter_body(bare_goal())
    assert "a bad observer" in caplog.text
