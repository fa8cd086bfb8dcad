"""The picture that turtles draw on: 500×500 pixels, and straight lines without antialiasing.

A line is drawn as a rectangle that is as wide as the pen. The rectangle extends half the pen's
width beyond both ends of the line. A pixel is coloured if its centre lies inside the rectangle, or
on its left or upper edge. x counts from the left, y from the top. This module does not depend on
turtles, ROS or a clock.

Source: turtlesim 1.8.2, ``path_image_`` in ``turtle_frame.cpp``; Qt 5, ``QPen`` (square caps) and
"Coordinate System" (fill rule).
"""

from __future__ import annotations

from array import array
from math import ceil, inf
from typing import Final, NamedTuple

__all__ = ["FLAT", "METER", "MIDDLE", "SIZE", "Canvas", "Colour", "Pen", "ink"]

SIZE: Final = 500
"""Width and height (pixels)."""

METER: Final = 45.0
"""Pixels per metre. In turtlesim, one metre is the height of the picture of a turtle."""


class Colour(NamedTuple):
    """Red, green and blue, 0 to 255 each."""

    red: int
    green: int
    blue: int


class Pen(NamedTuple):
    """A turtle's pen: a colour, and a width in pixels (1 to 255)."""

    colour: Colour = Colour(179, 184, 255)
    width: int = 3


CLEAR: Final = Colour(255, 255, 255)
"""The colour of a pixel on which nothing was drawn. turtlesim clears to a transparent white."""

MIDDLE: Final = complex(SIZE, SIZE) / 2.0
_OPAQUE: Final = 255 << 24
FLAT: Final = 1e-9
"""A component of a line's direction (a unit vector) counts as 0 if it is smaller than this.

The difference is too small to change a pixel.
"""

_NOTHING: Final = array("I", [0]) * (SIZE * SIZE)


class Canvas:
    """A picture made of pixels. A new canvas is empty.

    Attributes:
        pixels: One number per pixel, row by row from the top:
            ``alpha << 24 | blue << 16 | green << 8 | red``. Where something was drawn, alpha is
            255. Where nothing was drawn, the number is 0.
    """

    def __init__(self) -> None:
        self.pixels = array("I", _NOTHING)

    def clear(self) -> None:
        """Erase everything."""
        self.pixels[:] = _NOTHING

    def colour(self, x: int, y: int) -> Colour:
        """The colour of a pixel: `CLEAR` where nothing was drawn.

        Args:
            x: Column, 0 to `SIZE` - 1.
            y: Row, 0 to `SIZE` - 1.
        """
        pixel = self.pixels[y * SIZE + x]
        return Colour(pixel & 255, pixel >> 8 & 255, pixel >> 16 & 255) if pixel else CLEAR

    def line(self, start: complex, end: complex, width: float, colour: Colour) -> None:
        """Draw a straight line; parts outside the picture are left out.

        Args:
            start: Where the line begins, ``x + 1j * y`` (pixels).
            end: Where the line ends. If ``end`` equals ``start``, a square is drawn.
            width: The width of the line (pixels), above zero.
            colour: The colour of the line.
        """
        if abs(start - MIDDLE) > abs(end - MIDDLE):  # so that rounding moves no pixel
            start, end = end, start
        length, half = abs(end - start), width / 2.0
        along = (end - start) / length if length else 1.0 + 0.0j
        reach = abs(along.imag) * (length / 2.0 + half) + abs(along.real) * half
        middle = (start.imag + end.imag) / 2.0
        first, last = _within(middle - reach, middle + reach)
        # The rectangle is where two strips cross: one between its long sides, one between its ends.
        side, side_low, side_high = _strip(-along.imag, along.real, -half, half)
        top, top_low, top_high = _strip(along.real, along.imag, -half, length + half)
        pixel = array("I", [ink(colour)])
        pixels, x = self.pixels, start.real
        for row in range(first, last):
            y = row + 0.5 - start.imag
            low = max(side * y + side_low, top * y + top_low)
            high = min(side * y + side_high, top * y + top_high)
            begin, stop = _within(x + low, x + high)
            if begin < stop:
                at = row * SIZE
                pixels[at + begin : at + stop] = pixel * (stop - begin)


def ink(colour: Colour) -> int:
    """Return the number of a pixel with this colour; see `Canvas.pixels`."""
    return _OPAQUE | colour.blue << 16 | colour.green << 8 | colour.red


def _within(low: float, high: float) -> tuple[int, int]:
    """The range of pixels (first, last + 1) whose centres ``c`` meet ``low <= c < high``."""
    if low >= high or low >= SIZE or high <= 0.0:
        return 0, 0
    begin = ceil(low - 0.5) if low > 0.0 else 0
    return begin, ceil(high - 0.5) if high < SIZE else SIZE


def _strip(dx: float, dy: float, low: float, high: float) -> tuple[float, float, float]:
    """Solve ``low <= dx * x + dy * y < high`` for x.

    If ``dx`` is nearly 0, the condition depends only on y, and the bounds of x are infinite. The
    caller must then skip each row with a y that does not meet the condition.

    Returns:
        The growth of both bounds of x when y grows by 1, the lower bound at y = 0, and the upper
        bound at y = 0.
    """
    if abs(dx) < FLAT:
        return 0.0, -inf, inf
    one, other = low / dx, high / dx
    return -dy / dx, min(one, other), max(one, other)
