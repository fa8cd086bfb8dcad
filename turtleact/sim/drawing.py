"""What the turtles have drawn: line by line, as pixels and as polylines.

Lines are noted as they come and worked out when somebody looks, so a drawing costs little while
nobody does; of more than `UNREAD` the oldest are worked out then and there. Those of a fleet come
tick by tick as arrays: straight ways are put together as they come, and all is worked out at once.
It never grows beyond a bound: once its polylines hold `MOST_POINTS` points, all that was drawn so
far is kept as pixels alone.

- As pixels every line counts, in its order: what is drawn later covers what is there.
- As polylines, points that lie within `TOLERANCE` of the line without them are left out. A polyline
  goes on for as long as its turtle draws with one pen from where it stopped, `LONGEST` points at
  most.

Places are ``x + 1j * depth`` in metres. Knows no ROS and no clock.

Source: turtlesim 1.8.2, ``Turtle::update``; for leaving out points the cone intersection method
(Sklansky and Gonzalez, Fast polygonal approximation of digitized curves, 1980).
"""

from __future__ import annotations

import math
import sys
from array import array
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

from turtleact.geometry import phase
from turtleact.sim.canvas import METER, Canvas, Colour

if TYPE_CHECKING:
    from turtleact.sim.runs import Lines, Numbers, Places, Runs

__all__ = ["MOST_POINTS", "TOLERANCE", "Drawing", "Pen", "Polyline"]

TOLERANCE: Final = 0.05
"""How far a point that is left out may lie from the polyline (pixels): a twentieth."""

MOST_POINTS: Final = 20_000
"""So many points are kept in polylines: about a megabyte."""

LONGEST: Final = 500
"""Points of a polyline; behind that a new one is begun."""

UNREAD: Final = 4096
"""So many lines are noted before the oldest are worked out: 200 kB."""

UNREAD_OF_FLEET: Final = 1024
"""So many, if a fleet draws: all are worked out at once then, in some milliseconds."""

_PORTION: Final = 64
"""So many are worked out at a time then: a millisecond."""

_STRAIGHT: Final = 1e-6
"""Lines that bend by less (pixels) are one line: no pixel shows it."""

_FIELDS: Final = 6


class Pen(NamedTuple):
    """What a turtle draws with: colour, and width in pixels, above zero."""

    colour: Colour = Colour(179, 184, 255)
    width: int = 3


class Polyline(NamedTuple):
    """A line with bends, in pixels ``x + 1j * y`` from the upper left corner."""

    pen: Pen
    points: tuple[complex, ...]


