"""Arranges what a terminal shows about a goal, a server or a robot, with rich.

A goal is shown with its state, feedback, progress and a map. A server or a robot is shown with
a heading and a map. Beside the map is a table of goals or a legend of keys.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from io import StringIO
from textwrap import wrap
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from rich.console import Console, Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from turtleact.commands.world_map import TICK, MapView, Target, printable, shortened, world_map
from turtleact.goals.state import GoalStatus
from turtleact.interfaces import to_dict

if TYPE_CHECKING:
    from turtleact.interfaces import Message

__all__ = ["GoalRow", "GoalView", "PanelData", "Picture", "board", "frame", "inline", "lines"]

Picture: TypeAlias = RenderableType
"""Anything that rich can draw."""

STYLES: Final = {
    GoalStatus.ACCEPTED: "blue",
    GoalStatus.EXECUTING: "cyan",
    GoalStatus.CANCELING: "yellow",
    GoalStatus.SUCCEEDED: "green",
    GoalStatus.CANCELED: "yellow",
    GoalStatus.ABORTED: "red",
}

NARROWEST: Final = 40
"""The minimum width (columns) of a window that shows a map."""

NARROWEST_BESIDE, NARROWEST_TABLE = 26, 36
"""The minimum widths (columns) of the feedback and of the table of goals beside a map."""

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
"""The maximum number of lines for one value of the feedback."""

MOST_GOAL_LINES: Final = 3
TALL: Final = 20
"""The minimum height (lines) of a window that shows a goal message in up to three lines.

A lower window shows only one line of the goal message.
"""

LONGEST_LIST: Final = 8
"""If a list has more elements than this, only its first and last elements are shown."""

SENT_BEFORE: Final = "sent by another program; the fields of the goal are unknown here"


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
        marks: Remarks on the goal, such as that it is paused or that its turtle is reversing.
    """

    name: str
    goal: Message | None
    goal_id: str
    status: GoalStatus
    age: float
    feedback: Message | None = None
    fraction: float | None = None
    progress: str = ""
    marks: Sequence[str] = ()


class GoalRow(NamedTuple):
    """A row of the table of goals.

    Attributes:
        name: The name of the action.
        goal_id: The goal's id, in hexadecimal.
        status: The goal's state.
        age: How long ago the goal was accepted (s); of an ended goal, how long it took.
        progress: The progress in words.
        turtle: The turtle that the goal drives; empty if the map does not show it.
        colour: The colour of that turtle.
        targets: The targets of the turtle, in its colour.
        marks: Remarks on the goal, such as that it is paused or that its turtle is reversing.
    """

    name: str
    goal_id: str
    status: GoalStatus
    age: float
    progress: str = ""
    turtle: str = ""
    colour: str = ""
    targets: Sequence[Target] = ()
    marks: Sequence[str] = ()


class PanelData(NamedTuple):
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


def lines(content: Picture, *, width: int, height: int) -> list[str]:
    """Render a picture for this terminal: at most ``height`` lines of at most ``width`` columns."""
    console = Console(
        file=StringIO(), width=width, height=height, force_terminal=True, highlight=False
    )
    with console.capture() as capture:
        console.print(content, end="")
    text = re.sub(r" +((?:\x1b\[[0-9;]*m)*)$", r"\1", capture.get(), flags=re.MULTILINE)
    return text.rstrip("\n").split("\n")[:height]


def inline(value: object) -> str:
    """Return a plain value as text on one line. The middle of a long list is left out."""
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
    return printable(str(value))


def _braced(value: object) -> str:
    return f"({inline(value)})" if isinstance(value, dict) else inline(value)


