"""Many straight lines on a canvas at once, as arrays: the pixels are those of `Canvas.line`.

Each step of its arithmetic is made here in the same order, so that no rounding differs. Knows no
turtle, no ROS and no clock.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from turtleact.sim.canvas import FLAT, MIDDLE, SIZE, ink

if TYPE_CHECKING:
    from turtleact.sim.canvas import Canvas, Colour

__all__ = ["draw_lines"]

_Floats: TypeAlias = npt.NDArray[np.float64]
_Places: TypeAlias = npt.NDArray[np.complex128]
_Whole: TypeAlias = npt.NDArray[np.int64]

_MOST = 1024
"""So many lines are worked out together, and so many rows of them at most, about."""


def draw_lines(canvas: Canvas, start: _Places, end: _Places, width: float, colour: Colour) -> None:
    """Draw straight lines of one width and colour.

    Args:
        canvas: Where.
        start: Where they begin, ``x + 1j * y`` (pixels).
        end: Where they end.
        width: How wide they are (pixels), above zero.
        colour: What they are drawn in.
    """
    pixels = np.frombuffer(canvas.pixels, np.uint32)
    for at in range(0, len(start), _MOST):
        some = slice(at, at + _MOST)
        pixels[_pixels(start[some], end[some], width / 2.0)] = ink(colour)


def _pixels(start: _Places, end: _Places, half: float) -> _Whole:
    """The indices of the pixels in some lines."""
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
