"""The drawing of a world's turtles, as pixels and as polylines, and the pens of the turtles.

`Pens` moves each turtle's pen with the turtle, tick by tick. A pen that is on draws a line for each
step and each teleport of its turtle. Within a tick, the turtles are processed in the order of their
names. Each turtle draws its teleports, senses the colour under it, and then draws its step. A
turtle therefore senses the new lines of turtles with earlier names. A turtle does not sense the
line of its own step.

`Drawing` joins the straight steps of a turtle into one line, and stores lines until somebody reads
the drawing, or until `UNREAD` lines are stored. Then it converts them to pixels and polylines.

- Pixels show every line, and later lines cover earlier lines.
- A polyline omits a point only if the polyline passes within `TOLERANCE` of the point.
- A polyline continues as long as each new line of its turtle begins at the end of the line before,
  and is drawn with the same pen. A polyline has at most `LONGEST` points.
- The size of a drawing is limited: when its polylines have `MOST_POINTS` points, everything drawn
  so far is kept only as pixels.

`Canvas` is the picture of 500×500 pixels, with lines without antialiasing. A line is drawn as a
rectangle that is as wide as the pen. The rectangle extends half the pen's width beyond both ends of
the line. A pixel is coloured if its centre lies inside the rectangle, or on its left or upper edge.

Places are complex numbers, ``x + 1j * depth``, in metres. This module knows no ROS and no clock.

Source: turtlesim 1.8.2, ``Turtle::update``, ``Turtle::setPenCallback`` and ``path_image_``; Qt 5,
``QPen`` (square caps) and "Coordinate System" (fill rule); Sklansky and Gonzalez,
Fast polygonal approximation of digitized curves, 1980, for the cone intersection method, which
chooses the points that a polyline omits.
"""

from __future__ import annotations

import math
from itertools import groupby
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from turtleact.geometry import phase
from turtleact.sim.pictures import METER, SIZE, Colour, Pen, Polyline

if TYPE_CHECKING:
    from collections.abc import Collection

    from turtleact.sim.world import World

__all__ = ["CLEAR", "MOST_POINTS", "TOLERANCE", "Canvas", "Drawing", "Pens"]

TOLERANCE: Final = 0.05
"""A polyline omits a point only if the polyline passes at most this far from it (pixels)."""

MOST_POINTS: Final = 20_000
"""The maximum number of points in all polylines together.

This many points take about a megabyte.
"""

LONGEST: Final = 500
"""The maximum number of points in one polyline."""

UNREAD: Final = 1024
"""The maximum number of lines that are stored and not yet converted.

The conversion of so many lines takes a few milliseconds.
"""

_BEND: Final = 1e-6 / METER
"""Lines that bend by less than this (m) become one line, because no pixel shows the bend."""

THINNEST: Final = 1
"""The actual width (pixels) of a pen with the width 0."""


CLEAR: Final = Colour(255, 255, 255)
"""The colour of a pixel on which nothing was drawn. turtlesim clears to a transparent white."""

_MIDDLE: Final = complex(SIZE, SIZE) / 2.0
_OPAQUE: Final = 255 << 24
_FLAT: Final = 1e-9
"""A component of a line's direction (a unit vector) counts as 0 if it is smaller than this.

The difference is too small to change a pixel.
"""

Places: TypeAlias = npt.NDArray[np.complex128]
_Floats: TypeAlias = npt.NDArray[np.float64]
_Whole: TypeAlias = npt.NDArray[np.int64]


