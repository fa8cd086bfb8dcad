"""Arranges what a terminal shows about a goal, a server or a robot.

A goal is shown with its state, feedback, progress and a map. A server or a robot is shown with
a heading and a map. Beside the map is a table of goals or a legend of keys.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Final, NamedTuple

from rich.cells import cell_len
from rich.console import Group
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from turtleact.interfaces import to_dict
from turtleact.render.lines import STYLES, Picture, cut, inline, printable, shortened
from turtleact.render.world_map import TICK, MapView, Target, world_map

if TYPE_CHECKING:
    from turtleact.goals.state import GoalStatus
    from turtleact.interfaces import Message

__all__ = [
    "HIGHEST",
    "LOWEST",
    "Board",
    "GoalRow",
    "GoalView",
    "board",
    "feedback_table",
    "frame",
    "goal_panel",
    "progress_line",
]

NARROWEST: Final = 40
"""The minimum width (columns) of a window that shows a map."""

NARROWEST_TABLE: Final = 26
"""The minimum width (columns) of the feedback beside a map."""

WIDE: Final = 72
"""In a window narrower than this (columns), the feedback is below the map, not beside it.

A table of goals narrower than this has no columns for ids and progress.
"""

LOWEST, HIGHEST = 5, 24
"""The minimum and maximum number of rows of a map, not counting its border."""

LOWEST_ABOVE: Final = 6
"""The minimum height (rows) of a map with the feedback below it.

If the map would have fewer rows, the feedback is beside the map, even in a narrow window.
"""

MOST_VALUE_LINES: Final = 4
"""The maximum number of lines for one value."""

MOST_GOAL_LINES: Final = 3
TALL: Final = 20
"""The minimum height (lines) of a window that shows a goal message in up to three lines.

