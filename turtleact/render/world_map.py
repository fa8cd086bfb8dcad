"""Draws a map of the world in braille characters: walls, trails, turtles and their targets.

Each cell is 2 dots wide and 4 dots high. The dots are evenly spaced in both directions if the
terminal's cells are twice as high as wide. A cell has only one colour: the colour of the dot that
was drawn last.

Source: the Unicode Standard, "Braille Patterns", from U+2800, where each dot is a bit.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol, TypeAlias

from rich.text import Text

from turtleact.render.lines import printable, shortened

__all__ = ["Braille", "Ink", "MapView", "Target", "Trails", "Turtle", "world_map"]

ARROWS: Final = "→↗↑↖←↙↓↘"
WALL, TRAIL, TARGET, REACHED, TURTLE = "dim", "cyan", "yellow", "green", "green"
TICK: Final = "✓"

LONGEST_NAME: Final = 12
BLANK: Final = chr(0x2800)

Marks: TypeAlias = dict[tuple[int, int], tuple[str, str]]
"""Maps the row and column of a cell to its character and style. Rows are counted from the top."""


class Turtle(NamedTuple):
    """A turtle: its x and y (m), its theta (rad, 0 is to the right), its name and its colour."""

    x: float
    y: float
    theta: float
    name: str = ""
    colour: str = TURTLE


class Target(NamedTuple):
    """A target: x and y (m), its number and colour, and whether the turtle has reached it."""

    x: float
    y: float
    number: int
    colour: str = TARGET
    is_reached: bool = False

    @property
    def label(self) -> str:
        """The character that marks the target: its number, or a cross if the number is above 9."""
        return str(self.number) if self.number < 10 else "×"

    @property
    def style(self) -> str:
        """The style in which the target is shown."""
        return REACHED if self.is_reached else self.colour


class MapView(NamedTuple):
    """The part of a world that a map shows. The world's lower left corner is at (0, 0).

    Attributes:
        side: The length of each of the world's four walls (m), above zero.
        turtles: The turtles.
        ink: The drawings of the turtles; None if the map does not show them.
        targets: The targets of the turtles.
    """

    side: float
    turtles: Sequence[Turtle]
    ink: Ink | None = None
    targets: Sequence[Target] = ()


def world_map(view: MapView, rows: int) -> Text:
    """Draw the world in ``rows`` rows and twice as many columns, surrounded by the world's walls.

    A target that has been reached has a check mark beside its number. A turtle hides a target in
    the same cell. A turtle's name is drawn near the turtle. The name never covers a turtle, a
    target, a trail or another name. If there is no room near the turtle, the name is left out.
    """
    columns = 2 * rows
    canvas = Braille(columns, rows) if view.ink is None else view.ink.canvas(columns, rows)
    scale = (canvas.width - 1) / view.side
    marks: Marks = {}
    for target in view.targets:
        row, column = _cell(target.x * scale, target.y * scale, columns, rows)
        if target.is_reached:  # the tick is beside the number: a turtle may stand there
            marks[row, column + (1 if column < columns - 1 else -1)] = (TICK, target.style)
        marks[row, column] = (target.label, target.style)
    cells = [_cell(each.x * scale, each.y * scale, columns, rows) for each in view.turtles]
    for turtle, cell in zip(view.turtles, cells, strict=True):
        marks[cell] = (ARROWS[round(turtle.theta / math.tau * 8) % 8], f"bold {turtle.colour}")
    for turtle, cell in zip(view.turtles, cells, strict=True):
        _label(marks, turtle, cell, canvas.rows())
    return _bordered(canvas, marks)


def _cell(x: float, y: float, columns: int, rows: int) -> tuple[int, int]:
    """Return the row (from the top) and the column of the cell that contains a dot.

    For a dot outside the map, return the nearest cell.
    """
    column = min(max(round(x) // 2, 0), columns - 1)
    return min(max(rows - 1 - round(y) // 4, 0), rows - 1), column


def _label(marks: Marks, turtle: Turtle, cell: tuple[int, int], drawn: Sequence[str]) -> None:
    """Put a turtle's name beside, above or below the turtle.

    The name covers neither another mark nor a trail. If there is no room, it is left out.
    """
    name = shortened(printable(turtle.name), LONGEST_NAME)
    row, column = cell
    last = len(drawn[0]) - len(name)
    middle = min(max(column - len(name) // 2, 0), last)
    places = [
        (row, column + 2),
        (row, column - 1 - len(name)),
        (row - 1, middle),
        (row + 1, middle),
    ]
    for at, start in places:
        if not (0 <= at < len(drawn) and 0 <= start <= last):
            continue
        cells = [(at, start + i) for i in range(len(name))]
        if set(drawn[at][start : start + len(name)]) <= {BLANK} and not marks.keys() & set(cells):
            marks.update({cell: (name[i], turtle.colour) for i, cell in enumerate(cells)})
            return


def _bordered(canvas: Braille, marks: Marks) -> Text:
    text = Text(no_wrap=True)
    rows = canvas.rows()
    edge = "─" * len(rows[0])
    text.append(f"┌{edge}┐\n", WALL)
    for number, (row, colours) in enumerate(zip(rows, canvas.colours(), strict=True)):
        cells = [
            marks.get((number, column), (character, colour or TRAIL))
            for column, (character, colour) in enumerate(zip(row, colours, strict=True))
        ]
        text.append("│", WALL)
        for style, run in itertools.groupby(cells, lambda cell: cell[1]):
            text.append("".join(character for character, _ in run), style)
        text.append("│\n", WALL)
    text.append(f"└{edge}┘", WALL)
    return text


STRIDE: Final = 0.08
"""How far a turtle moves before its trail is extended (m)."""

LONGEST: Final = 2000
"""How many points of a trail are kept, to redraw it for a map of another size."""


class Braille:
    """A canvas of dots. Each character has 2 by 4 dots. (0, 0) is the lower left dot.

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
        """Set a dot, unless it is outside the canvas."""
        if 0 <= x < self.width and 0 <= y < self.height:
            row, column = len(self._cells) - 1 - y // 4, x // 2
            self._cells[row][column] |= self.BITS[y % 4][x % 2]
            self._colours[row][column] = colour

    def line(self, x0: int, y0: int, x1: int, y1: int, colour: str = "") -> None:
        """Set all dots of a line, its ends included."""
        steps = max(abs(x1 - x0), abs(y1 - y0), 1)
        for step in range(steps + 1):
            x = round(x0 + (x1 - x0) * step / steps)
            self.dot(x, round(y0 + (y1 - y0) * step / steps), colour)

    def rows(self) -> list[str]:
        """Return the rows of characters, from top to bottom."""
        return ["".join(chr(0x2800 + bits) for bits in row) for row in self._cells]

    def colours(self) -> list[list[str]]:
        """Return the cells' colours by row, from top to bottom; "" for a cell without a colour."""
        return self._colours


