"""Tells observers about the goals of a server or client.

The status topic, users' hooks and telemetry are observers. Each server or client has one list of
its observers. An observer only watches: if it raises an exception, the exception is logged and does
not affect the goal.

Each change is reported to all observers before the next change is reported to any of them. An
observer may itself cause a change, for example by canceling a goal. The other observers still get
the current change before the new one.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import Any, Final, TypeAlias

import msgspec

from turtleact.errors import STOPS
from turtleact.goals.state import CURRENT_GOAL, Goal, GoalRequest, GoalStatus
from turtleact.transports.base import Source

__all__ = [
    "BodyFailed",
    "Detached",
    "FeedbackLost",
    "GoalObserver",
    "Hook",
    "Lost",
    "News",
    "Observers",
    "ObservingSource",
]

logger = logging.getLogger("turtleact")


class BodyFailed(msgspec.Struct, frozen=True):
    """The body raised an unexpected exception. The goal will now end ABORTED."""

    error: BaseException


class Detached(msgspec.Struct, frozen=True):
    """The client has left the goal's ``async with`` block after ``detach()``.

    The goal continues.
    """


class FeedbackLost(msgspec.Struct, frozen=True):
    """Some feedback messages did not reach a client, or the server never sent them."""

    count: int


class Lost(msgspec.Struct, frozen=True):
    """The server stops before the goal ends. The goal continues after the server restarts.

    Attributes:
        before: The goal's state before the server stopped.
    """

    before: GoalStatus


News: TypeAlias = BodyFailed | Detached | FeedbackLost | Lost
"""News about a goal, other than state changes, feedback messages and pauses."""

_News: TypeAlias = tuple[str, tuple[object, ...]]  # a method of observers, and its arguments


class GoalObserver:
    """The base class of observers, which watch goals.

    A subclass overrides only the methods that the subclass needs.
    """

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Called after a goal has changed its state. For a new goal, ``before`` is UNKNOWN."""

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        """Called with each feedback message. Observers must not change the message."""

    def pause_changed(self, goal: Goal, is_paused: bool) -> None:
        """Called after a server has paused or resumed ``goal``."""

    def noted(self, goal: Goal, news: News) -> None:
        """Called with other news about a goal, for example that the body failed; see `News`."""

    def goal_rejected(self, reason: str) -> None:
        """Called when a server rejects a goal."""

    def closed(self) -> None:
        """Called when the client closes.

        The client's goals may continue, but the client's observers get no more calls.
        """

    def enter_body(self, goal: Goal) -> None:
        """Called before a body starts, in the body's context, to set context variables."""

    def enter_call(self, request: GoalRequest) -> None:
        """Called before a client sends a goal, in the sender's `contextvars` context.

        The observer may set context variables, and resets them in `leave_call`. It may also set the
        goal's id in ``request``, to recognise the goal later.
        """

    def leave_call(self, request: GoalRequest, error: BaseException | None) -> None:
        """Called when the call that sent a goal returns or raises.

        The call may have waited for the goal's result, or only for the goal's acceptance. ``error``
        is the exception that the call raised; None if the call returned.
        """


_METHODS: Final = tuple(
    name
    for name, value in vars(GoalObserver).items()
    if not name.startswith("_") and not isinstance(value, property)
)