class Drawing:
    """Everything drawn since it was made or cleared."""

    def __init__(self) -> None:
        self._fleet: Runs | None = None
        self.clear()

    def line(self, turtle: int, pen: Pen, start: complex, end: complex) -> None:
        """Draw a straight line.

        Args:
            turtle: Who draws it: its lines make one polyline.
            pen: With what.
            start: Where it begins (m).
            end: Where it ends (m); the same place makes a dot.
        """
        self._end_fleet()
        self._unread.extend((turtle, _packed(pen), start.real, start.imag, end.real, end.imag))
        if len(self._unread) >= UNREAD * _FIELDS:
            self._read(_PORTION)

    def lines(self, pen: Pen, who: Numbers, start: Places, end: Places) -> None:
        """Draw straight lines of many turtles, in any order; as `line` otherwise.

        Args:
            pen: With what.
            who: Who draws them, each turtle once.
            start: Where each begins (m).
            end: Where it ends.
        """
        from turtleact.sim.runs import Runs  # only a fleet waits for numpy

        if self._fleet is None or self._fleet.pen != pen:
            self._end_fleet()
            self._fleet = Runs(pen, _STRAIGHT / METER)
        self._note(pen, self._fleet.take(who, start, end))

    def clear(self) -> None:
        """Erase everything."""
        self._unread = array("d")
        self._fleet = None
        self._canvas: Canvas | None = None  # a megabyte: made when it is needed
        self._base: bytes | None = None
        self._strokes: list[_Stroke] = []
        self._open: dict[int, _Stroke] = {}
        self._runs: dict[int, _Run] = {}
        self._colour: Colour | None = None
        self._points = 0

    def colour_at(self, place: complex) -> Colour:
        """The colour under a turtle: of the pixel nearest to its place, inside the walls (m)."""
        x, y = (math.floor(part * METER + 0.5) for part in (place.real, place.imag))
        return self._pixels().colour(x, y)

    def pixels(self) -> bytes:
        """All pixels, row by row from the top: red, green, blue, alpha; alpha is 0 or 255."""
        return _rgba(self._pixels().pixels)

    def base(self) -> bytes | None:
        """The pixels of what is kept as such alone, or None if there is nothing of the kind."""
        self._read()
        return self._base

    def polylines(self) -> list[Polyline]:
        """All the rest, in the order of their beginning."""
        self._read()
        return [stroke.polyline() for stroke in self._strokes]

    def _pixels(self) -> Canvas:
        self._read()
        return self._made_canvas()

    def _made_canvas(self) -> Canvas:
        if self._canvas is None:
            self._canvas = Canvas()
        return self._canvas

    def _read(self, most: int | None = None) -> None:
        """Work out what was noted: all of it, or the oldest lines."""
        if most is None:
            self._end_fleet()
        if not self._unread and not self._runs:
            return
        end = len(self._unread) if most is None else most * _FIELDS
        numbers = iter(self._unread[:end])
        del self._unread[:end]
        for turtle, packed, x0, y0, x1, y1 in zip(*[numbers] * _FIELDS, strict=True):
            pen, who = _unpacked(packed), int(turtle)
            start, stop = complex(x0, y0) * METER, complex(x1, y1) * METER
            if pen.colour != self._colour:  # lines of one colour may be drawn in any order
                self._draw_runs()
                self._colour = pen.colour
            run = self._runs.get(who)
            if run is None or not run.takes(pen, start, stop):
                if run is not None:
                    self._draw(run)
                self._runs[who] = _Run(pen, start, stop)
            self._extend(who, pen, start, stop)
        if most is None:
            self._draw_runs()

    def _end_fleet(self) -> None:
        """Note the lines of a fleet that might still go on."""
        if self._fleet is not None:
            self._note(self._fleet.pen, self._fleet.take_all())

    def _note(self, pen: Pen, lines: Lines) -> None:
        import numpy as np

        who, start, end = lines
        if not len(who):
            return
        noted = np.empty((len(who), _FIELDS))
        noted[:, 0], noted[:, 1] = who, _packed(pen)
        noted[:, 2], noted[:, 3] = start.real, start.imag
        noted[:, 4], noted[:, 5] = end.real, end.imag
        self._unread.frombytes(noted.tobytes())
        if len(self._unread) >= UNREAD_OF_FLEET * _FIELDS:
            self._read_fleet()

    def _read_fleet(self) -> None:
        """Work out all that was noted, as `_read` does, but at once what has one pen."""
        import numpy as np

        from turtleact.sim.strips import draw_lines

        noted = np.frombuffer(self._unread).reshape(-1, _FIELDS).copy()
        if (noted[:, 1] != noted[0, 1]).any():
            self._read(len(noted))
            return
        self._unread = array("d")
        self._draw_runs()
        pen = _unpacked(noted[0, 1])
        start = noted[:, 2:4].copy().view(np.complex128)[:, 0] * METER
        end = noted[:, 4:6].copy().view(np.complex128)[:, 0] * METER
        draw_lines(self._made_canvas(), start, end, pen.width, pen.colour)
        for who, here, there in zip(
            noted[:, 0].tolist(), start.tolist(), end.tolist(), strict=True
        ):
            self._extend(int(who), pen, here, there)

    def _draw_runs(self) -> None:
        for run in self._runs.values():
            self._draw(run)
        self._runs.clear()

    def _draw(self, run: _Run) -> None:
        self._made_canvas().line(run.start, run.end, run.pen.width, run.pen.colour)

    def _extend(self, turtle: int, pen: Pen, start: complex, end: complex) -> None:
        stroke = self._open.get(turtle)
        if stroke is None or not stroke.takes(pen, start):
            stroke = self._open[turtle] = _Stroke(pen, start)
            self._strokes.append(stroke)
            self._points += 1
        self._points += stroke.add(end)
        if self._points >= MOST_POINTS:
            self._settle()

    def _settle(self) -> None:
        """Keep as pixels alone what is there so far."""
        self._draw_runs()
        self._base = _rgba(self._made_canvas().pixels)
        self._strokes.clear()
        self._open.clear()
        self._points = 0


