"""The drawing of a world's turtles, as pixels and as polylines, and the pens of the turtles.

`Pens` moves each turtle's pen with the turtle, tick by tick. A pen that is on draws a line for each
step and each teleport of its turtle. Within a tick, the turtles are processed in the order of their
names. Each turtle draws its teleports, senses the colour under it, and then draws its step. A
turtle therefore senses the new lines of turtles with earlier names. A turtle does not sense the
line of its own step.

`Drawing` stores new lines, and converts the lines to pixels and polylines when somebody reads the
drawing. An unread drawing therefore costs little. When `UNREAD` lines are stored, the drawing
converts the oldest lines without waiting for a reader. The lines of a fleet arrive as arrays, tick
by tick; `rasterising` joins and draws these lines.

- Pixels show every line, and later lines cover earlier lines.
- A polyline omits a point only if the polyline passes within `TOLERANCE` of the point.
- A polyline continues as long as each new line of its turtle begins at the end of the line before,
  and is drawn with the same pen. A polyline has at most `LONGEST` points.
- The size of a drawing is limited: when its polylines have `MOST_POINTS` points, everything drawn
  so far is kept only as pixels.

Places are complex numbers, ``x + 1j * depth``, in metres. This module knows no ROS and no clock.

Source: turtlesim 1.8.2, ``Turtle::update`` and ``Turtle::setPenCallback``; Sklansky and Gonzalez,
Fast polygonal approximation of digitized curves, 1980, for the cone intersection method, which
chooses the points that a polyline omits.
"""

from __future__ import annotations

import math
import sys
from array import array
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple, cast

from turtleact.geometry import phase
from turtleact.sim.canvas import METER, Canvas, Colour, Pen

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from turtleact.sim.rasterising import Lines, Numbers, Places, Runs
    from turtleact.sim.world import World

__all__ = ["MOST_POINTS", "TOLERANCE", "Drawing", "Pens", "Polyline"]

TOLERANCE: Final = 0.05
"""A polyline omits a point only if the polyline passes at most this far from it (pixels)."""

MOST_POINTS: Final = 20_000
"""The maximum number of points in all polylines together.

This many points take about a megabyte.
"""

LONGEST: Final = 500
"""The maximum number of points in one polyline."""

UNREAD: Final = 4096
"""The maximum number of lines that are stored and not yet converted (200 kB).

When this many lines are stored, the drawing converts the oldest lines.
"""

UNREAD_OF_FLEET: Final = 1024
"""The maximum number of a fleet's lines that are stored and not yet converted.

When this many lines are stored, the drawing converts all lines at once, in a few milliseconds.
"""

_PORTION: Final = 64
"""How many stored lines are converted at a time. The conversion takes about a millisecond."""

_STRAIGHT: Final = 1e-6
"""Lines that bend by less than this (pixels) become one line, because no pixel shows the bend."""

_FIELDS: Final = 6

THINNEST: Final = 1
"""The actual width (pixels) of a pen with the width 0."""


class Polyline(NamedTuple):
    """A line with bends. Its points are in pixels, ``x + 1j * y``, from the upper left corner."""

    pen: Pen
    points: tuple[complex, ...]