class Hook(GoalObserver):
    """Calls a user's function at each change of a goal's state.

    Args:
        hook: The function. Its arguments are the goal's handle, the old state and the new state.
        make_handle: A function that makes the handle.
    """

    def __init__(
        self,
        hook: Callable[[Any, GoalStatus, GoalStatus], object],
        make_handle: Callable[[Goal], object],
    ) -> None:
        self._hook = hook
        self._make_handle = make_handle

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Call the hook."""
        # Without a current goal, a goal that the hook sends does not become a child of this one.
        token = CURRENT_GOAL.set(None)
        try:
            self._hook(self._make_handle(goal), before, after)
        finally:
            CURRENT_GOAL.reset(token)


class Observers:
    """The observers of one server or client.

    Args:
        action: The name of the action, for the log.

    Attributes:
        are_any: Whether any observer overrides `goal_changed`, `feedback_published` or `noted`.
            If ``are_any`` is False, these three methods need not be called.
        wanted: The names of the methods that any observer overrides. The others need not be called.
    """

    __slots__ = (
        "_action",
        "_is_telling",
        "_listeners",
        "_observers",
        "_untold",
        "are_any",
        "wanted",
    )

    def __init__(self, action: str) -> None:
        self._action = action
        self._observers: tuple[GoalObserver, ...] = ()
        self._listeners: dict[str, tuple[Callable[..., None], ...]] = {}
        self._untold: deque[_News] = deque()
        self._is_telling = False
        self._set(())

    def add(self, observer: GoalObserver) -> None:
        """Notify ``observer`` of every change from now on."""
        self._set((*self._observers, observer))

    def remove(self, observer: GoalObserver) -> None:
        """Stop notifying ``observer`` of changes. Do nothing if ``observer`` was not added."""
        self._set(tuple(each for each in self._observers if each is not observer))

    def goal_changed(self, goal: Goal, before: GoalStatus, after: GoalStatus) -> None:
        """Tell all observers of a goal's new state."""
        self._tell("goal_changed", goal, before, after)

    def feedback_published(self, goal: Goal, feedback: object) -> None:
        """Tell all observers of a feedback message."""
        self._tell("feedback_published", goal, feedback)

    def pause_changed(self, goal: Goal, is_paused: bool) -> None:
        """Tell all observers that a goal was paused or resumed."""
        self._tell("pause_changed", goal, is_paused)

    def noted(self, goal: Goal, news: News) -> None:
        """Tell all observers other news about a goal, for example that the body failed."""
        self._tell("noted", goal, news)

    def goal_rejected(self, reason: str) -> None:
        """Tell all observers that a goal was rejected."""
        self._tell("goal_rejected", reason)

    def closed(self) -> None:
        """Tell all observers that the client was closed."""
        self._tell("closed")

    def enter_body(self, goal: Goal) -> None:
        """Let all observers set context variables for a body. Call this in the body's context."""
        self._call("enter_body", (goal,))

    def enter_call(self, request: GoalRequest) -> None:
        """Call `GoalObserver.enter_call` of all observers before a goal is sent.

        Call this in the context in which the goal is sent.
        """
        self._call("enter_call", (request,))

    def leave_call(self, request: GoalRequest, error: BaseException | None) -> None:
        """Tell all observers that the call that sent a goal returned or raised."""
        self._call("leave_call", (request, error))

    def _set(self, observers: tuple[GoalObserver, ...]) -> None:
        self._observers = observers
        self._listeners = {
            method: tuple(
                getattr(each, method)
                for each in observers
                if getattr(type(each), method) is not getattr(GoalObserver, method)
            )
            for method in _METHODS
        }
        self.wanted = frozenset(name for name, calls in self._listeners.items() if calls)
        # Every server has an observer that only hears of pauses. It must not slow down all goals.
        self.are_any = not self.wanted.isdisjoint(("goal_changed", "feedback_published", "noted"))

    def _tell(self, method: str, *news: object) -> None:
        """Call a method of all observers.

        If an observer causes another change, that change is reported only after all observers have
        got the current change.
        """
        if self._is_telling:  # an observer has caused this; the call below tells it next
            self._untold.append((method, news))
            return
        self._is_telling = True
        try:
            self._call(method, news)
            while self._untold:
                self._call(*self._untold.popleft())
        finally:
            self._untold.clear()  # not empty only if the program ends
            self._is_telling = False

    def _call(self, method: str, news: tuple[object, ...]) -> None:
        for listener in self._listeners[method]:
            try:
                listener(*news)
            except STOPS:
                raise
            except BaseException as error:  # also a stray cancellation
                problem = "an observer of the goals of %s failed"
                logger.error(problem, self._action, exc_info=error)


class ObservingSource(Source, GoalObserver):
    """Makes the messages of a topic about goals.

    It observes the goals only while the topic has readers, because observing costs time for each
    goal.
    """

    def __init__(self, observers: Observers) -> None:
        self._observers = observers

    def readers_changed(self, *, has_readers: bool) -> None:
        """Start to observe goals if the topic has readers; otherwise stop."""
        self._observers.remove(self)
        if has_readers:
            self._observers.add(self)
