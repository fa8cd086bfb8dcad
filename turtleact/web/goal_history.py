"""Keeps the goals that the page shows: running goals, and the last goals that have ended.

`turtleact.web.watching` follows the goals, and tells the history what happens. Each change gets the
next revision number. A page asks for the changes after the last revision that it has received.
Times are in seconds by the graph's clock, except that `GoalRecord.at` is by the wall clock. This
module does no I/O.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import takewhile
from typing import Final

import msgspec

from turtleact.goals.state import GoalStatus
from turtleact.interfaces import Message
from turtleact.web.page_values import Plain, excerpt, numbers_in

__all__ = ["MOST_ACTIVE", "MOST_ENDED", "REJECTED", "GoalHistory", "GoalRecord", "Series"]

MOST_ENDED: Final = 200
"""How many ended goals are kept."""

MOST_ACTIVE: Final = 500
"""How many running goals are kept."""

REJECTED: Final = "REJECTED"
"""The status that the page shows for a rejected goal. ROS has no such status."""

MOST_POINTS: Final = 64
"""The maximum number of points of a plot."""


class Series:
    """The values of a number over time, for a plot.

    If there are more than `MOST_POINTS` values, some are dropped, but never the first or the
    newest.
    """

    def __init__(self) -> None:
        self.points: list[tuple[float, float]] = []
        self._spacing = 0.0

    def add(self, time: float, value: float) -> None:
        """Add a value. Its ``time`` must not be earlier than the time of the previous value."""
        points, time = self.points, round(time, 3)
        is_close = len(points) > 1 and time - points[-2][0] < self._spacing
        if is_close or (points and time <= points[-1][0]):
            points.pop()
        points.append((time, value))
        if len(points) > MOST_POINTS:
            self.points = [*points[:-1:2], points[-1]]
            self._spacing = (time - points[0][0]) / (MOST_POINTS / 2)


class GoalRecord:
    """The data of one goal that the page shows.

    Attributes:
        id: The goal's id in hexadecimal. A rejected goal gets a new random id.
        action: The name of the goal's action.
        type: The full name of the action's type.
        accepted: When the goal was accepted or rejected, by the graph's clock (s).
        at: When the goal was accepted or rejected, by the wall clock (s since the epoch).
        status: The name of the goal's status, or `REJECTED`.
        request: An excerpt of the goal message; None if this process does not know the message.
        result: An excerpt of the goal's result; None as long as no result is known.
        reason: Why the goal was aborted or rejected, or why its end is unknown; may be empty.
        duration: How long the goal took (s); None while it runs, or if the time of its end is
            unknown.
        revision: The revision of the record's last change.
        has_ended: Whether the goal has ended.
        is_paused: Whether the goal is paused.
        is_resumed: Whether an earlier process of the action server began the goal.
    """

    def __init__(self, id: str, action: str, type: str, *, accepted: float, at: float) -> None:
        self.id = id
        self.action = action
        self.type = type
        self.accepted = accepted
        self.at = at
        self.status = GoalStatus.ACCEPTED.name
        self.request: Plain = None
        self.result: Plain = None
        self.reason = ""
        self.duration: float | None = None
        self.revision = 0
        self.has_ended = False
        self.is_paused = False
        self.is_resumed = False
        self._series: dict[str, Series] = {}
        self._feedback: Message | Plain = None  # shortened when it is told, or at the end
        self._told = (-1, msgspec.Raw())

    def take(self, feedback: Message, now: float) -> None:
        """Record a feedback message and the numbers in it."""
        self._feedback = feedback
        for path, value in numbers_in(feedback):
            self._series.setdefault(path, Series()).add(now - self.accepted, value)

    def shorten(self) -> None:
        """Replace the newest feedback message by an excerpt, because the message may be large."""
        if isinstance(self._feedback, Message):
            self._feedback = excerpt(self._feedback)

    def told(self) -> msgspec.Raw:
        """Return the record as JSON. The JSON is made once for each revision, not for each page."""
        if self._told[0] != self.revision:
            self._told = self.revision, msgspec.Raw(msgspec.json.encode(self.plain()))
        return self._told[1]

    def plain(self) -> dict[str, object]:
        """Return the record as values that JSON can express."""
        self.shorten()
        series: dict[str, Plain] = {
            path: [[time, value] for time, value in each.points]
            for path, each in self._series.items()
        }
        return {
            "id": self.id,
            "action": self.action,
            "type": self.type,
            "accepted": self.accepted,
            "at": self.at,
            "status": self.status,
            "has_ended": self.has_ended,
            "is_paused": self.is_paused,
            "is_resumed": self.is_resumed,
            "request": self.request,
            "feedback": self._feedback,
            "result": self.result,
            "reason": self.reason,
            "duration": self.duration,
            "series": series,
        }


class Changes(msgspec.Struct, frozen=True):
    """The changes of the history since a revision.

    Attributes:
        goals: The goals that are new or have changed, the latest change first.
        dropped: The ids of goals that were dropped since the revision.
        is_complete: Whether ``dropped`` contains all goals that were dropped since the revision. If
            not, the page needs the whole history again.
    """

    goals: list[GoalRecord]
    dropped: list[str]
    is_complete: bool


class GoalHistory:
    """The goals of all actions, in the order of their last change.

    Args:
        revise: Called at each change. Returns the number of the new revision.
    """

    def __init__(self, revise: Callable[[], int]) -> None:
        self._revise = revise
        self._active: dict[str, GoalRecord] = {}
        self._ended: dict[str, GoalRecord] = {}
        self._dropped: deque[tuple[int, str]] = deque(maxlen=MOST_ENDED + MOST_ACTIVE)
        self._forgotten = 0  # the revision up to which dropped goals are not remembered

    def __len__(self) -> int:
        return len(self._active) + len(self._ended)

    def find(self, id: str) -> GoalRecord | None:
        """Return the record of a goal; None if it is not kept."""
        return self._active.get(id) or self._ended.get(id)

    def change(self, record: GoalRecord) -> None:
        """Give a new or changed record the next revision.

        At most `MOST_ACTIVE` running goals and `MOST_ENDED` ended goals are kept. When a limit is
        exceeded, the goal that has not changed for the longest time is dropped.
        """
        # Taken out and put in again, so that the record changed last is the last one.
        self._active.pop(record.id, None)
        self._ended.pop(record.id, None)
        record.revision = self._revise()
        kept, most = (self._ended, MOST_ENDED) if record.has_ended else (self._active, MOST_ACTIVE)
        kept[record.id] = record
        if len(kept) > most:
            self._drop(kept)

    def end(self, record: GoalRecord, status: str, now: float | None = None) -> None:
        """Record the end of a goal.

        Args:
            record: The record of the goal.
            status: The goal's last status, or `REJECTED`.
            now: When the goal ended (s); None if that is unknown.
        """
        record.status = status
        record.has_ended = True
        record.is_paused = False
        record.shorten()
        if now is not None:
            record.duration = round(now - record.accepted, 3)
        self.change(record)

    def since(self, revision: int) -> Changes:
        """Return the changes after a revision."""
        goals: list[GoalRecord] = []
        for kept in (self._active, self._ended):
            newest_first = reversed(kept.values())
            goals += takewhile(lambda record: record.revision > revision, newest_first)
        goals.sort(key=lambda record: -record.revision)
        dropped = [id for when, id in self._dropped if when > revision]
        return Changes(goals, dropped, is_complete=revision >= self._forgotten)

    def _drop(self, kept: dict[str, GoalRecord]) -> None:
        """Drop the record that has not changed for the longest time."""
        id = next(iter(kept))
        del kept[id]
        if len(self._dropped) == self._dropped.maxlen:
            self._forgotten = self._dropped[0][0]
        self._dropped.append((self._revise(), id))
