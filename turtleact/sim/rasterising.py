"""Draws the lines of many turtles with arrays: joins straight steps, then sets the pixels.

While a turtle moves straight, `Runs` joins its steps into one line, so that a fleet does not draw
one line per turtle and tick. `draw_lines` colours the pixels of many lines. It colours exactly the
same pixels as `Canvas.line`, because it calculates in the same order. This module is for many
turtles; for a few turtles, the module `drawing` joins lines without arrays. This module does not
depend on turtles, ROS or a clock.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from turtleact.sim.canvas import FLAT, MIDDLE, SIZE, Canvas, Colour, Pen, ink

__all__ = ["Lines", "Numbers", "Places", "Runs", "draw_lines"]

Numbers: TypeAlias = npt.NDArray[np.intp]
Places: TypeAlias = npt.NDArray[np.complex128]
Lines: TypeAlias = tuple[Numbers, Places, Places]
"""Three arrays of shape (N,): the number of the turtle, the start and the end of each line (m)."""

_Floats: TypeAlias = npt.NDArray[np.float64]
_Whole: TypeAlias = npt.NDArray[np.int64]

_MOST = 1024
"""How many lines are converted to pixels at a time. A higher number would only use more memory."""


class Runs:
    """The unfinished lines of one pen, at most one per turtle.

    Args:
        pen: The pen.
        bend: How far a line may deviate and still count as straight (m).
    """

    def __init__(self, pen: Pen, bend: float) -> None:
        self.pen = pen
        self._bend = bend
        self._is_held = np.zeros(0, np.bool_)
        self._start = np.zeros(0, np.complex128)
        self._end = np.zeros(0, np.complex128)

    def take(self, who: Numbers, start: Places, end: Places) -> Lines:
        """Add a straight segment to the lines of some turtles. Return the lines that have ended.

        A segment extends its turtle's line if the segment begins at the line's end and has the same
        direction. Otherwise, the line ends, and the segment begins a new line.

        Args:
            who: Array of shape (N,): the numbers of the turtles, without duplicates.
            start: Array of shape (N,): where each segment begins (m).
            end: Array of shape (N,): where each segment ends (m).
        """
        self._make_room(int(who.max()) + 1)
        is_held, way, step = self._is_held[who], self._end[who] - self._start[who], end - start
        length, more = np.abs(way), np.abs(step)
        with np.errstate(divide="ignore", invalid="ignore"):  # a dot has no direction
            turned = step * way.conj() / length
            is_straight = np.abs(turned.imag) <= self._bend * np.minimum(1.0, more / length)
        goes_on = is_held & is_straight & (turned.real >= 0.0) & (more > 0.0)
        goes_on &= self._end[who] == start
        over = who[is_held & ~goes_on]
        ended = over, self._start[over], self._end[over]
        new = who[~goes_on]
        self._start[new] = start[~goes_on]
        self._is_held[new] = True
        self._end[who] = end
        return ended

    def take_all(self) -> Lines:
        """Return all unfinished lines, and forget them."""
        (who,) = self._is_held.nonzero()
        self._is_held[:] = False
        return who, self._start[who], self._end[who]

    def _make_room(self, count: int) -> None:
        more = count - len(self._is_held)
        if more > 0:
            self._is_held = np.append(self._is_held, np.zeros(more, np.bool_))
            self._start = np.append(self._start, np.zeros(more, np.complex128))
            self._end = np.append(self._end, np.zeros(more, np.complex128))


def draw_lines(canvas: Canvas, start: Places, end: Places, width: float, colour: Colour) -> None:
    """Draw straight lines of one width and colour.

    Args:
        canvas: The canvas.
        start: Array of shape (N,): where each line begins, ``x + 1j * y`` (pixels).
        end: Array of shape (N,): where each line ends (pixels).
        width: The width of the lines (pixels), above zero.
        colour: The colour of the lines.
    """
    pixels = np.frombuffer(canvas.pixels, np.uint32)
    for at in range(0, len(start), _MOST):
        some = slice(at, at + _MOST)
        pixels[_pixels(start[some], end[some], width / 2.0)] = ink(colour)


def _pixels(start: Places, end: Places, half: float) -> _Whole:
    """Return the indices of the pixels that the lines cover."""
    is_turned = np.abs(start - MIDDLE) > np.abs(end - MIDDLE)
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
    begin = np.where(low > 0.0, np.ceil(np.clip(low, 0.0, SIZE) - 0.5), 0.0)
    stop = np.where(high < SIZE, np.ceil(np.clip(high, 0.0, SIZE) - 0.5), float(SIZE))
    is_none = (low >= high) | (low >= SIZE) | (high <= 0.0)
    stop = np.where(is_none, begin, np.maximum(begin, stop))
    return begin.astype(np.int64), stop.astype(np.int64)


def _strip(
    dx: _Floats, dy: _Floats, low: _Floats, high: _Floats | float
) -> tuple[_Floats, _Floats, _Floats]:
    is_flat = np.abs(dx) < FLAT
    divisor = np.where(is_flat, 1.0, dx)
    one, other = low / divisor, high / divisor
    return (
        np.where(is_flat, 0.0, -dy / divisor),
        np.where(is_flat, -np.inf, np.minimum(one, other)),
        np.where(is_flat, np.inf, np.maximum(one, other)),
    )
