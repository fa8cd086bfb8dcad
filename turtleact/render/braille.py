"""Lines of dots in braille characters, and the trails that are drawn with them.

Each cell is 2 dots wide and 4 high, which makes the dots square on a terminal whose cells are twice
as high as wide. A cell has one colour: that of its last dot.

Source: the Unicode Standard, "Braille Patterns", U+2800: a bit a dot.
"""

from __future__ import annotations

import itertools
import math
from typing import Final, Protocol

__all__ = ["Braille", "Ink", "Trails"]

STRIDE: Final = 0.08
"""A trail goes on after so many metres."""

LONGEST: Final = 2000
"""So many places of a trail are kept, for a map of another size."""


class Braille:
    """A canvas of dots, 2 a column and 4 a row; (0, 0) is the dot in the lower left corner.

    >>> canvas = Braille(2, 1)
    >>> canvas.line(0, 0, 3, 3)
    >>> canvas.rows()
    ['⡠⠊']
    """

    BITS: Final = ((0x40, 0x80), (0x04, 0x20), (0x02, 0x10), (0x01, 0x08))

    def __init__(self, columns: int, rows: int) -> None:
        self.width = 2 * columns
        self.height = 4 * rows
        self._cells = [[0] * columns for _ in range(rows)]
        self._colours = [[""] * columns for _ in range(rows)]

    def dot(self, x: int, y: int, colour: str = "") -> None:
        """Set a dot; one beyond the edge is left out."""
        if 0 <= x < self.width and 0 <= y < self.height:
            row, column = len(self._cells) - 1 - y // 4, x // 2
            self._cells[row][column] |= self.BITS[y % 4][x % 2]
            self._colours[row][column] = colour

    def line(self, x0: int, y0: int, x1: int, y1: int, colour: str = "") -> None:
        """Set the dots between two dots, both of them too."""
        steps = max(abs(x1 - x0), abs(y1 - y0), 1)
        for step in range(steps + 1):
            x = round(x0 + (x1 - x0) * step / steps)
            self.dot(x, round(y0 + (y1 - y0) * step / steps), colour)

    def rows(self) -> list[str]:
        """The characters, from the top row to the bottom."""
        return ["".join(chr(0x2800 + bits) for bits in row) for row in self._cells]

    def colours(self) -> list[list[str]]:
        """The colours of the cells, likewise; empty where no dot was given one."""
        return self._colours


class Ink(Protocol):
    """What was drawn in a world."""

    def canvas(self, columns: int, rows: int) -> Braille:
        """All of it, the world's lower left corner at (0, 0), on a canvas of this size."""


class Trails:
    """Where turtles have been, drawn as they go: a frame costs what is new.

    Args:
        side: Length of the world's walls (m).
    """

    def __init__(self, side: float) -> None:
        self._side = side
        self._canvas = Braille(1, 1)
        self._places: dict[str, list[tuple[float, float]]] = {}
        self._colours: dict[str, str] = {}

    def follow(self, turtle: str, x: float, y: float, colour: str) -> None:
        """Go on with a turtle's trail, if it has gone far enough.

        Args:
            turtle: Its name.
            x: Where it is (m).
            y: Where it is (m).
            colour: Of the whole trail.
        """
        places = self._places.setdefault(turtle, [])
        self._colours[turtle] = colour
        if places and math.hypot(x - places[-1][0], y - places[-1][1]) < STRIDE:
            return
        if places:
            self._draw(*places[-1], x, y, colour)
        places.append((x, y))
        del places[:-LONGEST]

    def canvas(self, columns: int, rows: int) -> Braille:
        """All trails; of a size that is new they are drawn anew."""
        if (self._canvas.width, self._canvas.height) != (2 * columns, 4 * rows):
            self._canvas = Braille(columns, rows)
            for turtle, places in self._places.items():
                for here, there in itertools.pairwise(places):
                    self._draw(*here, *there, self._colours[turtle])
        return self._canvas

    def _draw(self, x0: float, y0: float, x1: float, y1: float, colour: str) -> None:
        scale = (self._canvas.width - 1) / self._side
        start, end = (round(x0 * scale), round(y0 * scale)), (round(x1 * scale), round(y1 * scale))
        self._canvas.line(*start, *end, colour)