class Drawing:
    """Everything drawn since the drawing was made or cleared."""

    _pen: Pen

    def __init__(self) -> None:
        self.clear()

    def line(self, turtle: int, pen: Pen, start: complex, end: complex) -> None:
        """Draw a straight line.

        Args:
            turtle: The number of the turtle. The lines of a turtle are joined into polylines.
            pen: The pen.
            start: Where the line begins, ``x + 1j * depth`` (m).
            end: Where the line ends (m). If it equals ``start``, a dot is drawn.
        """
        if pen != self._pen:  # later lines cover earlier ones, so these are finished first
            self._finish_runs()
            self._pen = pen
        run = self._runs.get(turtle)
        if run is not None and run[1] == start and _is_straight(*run, end):
            self._runs[turtle] = run[0], end
            return
        if run is not None:
            self._unread.append((pen, turtle, *run))
        self._runs[turtle] = start, end
        if len(self._unread) >= UNREAD:
            self._convert()

    def clear(self) -> None:
        """Erase everything."""
        self._pen = Pen()
        self._runs: dict[int, tuple[complex, complex]] = {}  # unfinished lines, drawn with `_pen`
        self._unread: list[tuple[Pen, int, complex, complex]] = []
        self._canvas = Canvas()
        self._base: bytes | None = None
        self._strokes: list[_Stroke] = []
        self._open: dict[int, _Stroke] = {}
        self._points = 0

    def colour_at(self, place: complex) -> Colour:
        """Return the colour of the pixel nearest to a place (m) inside the walls."""
        x, y = (math.floor(part * METER + 0.5) for part in (place.real, place.imag))
        self._read()
        return self._canvas.colour(x, y)

    def pixels(self) -> bytes:
        """All pixels, row by row from the top: four bytes each, red, green, blue and alpha.

        Alpha is 255 where something was drawn, otherwise 0.
        """
        self._read()
        return self._canvas.pixels.tobytes()

    def base(self) -> bytes | None:
        """Return the pixels of the lines that `polylines` no longer has; None if there are none."""
        self._read()
        return self._base

    def polylines(self) -> list[Polyline]:
        """Return the polylines, in the order in which they were begun."""
        self._read()
        return [stroke.polyline() for stroke in self._strokes]

    def _read(self) -> None:
        self._finish_runs()
        self._convert()

    def _finish_runs(self) -> None:
        self._unread += ((self._pen, turtle, *run) for turtle, run in self._runs.items())
        self._runs.clear()

    def _convert(self) -> None:
        """Convert the stored lines to pixels and polylines."""
        unread, self._unread = self._unread, []
        for pen, group in groupby(unread, lambda stored: stored[0]):
            _, turtles, starts, ends = zip(*group, strict=True)
            start, end = np.array((starts, ends)) * complex(METER)
            self._canvas.draw(start, end, pen)
            for turtle, here, there in zip(turtles, start.tolist(), end.tolist(), strict=True):
                self._extend(turtle, pen, here, there)

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
        self._base = self._canvas.pixels.tobytes()
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
        world.on_jump = self._jump
        self.forget_all()

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
        holder.is_on = not is_off
        if not is_off:
            holder.pen = Pen(colour, width or THINNEST)

    def colour(self, turtle: str) -> Colour:
        """Return the colour of a turtle's pen, whether the pen is on or off."""
        return self._holders[turtle].pen.colour

    def hand_out(self, turtle: str) -> None:
        """Give a new turtle a pen; call this before the next step."""
        self._count += 1
        self._holders[turtle] = _Holder(self._count)
        self._places = self._world.places()

    def take_back(self, turtle: str) -> None:
        """Remove the pen of a turtle that was removed; call this before the next step."""
        del self._holders[turtle]
        self._jumps.pop(turtle, None)
        self._places = self._world.places()

    def forget_all(self) -> None:
        """Erase the drawing, and give every existing turtle a new pen."""
        self.drawing.clear()
        self._holders: dict[str, _Holder] = {}
        self._jumps: dict[str, list[tuple[complex, complex]]] = {}
        for name in self._world.names:
            self.hand_out(name)

    def follow(self, sensed: Collection[str] = ()) -> dict[str, Colour]:
        """Draw the lines of the world's latest step, including its teleports.

        Args:
            sensed: The names of turtles that sense the colour under them.

        Returns:
            The colours that these turtles sensed, by name.
        """
        before, self._places = self._places, self._world.places()
        (moved,) = (self._places != before).nonzero()
        drawn = {*moved.tolist(), *map(self._world.index, (*sensed, *self._jumps))}
        colours: dict[str, Colour] = {}
        starts, ends, names = before.tolist(), self._places.tolist(), self._world.names
        for index in sorted(drawn):
            name, start, end = names[index], starts[index], ends[index]
            for here, there in self._jumps.pop(name, ()):
                self._draw(name, here, there)
                start = there
            if name in sensed:
                colours[name] = self.drawing.colour_at(end)
            if start != end:
                self._draw(name, start, end)
        return colours

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


def _is_straight(start: complex, middle: complex, end: complex) -> bool:
    """Whether two lines in a row (m) look like one. A dot has no direction, so it never does."""
    way, step = middle - start, end - middle
    turned = step * way.conjugate()
    return turned.real > 0.0 and abs(turned.imag) <= _BEND * min(abs(way), abs(step))


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