class Drawing:
    """Everything drawn since the drawing was made or cleared."""

    def __init__(self) -> None:
        self._fleet: Runs | None = None
        self.clear()

    def line(self, turtle: int, pen: Pen, start: complex, end: complex) -> None:
        """Draw a straight line.

        Args:
            turtle: The number of the turtle. The lines of a turtle are joined into polylines.
            pen: The pen.
            start: Where the line begins, ``x + 1j * depth`` (m).
            end: Where the line ends (m). If ``end`` equals ``start``, a dot is drawn.
        """
        # Finish the fleet's unfinished lines first: they are older, and later lines cover them.
        self._end_fleet()
        self._unread.extend((turtle, _packed(pen), start.real, start.imag, end.real, end.imag))
        if len(self._unread) >= UNREAD * _FIELDS:
            self._read(_PORTION)

    def lines(self, pen: Pen, who: Numbers, start: Places, end: Places) -> None:
        """Draw a straight line for each of several turtles, as `line` does for one turtle.

        Args:
            pen: The pen of all these turtles.
            who: Array of shape (N,): the numbers of the turtles, without duplicates.
            start: Array of shape (N,): where each line begins (m).
            end: Array of shape (N,): where each line ends (m).
        """
        from turtleact.sim.rasterising import Runs  # imports numpy, which only fleets need

        if self._fleet is None or self._fleet.pen != pen:
            self._end_fleet()
            self._fleet = Runs(pen, _STRAIGHT / METER)
        self._note(pen, self._fleet.take(who, start, end))

    def clear(self) -> None:
        """Erase everything."""
        self._unread = array("d")
        self._fleet = None
        self._canvas: Canvas | None = None  # created when needed, since it takes a megabyte
        self._base: bytes | None = None
        self._strokes: list[_Stroke] = []
        self._open: dict[int, _Stroke] = {}
        self._runs: dict[int, _Run] = {}
        self._colour: Colour | None = None
        self._points = 0

    def colour_at(self, place: complex) -> Colour:
        """Return the colour of the pixel nearest to a place (m) inside the walls."""
        x, y = (math.floor(part * METER + 0.5) for part in (place.real, place.imag))
        return self._pixels().colour(x, y)

    def pixels(self) -> bytes:
        """All pixels, row by row from the top: four bytes each, red, green, blue and alpha.

        Alpha is 255 where something was drawn, otherwise 0.
        """
        return _rgba(self._pixels().pixels)

    def base(self) -> bytes | None:
        """Return the pixels of the lines that `polylines` no longer has; None if there are none."""
        self._read()
        return self._base

    def polylines(self) -> list[Polyline]:
        """Return the polylines, in the order in which they were begun."""
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
        """Convert the stored lines, or only the ``most`` oldest lines, to pixels and polylines."""
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
        """Store the fleet's unfinished lines, although later steps could have extended them."""
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
        """Convert all stored lines, as `_read` does.

        If all lines have the same pen, this method is faster than `_read`.
        """
        import numpy as np

        from turtleact.sim.rasterising import draw_lines

        noted = np.frombuffer(self._unread).reshape(-1, _FIELDS).copy()
        # With more than one pen the order counts, and only `_read` keeps it.
        if (noted[:, 1] != noted[0, 1]).any():
            self._read(len(noted))
            return
        self._unread = array("d")
        # Runs of single turtles are older than what was noted, so they are drawn first.
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
        """Keep everything drawn so far only as pixels, and drop the polylines."""
        self._draw_runs()
        self._base = _rgba(self._made_canvas().pixels)
        self._strokes.clear()
        self._open.clear()
        self._points = 0


class Pens:
    """The pens of all turtles in a world. A new pen is on and has the default colour and width.

    Args:
        world: The world of the turtles. Call `follow` after each of its steps.

    Attributes:
        drawing: The drawing that the pens make.
    """

    def __init__(self, world: World) -> None:
        self.drawing = Drawing()
        self._world = world
        self._count = 0
        self._holders: dict[str, _Holder] = {}
        self._jumps: dict[str, list[tuple[complex, complex]]] = {}
        self._fleet: _Fleet | None = None
        self._names: tuple[str, ...] = ()
        self._places: Sequence[complex] = ()
        world.on_jump = self._jump
        self._provide_all()

    def set(self, turtle: str, colour: Colour, width: int = 0, *, is_off: bool = False) -> None:
        """Change a turtle's pen. The change affects the turtle's next lines.

        Args:
            turtle: The turtle's name.
            colour: The colour.
            width: The width (pixels), 0 to 255; 0 means 1.
            is_off: Whether to switch the pen off. If true, the pen's colour and width do not
                change.
        """
        holder = self._holders[turtle]
        self._fleet = None
        holder.is_on = not is_off
        if not is_off:
            holder.pen = Pen(colour, width or THINNEST)

    def colour(self, turtle: str) -> Colour:
        """Return the colour of a turtle's pen, whether the pen is on or off."""
        return self._holders[turtle].pen.colour

    def hand_out(self, turtle: str) -> None:
        """Give a new turtle a pen; call this before the next step."""
        self._provide(turtle)
        self._take_stock()

    def take_back(self, turtle: str) -> None:
        """Remove the pen of a turtle that was removed; call this before the next step."""
        del self._holders[turtle]
        self._jumps.pop(turtle, None)
        self._take_stock()

    def forget_all(self) -> None:
        """Erase the drawing, and give every existing turtle a new pen."""
        self._holders.clear()
        self._jumps.clear()
        self.drawing.clear()
        self._provide_all()

    def follow(self, sensed: Collection[str] = ()) -> dict[str, Colour]:
        """Draw the lines of the world's latest step, including its teleports.

        Args:
            sensed: The names of turtles that sense the colour under them.

        Returns:
            The colours that these turtles sensed, by name.
        """
        before, now = self._places, self._world.places()
        self._places = now
        if not sensed and not self._jumps and self._follow_fleet(before, now):
            return {}
        moved = _indices_of_changes(before, now)
        if not sensed and not self._jumps:
            for index in moved:
                self._draw(self._names[index], before[index], now[index])
            return {}
        # Somebody senses a colour, or a turtle was teleported. The order within the tick now
        # matters, so the turtles draw one after the other, in name order, as in turtlesim.
        index_of = {name: index for index, name in enumerate(self._names)}
        colours: dict[str, Colour] = {}
        wanted = {*sensed, *self._jumps, *(self._names[index] for index in moved)}
        for name in sorted(wanted):
            index = index_of[name]
            start, end = before[index], now[index]
            for here, there in self._jumps.pop(name, ()):
                self._draw(name, here, there)
                start = there
            if name in sensed:
                colours[name] = self.drawing.colour_at(end)
            if start != end:
                self._draw(name, start, end)
        return colours

    def _provide_all(self) -> None:
        for name in self._world.names:
            self._provide(name)
        self._take_stock()

    def _provide(self, turtle: str) -> None:
        self._count += 1
        self._holders[turtle] = _Holder(self._count)

    def _take_stock(self) -> None:
        self._names, self._places = self._world.names, self._world.places()
        self._fleet = None

    def _follow_fleet(self, before: Sequence[complex], now: Sequence[complex]) -> bool:
        """Draw the lines of all turtles at once. Return False if they must be drawn one by one.

        Lines can be drawn at once if there are many turtles, their pens are equal, and no pen is
        off.
        """
        if isinstance(now, list):  # a few turtles: see `World.places`
            return False
        if self._fleet is None:
            self._fleet = _Fleet.of([self._holders[name] for name in self._names])
        if self._fleet.pen is None:
            return False
        there = cast("Places", now)
        here = cast("Places", before)
        (moved,) = (there != here).nonzero()
        if len(moved):
            who = self._fleet.numbers[moved]
            self.drawing.lines(self._fleet.pen, who, here[moved], there[moved])
        return True

    def _draw(self, turtle: str, start: complex, end: complex) -> None:
        holder = self._holders[turtle]
        if holder.is_on:
            self.drawing.line(holder.number, holder.pen, start, end)

    def _jump(self, turtle: str, here: complex, there: complex) -> None:
        self._jumps.setdefault(turtle, []).append((here, there))


