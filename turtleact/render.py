"""What a terminal shows of goals, feedback and turtles: values in, rich renderables out.

No logic and no time: who decides what is shown, and how often, stands in
`turtleact.commands.live`. The one door to rich.

A map is drawn in braille characters: each cell is 2 dots wide and 4 high, which makes the dots
square on a terminal whose cells are twice as high as wide.

Source: the Unicode Standard, "Braille Patterns", U+2800: a bit a dot.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from io import StringIO
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from turtleact.goal import GoalStatus
from turtleact.interfaces import to_dict

if TYPE_CHECKING:
    from turtleact.interfaces import Message

__all__ = [
    "Braille",
    "GoalView",
    "MapView",
    "Picture",
    "Turtle",
    "feedback_table",
    "frame",
    "goal_panel",
    "lines",
    "progress_line",
    "world_map",
]

Picture: TypeAlias = RenderableType
"""Whatever rich can draw."""

STYLES: Final = {
    GoalStatus.ACCEPTED: "blue",
    GoalStatus.EXECUTING: "cyan",
    GoalStatus.CANCELING: "yellow",
    GoalStatus.SUCCEEDED: "green",
    GoalStatus.CANCELED: "yellow",
    GoalStatus.ABORTED: "red",
}
ARROWS: Final = "→↗↑↖←↙↓↘"
WALL, TRAIL, TARGET, TURTLE = "dim", "cyan", "yellow", "bold green"

LONGEST_LIST: Final = 8
"""So many elements of a list are shown, the first and the last."""

LONGEST_TEXT: Final = 400
"""So many characters of a text are looked at; the window shows fewer."""

NARROWEST: Final = 40
"""Columns below which there is no map."""

NARROWEST_TABLE: Final = 26
"""Columns that a map leaves for the feedback beside it."""

LOWEST, HIGHEST = 5, 16
"""Rows of a map, without its border."""


class Turtle(NamedTuple):
    """Where a turtle is: x and y (m), theta (rad, 0 is to the right)."""

    x: float
    y: float
    theta: float


Places = Sequence[tuple[float, float]]


class MapView(NamedTuple):
    """The world, its lower left corner at (0, 0).

    Attributes:
        side: Length of its four walls (m), above zero.
        turtles: Where they are.
        trails: Where they have been, each a line from place to place.
        targets: Where to; numbered from ``first``.
        first: The number of the first target.
    """

    side: float
    turtles: Sequence[Turtle]
    trails: Sequence[Places] = ()
    targets: Places = ()
    first: int = 1


class GoalView(NamedTuple):
    """A goal as it is now.

    Attributes:
        name: The action.
        goal: What was sent.
        goal_id: Its id in hexadecimal.
        status: Its state.
        age: Seconds since it was accepted.
        feedback: The last message, if there is one.
        fraction: How much is done, 0 to 1, if it can be told.
        progress: The same in words.
    """

    name: str
    goal: Message
    goal_id: str
    status: GoalStatus
    age: float
    feedback: Message | None = None
    fraction: float | None = None
    progress: str = ""


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

    def dot(self, x: int, y: int) -> None:
        """Set a dot; one beyond the edge is left out."""
        if 0 <= x < self.width and 0 <= y < self.height:
            row = len(self._cells) - 1 - y // 4
            self._cells[row][x // 2] |= self.BITS[y % 4][x % 2]

    def line(self, x0: int, y0: int, x1: int, y1: int) -> None:
        """Set the dots between two dots, both of them too."""
        steps = max(abs(x1 - x0), abs(y1 - y0), 1)
        for step in range(steps + 1):
            self.dot(round(x0 + (x1 - x0) * step / steps), round(y0 + (y1 - y0) * step / steps))

    def rows(self) -> list[str]:
        """The characters, from the top row to the bottom."""
        return ["".join(chr(0x2800 + bits) for bits in row) for row in self._cells]


def world_map(view: MapView, rows: int) -> Text:
    """The world between its walls, ``rows`` high and twice as wide, border not counted.

    Of what falls into one cell, a turtle is shown before a target and a target before a trail.
    """
    columns = 2 * rows
    canvas = Braille(columns, rows)
    scale = (canvas.width - 1) / view.side
    for trail in view.trails:
        dots = [(round(x * scale), round(y * scale)) for x, y in trail]
        for here, there in itertools.pairwise(dots):
            canvas.line(*here, *there)
    marks: dict[tuple[int, int], tuple[str, str]] = {}
    for number, (x, y) in enumerate(view.targets, start=view.first):
        label = str(number) if number < 10 else "×"
        marks[_cell(x * scale, y * scale, columns, rows)] = (label, TARGET)
    for turtle in view.turtles:
        marks[_cell(turtle.x * scale, turtle.y * scale, columns, rows)] = (
            ARROWS[round(turtle.theta / math.tau * 8) % 8],
            TURTLE,
        )
    return _bordered(canvas.rows(), marks)


def goal_panel(view: GoalView) -> Group:
    """Two lines: the action, its state and age; the goal."""
    style = STYLES.get(view.status, "")
    head = Table.grid(expand=True, padding=(0, 2, 0, 0))
    head.add_column(no_wrap=True, overflow="ellipsis")
    head.add_column(no_wrap=True)
    head.add_column(no_wrap=True, justify="right", style="dim", ratio=1, overflow="crop")
    head.add_row(
        Text.assemble(("● ", style), (view.name, "bold")),
        Text.assemble((view.status.name, style), f" {view.age:.1f} s"),
        view.goal_id[:8],
    )
    return Group(head, _cut(f"  {_inline(to_dict(view.goal))}", "dim"))


def progress_line(fraction: float | None, text: str) -> Picture:
    """A bar, if the fraction is known, and what it says in words."""
    if fraction is None:
        return _cut(f"  {text}", "dim")
    line = Table.grid(expand=True, padding=(0, 1, 0, 0))
    line.add_column(ratio=1)
    line.add_column(no_wrap=True, justify="right")
    line.add_row(ProgressBar(total=1.0, completed=fraction), f"{fraction:4.0%}  {text}")
    return Padding(line, (0, 0, 0, 2))


def feedback_table(feedback: Message | None, *, width: int, rows: int) -> Picture:
    """The fields of a message, a row each; long ones are cut, and so are more than ``rows``."""
    if feedback is None:
        return _cut("  no feedback yet", "dim")
    content = {name: _inline(value) for name, value in to_dict(feedback).items()}
    column = min(max(map(len, content), default=0), width // 2)
    table = [
        Text.assemble(
            (f"  {_shortened(name, column):{column}}  ", "dim"),
            value,
            no_wrap=True,
            overflow="ellipsis",
        )
        for name, value in list(content.items())[:rows]
    ]
    if len(content) > rows > 0:
        table.append(_cut(f"  … {len(content) - rows} more", "dim"))
    return Group(*table)


def frame(goal: GoalView, world: MapView | None, *, width: int, height: int) -> Picture:
    """All of it, arranged for a window: the map beside the feedback, or none if it is too narrow.

    Args:
        goal: The goal.
        world: The world, if the goal drives a turtle.
        width: Columns of the window.
        height: Lines that may be used.
    """
    head, progress = goal_panel(goal), progress_line(goal.fraction, goal.progress)
    left = height - 4
    rows = min(HIGHEST, left - 2, (width - NARROWEST_TABLE) // 2)
    if world is None or width < NARROWEST or rows < LOWEST:
        return Group(head, feedback_table(goal.feedback, width=width, rows=max(left, 0)), progress)
    taken = 2 * rows + 2
    beside = Table.grid(padding=(0, 1, 0, 0))
    beside.add_column(width=taken, no_wrap=True)
    beside.add_column(ratio=1, vertical="middle")
    table = feedback_table(goal.feedback, width=width - taken - 2, rows=rows)
    beside.add_row(world_map(world, rows), table)
    return Group(head, beside, progress)


def lines(content: Picture, *, width: int, height: int) -> list[str]:
    """Something rendered for this terminal: at most ``height`` lines of at most ``width`` columns.

    None ends in blanks: a terminal that gets narrower would wrap them too. The environment says
    which colors there are: TERM, COLORTERM, NO_COLOR.
    """
    console = Console(
        file=StringIO(), width=width, height=height, force_terminal=True, highlight=False
    )
    with console.capture() as capture:
        console.print(content, end="")
    text = re.sub(r" +((?:\x1b\[[0-9;]*m)*)$", r"\1", capture.get(), flags=re.MULTILINE)
    return text.rstrip("\n").split("\n")[:height]


def _cell(x: float, y: float, columns: int, rows: int) -> tuple[int, int]:
    """Row, counted from the top, and column of the cell that holds a dot; the nearest one."""
    column = min(max(round(x) // 2, 0), columns - 1)
    return min(max(rows - 1 - round(y) // 4, 0), rows - 1), column


def _bordered(rows: Sequence[str], marks: Mapping[tuple[int, int], tuple[str, str]]) -> Text:
    text = Text(no_wrap=True)
    edge = "─" * len(rows[0])
    text.append(f"┌{edge}┐\n", WALL)
    for number, row in enumerate(rows):
        text.append("│", WALL)
        start = 0
        for column in sorted(column for line, column in marks if line == number):
            text.append(row[start:column], TRAIL)
            text.append(*marks[number, column])
            start = column + 1
        text.append(row[start:], TRAIL)
        text.append("│\n", WALL)
    text.append(f"└{edge}┘", WALL)
    return text


def _cut(text: str, style: str) -> Text:
    return Text(text, style, no_wrap=True, overflow="ellipsis")


def _shortened(text: str, columns: int) -> str:
    return text if len(text) <= columns else f"{text[: max(columns - 1, 0)]}…"


def _inline(value: object) -> str:
    """A plain value on one line, long lists cut in the middle."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_braced(item)}" for name, item in value.items()) or "{}"
    if isinstance(value, list | tuple | bytes):
        items = [_braced(item) for item in value]
        if len(items) > LONGEST_LIST:
            half = LONGEST_LIST // 2
            items[half:-half] = [f"… {len(items) - LONGEST_LIST} more …"]
        return f"[{', '.join(items)}]"
    if isinstance(value, float):
        return f"{value:.3f}".rstrip("0").removesuffix(".") if abs(value) < 1e6 else f"{value:g}"
    return _printable(str(value))


def _braced(value: object) -> str:
    return f"({_inline(value)})" if isinstance(value, dict) else _inline(value)


def _printable(text: str) -> str:
    """Control characters must not reach the terminal."""
    return "".join(c if c.isprintable() else "·" for c in text[:LONGEST_TEXT])
