"""The picture that turtles draw on: 500×500 pixels, and straight lines without antialiasing.

A line is drawn as a rectangle that is as wide as the pen. The rectangle extends half the pen's
width beyond both ends of the line. A pixel is coloured if its centre lies inside the rectangle, or
on its left or upper edge. x counts from the left, y from the top. This module does not depend on
turtles, ROS or a clock.

Source: turtlesim 1.8.2, ``path_image_`` in ``turtle_frame.cpp``; Qt 5, ``QPen`` (square caps) and
"Coordinate System" (fill rule).
"""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from turtleact.sim.paint import SIZE, Colour, Pen

__all__ = ["Canvas", "Places"]

Places: TypeAlias = npt.NDArray[np.complex128]
_Floats: TypeAlias = npt.NDArray[np.float64]
_Whole: TypeAlias = npt.NDArray[np.int64]


CLEAR: Final = Colour(255, 255, 255)
"""The colour of a pixel on which nothing was drawn. turtlesim clears to a transparent white."""

_MIDDLE: Final = complex(SIZE, SIZE) / 2.0
_OPAQUE: Final = 255 << 24
_FLAT: Final = 1e-9
"""A component of a line's direction (a unit vector) counts as 0 if it is smaller than this.

The difference is too small to change a pixel.
"""

_MOST: Final = 1024
"""How many lines are converted to pixels at a time. A higher number would only use more memory."""


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
        for at in range(0, len(start), _MOST):
            some = slice(at, at + _MOST)
            found = _pixels(start[some], end[some], pen.width / 2.0)
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
