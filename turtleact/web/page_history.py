"""Keeps what a page that opens later must be told: goals, and the lines that turtles have drawn.

`turtleact.web.watching` follows goals and turtles, and tells this module what happens. Each change
gets the next revision number. A page asks for the changes after the last revision that it has
received. Times are in seconds by the graph's clock, except that `GoalRecord.at` is by the wall
clock. This module does no I/O.

The lines are made from poses, because no topic publishes the drawing. Web clients report when they
set a pen or clear the drawing. If another program does so, the lines here stay unchanged.

Source: turtlesim ``turtle.cpp`` for the first pen.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from itertools import takewhile
from typing import Any, Final, TypeAlias

import msgspec

from turtleact.geometry import distance
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import Message
from turtleact.web.page_values import excerpt, numbers_in

__all__ = [
    "FIRST_PEN",
    "MOST_ACTIVE",
    "MOST_CORNERS",
    "MOST_ENDED",
    "MOST_LINES",
    "MOST_POINTS",
    "REJECTED",
    "GoalHistory",
    "GoalRecord",
    "Pen",
    "PenTrails",
    "Series",
    "Tail",
]

MOST_ENDED: Final = 200
"""How many ended goals are kept."""

MOST_ACTIVE: Final = 500
"""How many running goals are kept."""

REJECTED: Final = "REJECTED"
"""The status that the page shows for a rejected goal. ROS has no such status."""

MOST_POINTS: Final = 64
"""The maximum number of points of a plot."""

MOST_LINES: Final = 128
"""The maximum number of turtles whose lines are kept, including turtles that no longer exist."""

MOST_CORNERS: Final = 2000
"""The maximum number of points of one turtle's line. The oldest points are dropped."""

DETOUR: Final = 0.00003
"""How much longer a turtle's way between two points may be than the straight line (m)."""

LONGEST: Final = 0.3
"""The maximum length of a straight piece (m), so that a long arc is not taken for a line."""


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


class GoalRecord(msgspec.Struct, eq=False):
    """The data of one goal that the page shows.

    Attributes:
        id: The goal's id in hexadecimal. A rejected goal gets a new random id.
        action: The name of the goal's action.
        type: The full name of the action's type.
        accepted: When the goal was accepted or rejected, by the graph's clock (s).
        at: When the goal was accepted or rejected, by the wall clock (s since the epoch).
        status: The name of the goal's status, or `REJECTED`.
        request: An excerpt of the goal message; None if this process does not know the message.
        feedback: An excerpt of the newest feedback message; None before the first.
        result: An excerpt of the goal's result; None as long as no result is known.
        reason: Why the goal was aborted or rejected, or why its end is unknown; may be empty.
        duration: How long the goal took (s); None while it runs, or if the time of its end is
            unknown.
        revision: The revision of the record's last change.
        has_ended: Whether the goal has ended.
        is_paused: Whether the goal is paused.
        is_resumed: Whether an earlier process of the action server began the goal.
        series: The numbers in the feedback over time, by their paths.
    """

    id: str
    action: str
    type: str
    accepted: float
    at: float
    status: str = GoalStatus.ACCEPTED.name
    request: Any = None
    feedback: Any = None
    result: Any = None
    reason: str = ""
    duration: float | None = None
    revision: int = 0
    has_ended: bool = False
    is_paused: bool = False
    is_resumed: bool = False
    series: dict[str, Series] = msgspec.field(default_factory=dict)

    def take(self, feedback: Message, now: float) -> None:
        """Record a feedback message and the numbers in it."""
        self.feedback = excerpt(feedback)
        for path, value in numbers_in(feedback):
            self.series.setdefault(path, Series()).add(now - self.accepted, value)

    def told(self) -> msgspec.Raw:
        """Return the record as JSON."""
        return msgspec.Raw(msgspec.json.encode(self, enc_hook=_points_of))


def _points_of(series: Series) -> list[tuple[float, float]]:
    return series.points


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


class Pen(msgspec.Struct, frozen=True):
    """A turtle's pen.

    Attributes:
        colour: The pen's colour in CSS notation, such as ``#b3b8ff``.
        width: The pen's width in pixels of turtlesim's window, which is 500 pixels wide.
        is_off: Whether the pen is off, so that it draws nothing.
    """

    colour: str
    width: int
    is_off: bool = False