def frame(goal: GoalView, world: MapView | None, *, width: int, height: int) -> Picture:
    """Show a goal, with its feedback beside or below a map.

    If the window is too small, there is no map.

    Args:
        goal: The goal to show.
        world: The world to draw as a map, if the goal drives a turtle; otherwise None.
        width: The width of the window (columns).
        height: How many lines to use at most.
    """
    head = _head(goal, width, MOST_GOAL_LINES if height >= TALL else 1)
    below = [_progress(goal)] if goal.progress else []
    left = max(height - len(head) - len(below), 0)
    # Below a map, each field of the feedback has one line, so that the map keeps its size.
    needed = 1 if goal.feedback is None else max(min(len(to_dict(goal.feedback)), left // 2), 1)
    above = min(HIGHEST, left - 2 - needed, width // 2 - 1)
    beside = min(HIGHEST, left - 2, (width - NARROWEST_BESIDE) // 2)
    if world is not None and above >= LOWEST_ABOVE and NARROWEST <= width < WIDE:
        middle = [world_map(world, above), _feedback(goal, width, needed)]
    elif world is not None and beside >= LOWEST and width >= NARROWEST:
        table = _feedback(goal, width - 2 * beside - 4, beside)
        middle = [_beside(world_map(world, beside), table, beside)]
    else:
        middle = [_feedback(goal, width, left)]
    return Group(*head, *middle, *below)


def board(view: PanelData, *, width: int, height: int) -> Picture:
    """Show a server or a robot: a heading, and a map with a table beside it.

    If no map is shown, the table is as wide as the window.

    Args:
        view: What to show.
        width: The width of the window (columns).
        height: How many lines to use at most.
    """
    head = [part for line in view.heading for part in _folded(printable(line), width, height // 2)]
    head = head[: max(height // 2, len(view.heading))]
    left = max(height - len(head), 0)
    rows = min(HIGHEST, left - 2, (width - NARROWEST_TABLE) // 2)
    if view.world is None or rows < LOWEST:
        middle = _table(view, width, left)
    else:
        table = _table(view, width - 2 * rows - 4, rows + 2)
        middle = _beside(world_map(view.world, rows), table, rows)
    return Group(*(_cut(line, "bold") for line in head), middle)


def _beside(world: Text, table: Picture, rows: int) -> Table:
    """Show a map of this many rows, and a table beside it."""
    grid = Table.grid(padding=(0, 1, 0, 0))
    grid.add_column(width=2 * rows + 2, no_wrap=True)
    grid.add_column(ratio=1)
    grid.add_row(world, table)
    return grid


def _head(view: GoalView, width: int, rows: int) -> list[Picture]:
    """Show a line with a goal's action, state and age, and below it the goal in some lines."""
    style = STYLES.get(view.status, "")
    head = Table.grid(expand=True, padding=(0, 2, 0, 0))
    head.add_column(no_wrap=True, overflow="ellipsis")
    head.add_column(no_wrap=True)
    head.add_column(no_wrap=True, justify="right", style="dim", ratio=1, overflow="crop")
    state = Text.assemble((view.status.name, style), f" {view.age:.1f} s", _marked(view.marks))
    head.add_row(Text.assemble(("● ", style), (view.name, "bold")), state, view.goal_id[:8])
    sent = SENT_BEFORE if view.goal is None else inline(to_dict(view.goal))
    return [head, *(_cut(f"  {line}", "dim") for line in _folded(sent, width - 2, rows))]


def _progress(view: GoalView) -> Picture:
    """Show the progress in words, and as a bar if the fraction is known."""
    if view.fraction is None:
        return _cut(f"  {view.progress}", "dim")
    line = Table.grid(expand=True, padding=(0, 1, 0, 0))
    line.add_column(width=1)
    line.add_column(ratio=1)
    line.add_column(no_wrap=True, justify="right")
    bar = ProgressBar(total=1.0, completed=view.fraction)
    line.add_row("", bar, f"{view.fraction:4.0%}  {view.progress}")
    return line


def _feedback(goal: GoalView, width: int, rows: int) -> Picture:
    """Show the fields of the last feedback. All values may take the same number of lines.

    If another program sent the goal, feedback from before this display began is unknown.
    """
    if goal.feedback is None:
        since = " since you began to watch" if goal.goal is None else " yet"
        return _cut(f"  no feedback{since}", "dim")
    content = {name: inline(value) for name, value in to_dict(goal.feedback).items()}
    longest = min(max(map(len, content), default=0), width // 2)
    most = min(max(rows // max(len(content), 1), 1), MOST_VALUE_LINES)
    table = Table.grid(expand=True, padding=(0, 2, 0, 0))
    table.add_column(width=longest + 2, no_wrap=True, style="dim")
    table.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    for name, value in list(content.items())[:rows]:
        folded = _folded(value, width - longest - 4, most)
        table.add_row(f"  {shortened(name, longest)}", Text("\n".join(folded)))
    return table


def _table(view: PanelData, width: int, rows: int) -> Picture:
    """Show the legend of the keys, and below it the goals, in at most ``rows`` lines."""
    goals = view.goals or ()
    is_wide = width >= WIDE
    shown = goals[: max(rows - len(view.keys) - 1, 0) // (1 if is_wide else 3)]
    more = len(goals) + view.more - len(shown)
    last = f"… {more} more" if more else "no goals yet" if view.goals == [] else ""
    table = _wide_table(shown) if is_wide else Group(*map(_block, shown))
    return Group(*map(_cut, view.keys), table, *([_cut(last, "dim")] if last else []))


def _wide_table(goals: Sequence[GoalRow]) -> Table:
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(overflow="fold")
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True, justify="right")
    for _ in range(3):
        table.add_column(no_wrap=True, overflow="ellipsis")
    for goal in goals:
        status = Text(goal.status.name, STYLES.get(goal.status, ""))
        goal_id = Text(goal.goal_id[:8], "dim")
        table.add_row(_name(goal), status, _age(goal), goal_id, goal.progress, _turtle(goal))
    return table


def _block(goal: GoalRow) -> Text:
    """Show a goal in two or three short lines."""
    status = (goal.status.name, STYLES.get(goal.status, ""))
    turtle = _turtle(goal)
    text = Text.assemble(_name(goal), "\n  ", status, f"  {_age(goal)}")
    if turtle:
        text.append("\n  ").append(turtle)
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


def _name(goal: GoalRow) -> Text:
    return Text.assemble(("● ", STYLES.get(goal.status, "")), (printable(goal.name), "bold"))


def _age(goal: GoalRow) -> str:
    return f"{goal.age:.1f} s" if goal.age < 10_000 else f"{goal.age / 3600:.1f} h"


def _turtle(goal: GoalRow) -> Text:
    """Show the turtle's name, the numbers of its targets, and the remarks on the goal."""
    text = Text(printable(goal.turtle), goal.colour)
    for target in goal.targets:
        text.append(f" {target.number}{TICK if target.is_reached else ''}", target.style)
    return text.append(*_marked(goal.marks))


def _folded(text: str, width: int, rows: int) -> list[str]:
    """Wrap a text between words into at most ``rows`` lines.

    If the text does not fit, its last line is longer than ``width``.
    """
    found = wrap(text, max(width, 1), break_on_hyphens=False) or [""]
    return [*found[: rows - 1], " ".join(found[rows - 1 :])] if len(found) > rows else found


def _cut(text: str, style: str = "") -> Text:
    """Return a line of text that is cut off at the window's edge."""
    return Text(text, style, no_wrap=True, overflow="ellipsis")


def _marked(marks: Sequence[str]) -> tuple[str, str]:
    return f"  {', '.join(marks)}" if marks else "", "bold yellow"