class Canvas:
    """A picture made of pixels. A new canvas is empty.

    Attributes:
        pixels: One number per pixel, row by row from the top:
            ``alpha << 24 | blue << 16 | green << 8 | red``. Where something was drawn, alpha is
            255. Where nothing was drawn, the number is 0.
    """

    def __init__(self) -> None:
        self.pixels = np.zeros(SIZE * SIZE, "<u4")

    def colour(self, x: int, y: int) -> Colour:
        """The colour of a pixel: `CLEAR` where nothing was drawn.

        Args:
            x: Column, 0 to `SIZE` - 1.
            y: Row, 0 to `SIZE` - 1.
        """
        pixel = int(self.pixels[y * SIZE + x])
        return Colour(pixel & 255, pixel >> 8 & 255, pixel >> 16 & 255) if pixel else CLEAR

    def draw(self, start: Places, end: Places, pen: Pen) -> None:
        """Draw straight lines with one pen; parts outside the picture are left out.

        Args:
            start: Array of shape (N,): where each line begins, ``x + 1j * y`` (pixels).
            end: Array of shape (N,): where each line ends (pixels). If it ends where it begins, a
                square is drawn.
            pen: The pen.
        """
        red, green, blue = pen.colour
        found = _pixels(start, end, pen.width / 2.0)
        self.pixels[found] = _OPAQUE | blue << 16 | green << 8 | red


def _pixels(start: Places, end: Places, half: float) -> _Whole:
    """Return the indices of the pixels that the lines cover."""
    # So that rounding moves no pixel, a line begins at its end that is nearer to the middle.
    is_turned = np.abs(start - _MIDDLE) > np.abs(end - _MIDDLE)
    start, end = np.where(is_turned, end, start), np.where(is_turned, start, end)
    length, way = np.abs(end - start), end - start
    has_way = length > 0.0
    divisor = np.where(has_way, length, 1.0)
    along_x = np.where(has_way, way.real / divisor, 1.0)
    along_y = np.where(has_way, way.imag / divisor, 0.0)
    reach = np.abs(along_y) * (length / 2.0 + half) + np.abs(along_x) * half
    middle = (start.imag + end.imag) / 2.0
    first, last = _within(middle - reach, middle + reach)
    rows = np.repeat(first - np.cumsum(last - first) + (last - first), last - first)
    rows += np.arange(len(rows))
    which = np.repeat(np.arange(len(start)), last - first)
    # The rectangle is where two strips cross: one between its long sides, one between its ends.
    side, side_low, side_high = _strip(-along_y, along_x, np.full_like(length, -half), half)
    top, top_low, top_high = _strip(along_x, along_y, np.full_like(length, -half), length + half)
    x, y = start.real[which], rows + 0.5 - start.imag[which]
    side, top = side[which] * y, top[which] * y
    low = np.maximum(side + side_low[which], top + top_low[which])
    high = np.minimum(side + side_high[which], top + top_high[which])
    begin, stop = _within(x + low, x + high)
    count = stop - begin
    found = np.repeat(rows * SIZE + begin - np.cumsum(count) + count, count)
    found += np.arange(len(found))
    return found


def _within(low: _Floats, high: _Floats) -> tuple[_Whole, _Whole]:
    """The ranges of pixels (first, last + 1) whose centres ``c`` meet ``low <= c < high``."""
    begin = np.where(low > 0.0, np.ceil(np.clip(low, 0.0, SIZE) - 0.5), 0.0)
    stop = np.where(high < SIZE, np.ceil(np.clip(high, 0.0, SIZE) - 0.5), float(SIZE))
    is_none = (low >= high) | (low >= SIZE) | (high <= 0.0)
    stop = np.where(is_none, begin, np.maximum(begin, stop))
    return begin.astype(np.int64), stop.astype(np.int64)


def _strip(
    dx: _Floats, dy: _Floats, low: _Floats, high: _Floats | float
) -> tuple[_Floats, _Floats, _Floats]:
    """Solve ``low <= dx * x + dy * y < high`` for x.

    Where ``dx`` is nearly 0, the condition depends only on y, and the bounds of x are infinite.

    Returns:
        The growth of both bounds of x when y grows by 1, the lower bounds at y = 0, and the upper
        bounds at y = 0.
    """
    is_flat = np.abs(dx) < _FLAT
    divisor = np.where(is_flat, 1.0, dx)
    one, other = low / divisor, high / divisor
    return (
        np.where(is_flat, 0.0, -dy / divisor),
        np.where(is_flat, -np.inf, np.minimum(one, other)),
        np.where(is_flat, np.inf, np.maximum(one, other)),
    )