A lower window shows only one line of the goal message.
"""


class GoalView(NamedTuple):
    """The data of a goal to show on a display.

    Attributes:
        name: The name of the action.
        goal: The goal message; None if it is unknown.
        goal_id: The id of the goal, in hexadecimal.
        status: The goal's state.
        age: How long ago the goal was accepted (s).
        feedback: The last feedback, if there is one.
        fraction: The progress, 0 to 1, if it is known.
        progress: The progress in words.
        motion: The turtle's motion if it is unusual, such as ``reversing``; otherwise empty.
        is_paused: Whether the goal is paused.
        is_served: Whether the goal's server is on the graph.
    """

    name: str
    goal: Message | None
    goal_id: str
    status: GoalStatus
    age: float
    feedback: Message | None = None
    fraction: float | None = None
    progress: str = ""
    motion: str = ""
    is_paused: bool = False
    is_served: bool = True


SENT_BEFORE: Final = "sent by another program; the fields of the goal are unknown here"


def goal_panel(view: GoalView, *, width: int, rows: int = 1) -> Group:
    """Show a line with a goal's action, state and age, and below it the goal message.

    The goal message takes up to ``rows`` lines.
    """
    style = STYLES.get(view.status, "")
    head = Table.grid(expand=True, padding=(0, 2, 0, 0))
    head.add_column(no_wrap=True, overflow="ellipsis")
    head.add_column(no_wrap=True)
    head.add_column(no_wrap=True, justify="right", style="dim", ratio=1, overflow="crop")
    head.add_row(
        Text.assemble(("● ", style), (view.name, "bold")),
        Text.assemble(
            (view.status.name, style),
            " (paused)" if view.is_paused else "",
            "" if view.is_served else (" (server gone)", "yellow"),
            f" {view.age:.1f} s",
            _motion(view.motion),
        ),
        view.goal_id[:8],
    )
    sent = SENT_BEFORE if view.goal is None else inline(to_dict(view.goal))
    return Group(head, *(cut(f"  {line}", "dim") for line in _folded(sent, width - 2, rows)))


def progress_line(fraction: float | None, text: str) -> Picture:
    """Show the progress in words, and as a bar if the fraction is known."""
    if fraction is None:
        return cut(f"  {text}", "dim")
    line = Table.grid(expand=True, padding=(0, 1, 0, 0))
    line.add_column(ratio=1)
    line.add_column(no_wrap=True, justify="right")
    line.add_row(ProgressBar(total=1.0, completed=fraction), f"{fraction:4.0%}  {text}")
    return Padding(line, (0, 0, 0, 2))


def feedback_table(feedback: Message | None, *, width: int, rows: int) -> Group:
    """Show the fields of a feedback message.

    Long values are wrapped, or cut if there is no room.
    """
    if feedback is None:
        return Group(cut("  no feedback yet", "dim"))
    content = {name: inline(value) for name, value in to_dict(feedback).items()}
    table = _rows(content, width, rows)
    if len(content) > rows > 0:
        table.append(cut(f"  … {len(content) - rows} more", "dim"))
    return Group(*table)


def frame(goal: GoalView, world: MapView | None, *, width: int, height: int) -> Picture:
    """Show a goal, with its feedback beside or below a map.

    If the window is too small, there is no map.

    Args:
        goal: The goal to show.
        world: The world to draw as a map, if the goal drives a turtle; otherwise None.
        width: The width of the window (columns).
        height: How many lines to use at most.
    """
    progress = progress_line(goal.fraction, goal.progress)
    below = [] if goal.fraction is None and not goal.progress else [progress]
    head = goal_panel(goal, width=width, rows=MOST_GOAL_LINES if height >= TALL else 1)
    left = height - 1 - len(head.renderables) - len(below)
    if world is None or width < NARROWEST:
        return Group(head, _feedback(goal, width=width, rows=max(left, 0)), *below)
    needed = min(_rows_needed(goal.feedback, width), left // 2)
    rows = min(HIGHEST, left - 2 - needed, width // 2 - 1)
    if width < WIDE and rows >= LOWEST_ABOVE:
        table = _feedback(goal, width=width, rows=needed)
        blank = [cut("")] * (needed - len(table.renderables))
        return Group(head, world_map(world, rows), table, *blank, *below)
    rows = min(HIGHEST, left - 2, (width - NARROWEST_TABLE) // 2)
    if rows < LOWEST:
        return Group(head, _feedback(goal, width=width, rows=max(left, 0)), *below)
    taken = 2 * rows + 2
    beside = Table.grid(padding=(0, 1, 0, 0))
    beside.add_column(width=taken, no_wrap=True)
    beside.add_column(ratio=1, vertical="middle")
    beside.add_row(world_map(world, rows), _feedback(goal, width=width - taken - 2, rows=rows))
    return Group(head, beside, *below)


def _rows(content: Mapping[str, str], width: int, rows: int) -> list[Picture]:
    """Show the first entries of ``content`` and their names in at most ``rows`` lines."""
    column = min(max(map(len, content), default=0), width // 2)
    spare = max(rows - len(content), 0)
    table: list[Picture] = []
    for name, value in list(content.items())[:rows]:
        folded = _folded(value, width - column - 4, min(1 + spare, MOST_VALUE_LINES))
        spare -= len(folded) - 1
        label = f"  {shortened(name, column):{column}}  "
        for number, line in enumerate(folded):
            text = Text.assemble((" " * len(label) if number else label, "dim"), line)
            table.append(_cut(text))
    return table


def _rows_needed(feedback: Message | None, width: int) -> int:
    """Return how many lines the feedback needs if each float in it is as wide as `LONG_NUMBER`.

    With the actual widths, the number of lines would change with every feedback, and so would the
    size of the map above the feedback.
    """
    if feedback is None:
        return 1
    content = {name: inline(_widened(value)) for name, value in to_dict(feedback).items()}
    return max(len(_rows(content, width, len(content) * MOST_VALUE_LINES)), 1)


def _widened(value: object) -> object:
    """Replace each float in ``value``, at any depth, with `LONG_NUMBER`."""
    if isinstance(value, dict):
        return {name: _widened(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_widened(item) for item in value]
    return LONG_NUMBER if isinstance(value, float) else value


def _folded(text: str, width: int, rows: int) -> list[str]:
    """Wrap a text between words into at most ``rows`` lines.

    If the text does not fit, its last line is longer than ``width``.
    """
    lines = wrap(text, max(width, 1), break_on_hyphens=False) or [""]
    return [*lines[: rows - 1], " ".join(lines[rows - 1 :])] if len(lines) > rows else lines


LONG_NUMBER: Final = "-0.000"
"""A number with as many characters as the longest coordinate that a turtle can have."""


def _motion(motion: str) -> tuple[str, str]:
    return (f"  {motion}" if motion else "", "bold yellow")


def _feedback(goal: GoalView, *, width: int, rows: int) -> Group:
    """Show the last feedback.

    If another program sent the goal, feedback from before this display began is unknown.
    """
    if goal.goal is None and goal.feedback is None:
        return Group(cut("  no feedback since you began to watch", "dim"))
    return feedback_table(goal.feedback, width=width, rows=rows)


NARROWEST_BOARD: Final = 30
"""The minimum width (columns) of the table of goals beside a map."""

SHORTEST: Final = 20
"""The minimum width (characters) of the names in a table that is at least `WIDE`."""

LONGEST_STATUS: Final = 9
"""The width (characters) of a goal's status in a table of goals."""

LONGEST_DURATION: Final = 8
"""The width (characters) of a goal's age in a table of goals."""


class GoalRow(NamedTuple):
    """A goal as a row of a table.

    Attributes:
        name: The name of the action.
        goal_id: The id of the goal, in hexadecimal.
        status: The goal's state.
        age: How long the goal has run (s).
        progress: The progress in words.
        turtle: The turtle that the goal drives; empty if it drives none.
        colour: The colour of that turtle.
        targets: The turtle's targets, in order.
        motion: Remarks, for example that the goal was resumed, that it is paused, or that the
            turtle is ``reversing``; empty if there are none.
    """

    name: str
    goal_id: str
    status: GoalStatus
    age: float
    progress: str = ""
    turtle: str = ""
    colour: str = ""
    targets: Sequence[Target] = ()
    motion: str = ""