FIRST_PEN: Final = Pen("#b3b8ff", 3)
LIFTED: Final = Pen("", 0, is_off=True)

Point: TypeAlias = tuple[int, float, float, Pen]
"""The revision, x (m), y (m), and the pen that drew the line to this point."""


class Tail(msgspec.Struct, frozen=True):
    """The part of a line that a page does not have yet.

    Attributes:
        is_whole: Whether this is the whole line, which then replaces the line that the page has.
        points: For each point, its x (m), its y (m), and the colour and the width (pixels) of the
            pen. The colour is empty if no line leads to the point.
    """

    is_whole: bool
    points: list[tuple[float, float, str, int]]


class PenTrails:
    """The lines of all turtles.

    Args:
        revise: Called at each change. Returns the number of the new revision.
    """

    def __init__(self, revise: Callable[[], int]) -> None:
        self._revise = revise
        self._lines: dict[str, _Line] = {}

    def follow(self, name: str, x: float, y: float) -> None:
        """Record a turtle's new position (m), and continue the turtle's line to this position."""
        self._line(name).follow((x, y), self._revise)

    def set_pen(self, name: str, pen: Pen) -> None:
        """Change the pen with which a turtle draws from now on."""
        line = self._line(name)
        line.turn(self._revise)
        line.pen = pen

    def lift(self, name: str) -> None:
        """Record that a turtle is gone.

        No line will lead from the turtle's last position to a new turtle with the same name.
        """
        if name in self._lines:
            self._lines[name].lift()

    def clear(self) -> None:
        """Erase all lines. The pens stay unchanged."""
        for name, line in self._lines.items():
            self._lines[name] = _Line(self._revise())
            self._lines[name].pen = line.pen

    def reset(self) -> None:
        """Erase all lines, and give every turtle `FIRST_PEN`."""
        for name in self._lines:
            self._lines[name] = _Line(self._revise())

    def since(self, revision: int) -> dict[str, Tail]:
        """Return the new parts of the lines that have changed after a revision, by turtle name."""
        tails = {name: line.since(revision) for name, line in self._lines.items()}
        return {name: tail for name, tail in tails.items() if tail.is_whole or tail.points}

    def _line(self, name: str) -> _Line:
        line = self._lines.get(name)
        if line is None:
            if len(self._lines) >= MOST_LINES:
                self._lines.pop(min(self._lines, key=lambda each: self._lines[each].is_drawn))
            line = self._lines[name] = _Line(self._revise())
        return line


class _Line:
    """One turtle's line.

    Attributes:
        pen: The pen that draws the line.
    """

    def __init__(self, revision: int) -> None:
        self.pen = FIRST_PEN
        self._points: list[Point] = []
        self._begun = revision
        self._here: tuple[float, float] | None = None

    @property
    def is_drawn(self) -> bool:
        """Whether the line's turtle still exists."""
        return self._here is not None

    def follow(self, there: tuple[float, float], revise: Callable[[], int]) -> None:
        here, self._here = self._here, there
        if here == there:
            return
        if here is None:
            self._add(there, revise, LIFTED)
            return
        last = self._points[-1][1:3]
        # A straight piece from the last point to there would pass by this place. If the way through
        # this place is longer, there was a corner here, and it becomes a point.
        to_here = distance(*last, *here)
        detour = to_here + distance(*here, *there) - distance(*last, *there)
        if detour > DETOUR or to_here > LONGEST:
            self._add(here, revise)

    def turn(self, revise: Callable[[], int]) -> None:
        """Add the turtle's current position to the points of the line."""
        if self._here is not None:
            self._add(self._here, revise)

    def lift(self) -> None:
        """Record that the turtle is gone. No line leads from its last position to a new turtle."""
        self._here = None

    def since(self, revision: int) -> Tail:
        is_whole = self._begun > revision
        first = 0 if is_whole else bisect_right(self._points, revision, key=_revision_of)
        return Tail(
            is_whole,
            [
                (round(x, 3), round(y, 3), "" if pen.is_off else pen.colour, pen.width)
                for _, x, y, pen in self._points[first:]
            ],
        )

    def _add(
        self, place: tuple[float, float], revise: Callable[[], int], pen: Pen | None = None
    ) -> None:
        self._points.append((revise(), *place, pen or self.pen))
        if len(self._points) > MOST_CORNERS:
            del self._points[: MOST_CORNERS // 8]


def _revision_of(point: Point) -> int:
    return point[0]