class _Run:
    """Lines of one turtle that go straight on: one line, as far as any pixel can tell."""

    __slots__ = ("end", "pen", "start")

    def __init__(self, pen: Pen, start: complex, end: complex) -> None:
        self.pen = pen
        self.start = start
        self.end = end

    def takes(self, pen: Pen, start: complex, end: complex) -> bool:
        """Go on to ``end``, if that is straight ahead."""
        if start != self.end or pen != self.pen:
            return False
        way, step = self.end - self.start, end - start
        length, more = abs(way), abs(step)
        if not length or not more:  # a dot lies level, whatever the way
            return False
        turned = step * way.conjugate() / length
        if turned.real < 0.0 or abs(turned.imag) > _STRAIGHT * min(1.0, more / length):
            return False
        self.end = end
        return True


class _Stroke:
    """A polyline that may go on.

    The last corner sees every point behind it, up to the tip, in a narrow cone: `_low` to `_high`
    (rad), counted from `_axis`. A tip inside the cone, and no nearer than those before, leaves all
    of them within `TOLERANCE` of the straight line to it; any other makes the tip a corner.
    """

    __slots__ = ("_axis", "_high", "_low", "_reach", "corners", "pen", "tip")

    def __init__(self, pen: Pen, start: complex) -> None:
        self.pen = pen
        self.corners = [start]
        self.tip = start
        self._reach = 0.0
        self._axis = self._low = self._high = 0.0

    def polyline(self) -> Polyline:
        """What it is so far."""
        return Polyline(self.pen, (*self.corners, self.tip))

    def takes(self, pen: Pen, start: complex) -> bool:
        """Whether a line with this pen from there goes on where it stops."""
        return start == self.tip and pen == self.pen and len(self.corners) < LONGEST

    def add(self, point: complex) -> bool:
        """Go on to a point; tells whether there is a new corner."""
        is_bent = not self._sees(point)
        if is_bent:
            self.corners.append(self.tip)
            self._reach = 0.0
            self._sees(point)
        self.tip = point
        return is_bent

    def _sees(self, point: complex) -> bool:
        way = point - self.corners[-1]
        distance = abs(way)
        if distance < self._reach:
            return False
        if distance <= TOLERANCE:
            return True
        half = math.asin(TOLERANCE / distance)
        if self._reach:
            off = math.remainder(phase(way) - self._axis, math.tau)
            if not self._low <= off <= self._high:
                return False
            self._low, self._high = max(self._low, off - half), min(self._high, off + half)
        else:
            self._axis, self._low, self._high = phase(way), -half, half
        self._reach = distance
        return True


def _packed(pen: Pen) -> int:
    (red, green, blue), width = pen
    return red << 24 | green << 16 | blue << 8 | width


@lru_cache(maxsize=64)
def _unpacked(number: float) -> Pen:
    packed = int(number)
    colour = Colour(packed >> 24, packed >> 16 & 255, packed >> 8 & 255)
    return Pen(colour, packed & 255)


def _rgba(pixels: array[int]) -> bytes:
    if sys.byteorder == "big":
        pixels = array("I", pixels)
        pixels.byteswap()
    return pixels.tobytes()
