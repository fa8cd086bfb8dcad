"""A map of the world: its walls, what was drawn, where turtles are and where they are to go."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeAlias

from rich.text import Text

from turtleact.render.braille import Braille, Ink
from turtleact.render.lines import printable, shortened

__all__ = ["MapView", "Target", "Turtle", "world_map"]

ARROWS: Final = "→↗↑↖←↙↓↘"
WALL, TRAIL, TARGET, TURTLE = "dim", "cyan", "yellow", "green"

LONGEST_NAME: Final = 12
BLANK: Final = chr(0x2800)

Marks: TypeAlias = dict[tuple[int, int], tuple[str, str]]
"""What stands in a cell, by row from the top and column: a character and its style."""


class Turtle(NamedTuple):
    """Where a turtle is: x and y (m), theta (rad, 0 is to the right); its name and colour."""

    x: float
    y: float
    theta: float
    name: str = ""
    colour: str = TURTLE


class Target(NamedTuple):
    """A place to go to: x and y (m), and its number."""

    x: float
    y: float
    number: int


class MapView(NamedTuple):
    """The world, its lower left corner at (0, 0).

    Attributes:
        side: Length of its four walls (m), above zero.
        turtles: Where they are.
        ink: What was drawn.
        targets: Where to.
    """

    side: float
    turtles: Sequence[Turtle]
    ink: Ink | None = None
    targets: Sequence[Target] = ()


def world_map(view: MapView, rows: int) -> Text:
    """The world between its walls, ``rows`` high and twice as wide, border not counted.

    Of what falls into one cell, a turtle is shown before a target, a target before a name, and a
    name before a trail. A name stands where it hides least, or not at all if there is no room.
    """
    columns = 2 * rows
    canvas = Braille(columns, rows) if view.ink is None else view.ink.canvas(columns, rows)
    scale = (canvas.width - 1) / view.side
    marks: Marks = {}
    for x, y, number in view.targets:
        label = str(number) if number < 10 else "×"
        marks[_cell(x * scale, y * scale, columns, rows)] = (label, TARGET)
    cells = [_cell(each.x * scale, each.y * scale, columns, rows) for each in view.turtles]
    for turtle, cell in zip(view.turtles, cells, strict=True):
        marks[cell] = (ARROWS[round(turtle.theta / math.tau * 8) % 8], f"bold {turtle.colour}")
    for turtle, cell in zip(view.turtles, cells, strict=True):
        _label(marks, turtle, cell, canvas.rows())
    return _bordered(canvas, marks)


def _cell(x: float, y: float, columns: int, rows: int) -> tuple[int, int]:
    """Row, counted from the top, and column of the cell that holds a dot; the nearest one."""
    column = min(max(round(x) // 2, 0), columns - 1)
    return min(max(rows - 1 - round(y) // 4, 0), rows - 1), column


def _label(marks: Marks, turtle: Turtle, cell: tuple[int, int], drawn: Sequence[str]) -> None:
    """Put a turtle's name beside, above or below it, where it hides least of what was drawn."""
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
    free = [
        (sum(dots != BLANK for dots in drawn[at][start : start + len(name)]), order, cells)
        for order, (at, start) in enumerate(places)
        if 0 <= at < len(drawn) and 0 <= start <= last
        if not marks.keys() & (cells := {(at, start + i): i for i in range(len(name))}).keys()
    ]
    if free:
        _, _, cells = min(free, key=lambda place: place[:2])
        marks.update({at: (name[i], turtle.colour) for at, i in cells.items()})


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
