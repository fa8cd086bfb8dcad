"""Keeps the lines that turtles have drawn, for pages that are opened later.

The lines are made from poses, because no topic publishes the drawing. Web clients report to this
module when they set a pen or clear the drawing. If another program sets a pen or clears the
drawing, the lines here stay unchanged. This module does no I/O.

Source: turtlesim ``turtle.cpp`` for the first pen.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from typing import Final, TypeAlias

import msgspec

from turtleact.geometry import distance

__all__ = ["FIRST_PEN", "MOST_LINES", "MOST_POINTS", "Pen", "PenTrails", "Tail"]

MOST_LINES: Final = 128
"""The maximum number of turtles whose lines are kept, including turtles that no longer exist."""

MOST_POINTS: Final = 2000
"""The maximum number of points of one turtle's line. The oldest points are dropped."""

DETOUR: Final = 0.00003
"""How much longer a turtle's way between two points may be than the straight line (m)."""

LONGEST: Final = 0.3
"""The maximum length of a straight piece (m), so that a long arc is not taken for a line."""


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
        if len(self._points) > MOST_POINTS:
            del self._points[: MOST_POINTS // 8]


def _revision_of(point: Point) -> int:
    return point[0]