class Ink(Protocol):
    """The lines that turtles have drawn in the world."""

    def canvas(self, columns: int, rows: int) -> Braille:
        """Return a canvas of this size (characters) with everything that was drawn.

        The world's lower left corner is at (0, 0).
        """


class Trails:
    """Draws the trails of turtles.

    Each step is drawn once, when it happens. All steps are drawn again only if the size of the
    canvas changes.

    Args:
        side: The length of each of the world's four walls (m).

    Attributes:
        places: The points (x, y) of each turtle's trail (m), by the turtle's name.
    """

    def __init__(self, side: float) -> None:
        self._side = side
        self._canvas = Braille(1, 1)
        self.places: dict[str, list[tuple[float, float]]] = {}
        self._colours: dict[str, str] = {}

    def follow(self, turtle: str, x: float, y: float, colour: str) -> None:
        """Extend a turtle's trail, if the turtle has moved at least `STRIDE` since the last point.

        Args:
            turtle: The name of the turtle.
            x: The turtle's x (m).
            y: The turtle's y (m).
            colour: The colour of the whole trail.
        """
        places = self.places.setdefault(turtle, [])
        self._colours[turtle] = colour
        if places and math.hypot(x - places[-1][0], y - places[-1][1]) < STRIDE:
            return
        if places:
            self._draw(*places[-1], x, y, colour)
        places.append((x, y))
        del places[:-LONGEST]

    def canvas(self, columns: int, rows: int) -> Braille:
        """Return a canvas with all trails. If the canvas has a new size, draw all trails again."""
        if (self._canvas.width, self._canvas.height) != (2 * columns, 4 * rows):
            self._canvas = Braille(columns, rows)
            for turtle, places in self.places.items():
                for here, there in itertools.pairwise(places):
                    self._draw(*here, *there, self._colours[turtle])
        return self._canvas

    def _draw(self, x0: float, y0: float, x1: float, y1: float, colour: str) -> None:
        scale = (self._canvas.width - 1) / self._side
        start, end = (round(x0 * scale), round(y0 * scale)), (round(x1 * scale), round(y1 * scale))
        self._canvas.line(*start, *end, colour)