class Board(NamedTuple):
    """The data of a server or a robot to show on a display.

    Attributes:
        heading: The lines at the top, which are shown even in a small window.
        world: The world to draw as a map; None if no map is shown.
        goals: The rows of the table of goals; None if no table is shown.
        more: How many further goals there are, besides those in ``goals``.
        keys: The lines that explain the keys of the keyboard.
    """

    heading: Sequence[str]
    world: MapView | None = None
    goals: Sequence[GoalRow] | None = None
    more: int = 0
    keys: Sequence[str] = ()


def board(view: Board, *, width: int, height: int) -> Picture:
    """Show a server or a robot: a heading, and a map with a table beside it.

    If no map is shown, the table is as wide as the window.

    Args:
        view: What to show.
        width: The width of the window (columns).
        height: How many lines to use at most.
    """
    head = _heading(view.heading, width, height)
    left = height - len(head)
    rows = min(HIGHEST, left - 2, (width - NARROWEST_BOARD) // 2)
    middle: list[Picture]
    if view.world is None or rows < LOWEST:
        middle = _table(view, width, left)
    else:
        taken = 2 * rows + 2
        beside = Table.grid(padding=(0, 1, 0, 0))
        beside.add_column(width=taken, no_wrap=True)
        beside.add_column(ratio=1)
        table = _table(view, width - taken - 2, rows + 2)
        beside.add_row(world_map(view.world, rows), Group(*table))
        middle = [beside]
    return Group(*head, *middle)


def _heading(lines: Sequence[str], width: int, height: int) -> list[Picture]:
    """Wrap the lines of a heading between words.

    If the wrapped lines would take more than half of ``height``, long lines are cut off instead.
    """
    wrapped = [part for line in lines for part in wrap(printable(line), width) or [""]]
    if len(wrapped) > max(height // 2, len(lines)):
        wrapped = [printable(line) for line in lines]
    return [cut(line, "bold") for line in wrapped[:height]]


def _table(view: Board, width: int, rows: int) -> list[Picture]:
    """Show the legend of the keys, and below it the goals, in at most ``rows`` lines."""
    table: list[Picture] = [cut(line) for line in view.keys]
    if view.goals is None:
        return table[:rows]
    if not view.goals:
        return [*table, cut("no goals yet", "dim")][:rows]
    names = max(cell_len(printable(goal.name)) for goal in view.goals)
    names = names if width < WIDE else max(names, SHORTEST)
    blocks = [_row(goal, width, names) for goal in view.goals]
    left, count = rows - len(table), len(view.goals) + view.more
    is_all = count == len(blocks) and sum(map(len, blocks)) <= left
    for shown, block in enumerate(blocks):
        if not is_all and len(block) > left - 1:
            return [*table, cut(f"… {count - shown} more", "dim")][:rows]
        table += block
        left -= len(block)
    if not is_all:
        table.append(cut(f"… {view.more} more", "dim"))
    return table[:rows]


def _row(goal: GoalRow, width: int, names: int) -> list[Picture]:
    """Show a goal in one line, or in several lines if the window is narrow."""
    style, name, age = STYLES.get(goal.status, ""), printable(goal.name), _duration(goal.age)
    bullet, turtle = ("● ", style), _turtle(goal)
    below = [_cut(Text.assemble("  ", turtle))] if turtle else []
    if 2 + names + 2 + LONGEST_STATUS + 2 + LONGEST_DURATION > width:
        size = max(width - 2, 1)
        parts = [name[start : start + size] for start in range(0, len(name), size)]
        folded = [
            Text.assemble(bullet if number == 0 else "  ", (part, "bold"))
            for number, part in enumerate(parts)
        ]
        return [*folded, _cut(Text.assemble("  ", (goal.status.name, style), f"  {age}")), *below]
    line = Text.assemble(
        bullet,
        (name.ljust(names), "bold"),
        "  ",
        (goal.status.name.ljust(LONGEST_STATUS), style),
        f"  {age:>{LONGEST_DURATION}}",
    )
    if width < WIDE:
        return [_cut(line), *below]
    line.append(f"  {goal.goal_id[:8]}", "dim").append(f"  {goal.progress}")
    return [_cut(line.append("  ").append(turtle))]


def _turtle(goal: GoalRow) -> Text:
    """Show the turtle's name, the numbers of its targets, and the remarks on the goal."""
    text = Text(printable(goal.turtle), goal.colour)
    for target in goal.targets:
        text.append(f" {target.number}{TICK if target.is_reached else ''}", target.style)
    return text.append(*_motion(goal.motion))


def _cut(line: Text) -> Text:
    line.no_wrap, line.overflow = True, "ellipsis"
    return line


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 10_000 else f"{seconds / 3600:.1f} h"