class _Holder:
    """A turtle's pen and number. A later turtle of the same name gets another number."""

    __slots__ = ("is_on", "number", "pen")

    def __init__(self, number: int) -> None:
        self.number = number
        self.pen = Pen()
        self.is_on = True


class _Fleet(NamedTuple):
    """The pens of many turtles.

    Attributes:
        numbers: The numbers of the turtles (see `_Holder`), by index.
        pen: The pen that all turtles share; None if their pens differ or a pen is off.
    """

    numbers: Numbers
    pen: Pen | None

    @classmethod
    def of(cls, holders: Sequence[_Holder]) -> _Fleet:
        import numpy as np

        numbers = np.array([holder.number for holder in holders], np.intp)
        pens = {holder.pen if holder.is_on else None for holder in holders}
        return cls(numbers, pens.pop() if len(pens) == 1 else None)


class _Run:
    """A straight line that replaces consecutive lines of one turtle and sets the same pixels."""

    __slots__ = ("end", "pen", "start")

    def __init__(self, pen: Pen, start: complex, end: complex) -> None:
        self.pen = pen
        self.start = start
        self.end = end

    def takes(self, pen: Pen, start: complex, end: complex) -> bool:
        """Append a line if it has the same pen and direction, and begins at the end of this line.

        Return whether the line was appended.
        """
        if start != self.end or pen != self.pen:
            return False
        way, step = self.end - self.start, end - start
        length, more = abs(way), abs(step)
        if not length or not more:  # a dot has no direction
            return False
        turned = step * way.conjugate() / length
        if turned.real < 0.0 or abs(turned.imag) > _STRAIGHT * min(1.0, more / length):
            return False
        self.end = end
        return True


class _Stroke:
    """A polyline that may continue.

    The tip is the newest point. A straight line from the last corner to a new point replaces the
    points since that corner if the line passes within `TOLERANCE` of all these points. Otherwise,
    the old tip becomes a corner.

    The line passes close enough if two conditions are met. The line's direction is between `_low`
    and `_high` (rad, relative to `_axis`). The line is at least as long as `_reach`, the largest
    distance of the replaced points from the corner.
    """

    __slots__ = ("_axis", "_high", "_low", "_reach", "corners", "pen", "tip")

    def __init__(self, pen: Pen, start: complex) -> None:
        self.pen = pen
        self.corners = [start]
        self.tip = start
        self._reach = 0.0
        self._axis = self._low = self._high = 0.0

    def polyline(self) -> Polyline:
        """Return the polyline so far."""
        return Polyline(self.pen, (*self.corners, self.tip))

    def takes(self, pen: Pen, start: complex) -> bool:
        """Whether a line that begins at ``start`` with this pen continues the polyline."""
        return start == self.tip and pen == self.pen and len(self.corners) < LONGEST

    def add(self, point: complex) -> bool:
        """Continue the polyline to a point. Return whether the old tip has become a corner."""
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


def _indices_of_changes(before: Sequence[complex], now: Sequence[complex]) -> list[int]:
    if isinstance(now, list):
        return [i for i, (a, b) in enumerate(zip(before, now, strict=True)) if a != b]
    changed = now != before  # an array of flags
    return changed.nonzero()[0].tolist()  # type: ignore[attr-defined,no-any-return]  # see above
