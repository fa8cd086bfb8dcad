"""Arranges what a terminal shows about one goal, or about a server or a robot.

A goal: its state, its feedback, how far it is, and the map beside it. A server or a robot: lines
that stay, the map, a table of goals or of keys, and the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from rich.console import Group
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from turtleact.interfaces import to_dict
from turtleact.render.lines import STYLES, Picture, cut, inline, printable, shortened
from turtleact.render.world_map import MapView, world_map

if TYPE_CHECKING:
    from turtleact.goal import GoalStatus
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
"""The width below which there is no map."""

NARROWEST_TABLE: Final = 26
"""How many columns a map leaves for the feedback beside it."""

LOWEST, HIGHEST = 5, 24
"""The rows of a map, not counting its border."""


class GoalView(NamedTuple):
    """A goal as it is now.

    Attributes:
        name: The action.
        goal: The goal message; None if it is unknown.
        goal_id: The id of the goal, in hexadecimal.
        status: Its state.
        age: How long ago it was accepted (s).
        feedback: The last feedback, if there is one.
        fraction: The progress, 0 to 1, if it is known.
        progress: The progress in words.
    """

    name: str
    goal: Message | None
    goal_id: str
    status: GoalStatus
    age: float
    feedback: Message | None = None
    fraction: float | None = None
    progress: str = ""


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
    sent = "sent by somebody else" if view.goal is None else inline(to_dict(view.goal))
    return Group(head, cut(f"  {sent}", "dim"))


def progress_line(fraction: float | None, text: str) -> Picture:
    """A progress bar, if the fraction is known, and the progress in words."""
    if fraction is None:
        return cut(f"  {text}", "dim")
    line = Table.grid(expand=True, padding=(0, 1, 0, 0))
    line.add_column(ratio=1)
    line.add_column(no_wrap=True, justify="right")
    line.add_row(ProgressBar(total=1.0, completed=fraction), f"{fraction:4.0%}  {text}")
    return Padding(line, (0, 0, 0, 2))


def feedback_table(feedback: Message | None, *, width: int, rows: int) -> Picture:
    """The fields of a message, each in a row; long ones are cut, and so is the table."""
    if feedback is None:
        return cut("  no feedback yet", "dim")
    content = {name: inline(value) for name, value in to_dict(feedback).items()}
    column = min(max(map(len, content), default=0), width // 2)
    table = [
        Text.assemble(
            (f"  {shortened(name, column):{column}}  ", "dim"),
            value,
            no_wrap=True,
            overflow="ellipsis",
        )
        for name, value in list(content.items())[:rows]
    ]
    if len(content) > rows > 0:
        table.append(cut(f"  … {len(content) - rows} more", "dim"))
    return Group(*table)


def frame(goal: GoalView, world: MapView | None, *, width: int, height: int) -> Picture:
    """The display of a goal: a map beside the feedback, or no map if the window is too narrow.

    Args:
        goal: The goal.
        world: The world, if the goal drives a turtle.
        width: The columns of the window.
        height: How many lines to use at most.
    """
    head, progress = goal_panel(goal), progress_line(goal.fraction, goal.progress)
    left = height - 4
    rows = min(HIGHEST, left - 2, (width - NARROWEST_TABLE) // 2)
    if world is None or width < NARROWEST or rows < LOWEST:
        return Group(head, _feedback(goal, width=width, rows=max(left, 0)), progress)
    taken = 2 * rows + 2
    beside = Table.grid(padding=(0, 1, 0, 0))
    beside.add_column(width=taken, no_wrap=True)
    beside.add_column(ratio=1, vertical="middle")
    beside.add_row(world_map(world, rows), _feedback(goal, width=width - taken - 2, rows=rows))
    return Group(head, beside, progress)


def _feedback(goal: GoalView, *, width: int, rows: int) -> Picture:
    """The last feedback. If the goal is somebody else's, earlier feedback is unknown."""
    if goal.goal is None and goal.feedback is None:
        return cut("  no feedback since you watch", "dim")
    return feedback_table(goal.feedback, width=width, rows=rows)


NARROWEST_BOARD: Final = 30
"""How many columns a map leaves for the goals beside it."""

WIDE: Final = 72
"""The width from which a table shows goal ids and progress too."""

LEAST_LOG: Final = 3
"""How many lines a map leaves for the log below it."""


class GoalRow(NamedTuple):
    """A goal in a table.

    Attributes:
        name: The action.
        goal_id: The id of the goal, in hexadecimal.
        status: Its state.
        age: How long it has run (s).
        progress: The progress in words.
    """

    name: str
    goal_id: str
    status: GoalStatus
    age: float
    progress: str = ""


class Board(NamedTuple):
    """A server or a robot as it is now.

    Attributes:
        heading: Lines that are always shown.
        world: The world, if there is one.
        goals: The goals, in order; None if there is no table of goals.
        more: How many goals are left out.
        keys: The legend of the keys, beside the map.
        log: The log, the newest line last.
    """

    heading: Sequence[str]
    world: MapView | None = None
    goals: Sequence[GoalRow] | None = None
    more: int = 0
    keys: Sequence[str] = ()
    log: Sequence[str] = ()


def board(view: Board, *, width: int, height: int) -> Picture:
    """The display of a server or a robot: a table beside the map or in its place, then the log.

    Args:
        view: The contents.
        width: The columns of the window.
        height: How many lines to use at most.
    """
    head = [cut(printable(line), "bold") for line in view.heading[:height]]
    left = height - len(head)
    rows = min(HIGHEST, left - 2 - LEAST_LOG, (width - NARROWEST_BOARD) // 2)
    middle: list[Picture]
    if view.world is None or rows < LOWEST:
        middle = _table(view, width, max(left - LEAST_LOG, 0))
        left -= len(middle)
    else:
        taken = 2 * rows + 2
        beside = Table.grid(padding=(0, 1, 0, 0))
        beside.add_column(width=taken, no_wrap=True)
        beside.add_column(ratio=1)
        table = _table(view, width - taken - 2, rows + 2)
        beside.add_row(world_map(view.world, rows), Group(*table))
        middle = [beside]
        left -= rows + 2
    log = view.log[-left:] if left > 0 else ()
    return Group(*head, *middle, *(cut(printable(line), "dim") for line in log))


def _table(view: Board, width: int, rows: int) -> list[Picture]:
    """The keys and the goals, in at most ``rows`` lines."""
    keys: list[Picture] = [cut(line) for line in view.keys]
    if view.goals is None:
        return keys[:rows]
    left, count = rows - len(keys), len(view.goals) + view.more
    shown = view.goals[: left if count <= left else max(left - 1, 0)]
    table = keys + [_row(goal, width) for goal in shown]
    if not view.goals:
        table.append(cut("no goals yet", "dim"))
    elif len(shown) < count:
        table.append(cut(f"… {count - len(shown)} more", "dim"))
    return table[:rows]


def _row(goal: GoalRow, width: int) -> Picture:
    style = STYLES.get(goal.status, "")
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, overflow="ellipsis", width=min(22, max(width - 23, 4)))
    table.add_column(no_wrap=True, width=9)
    table.add_column(no_wrap=True, justify="right", width=8)
    cells = [
        Text.assemble(("● ", style), (printable(goal.name), "bold")),
        Text(goal.status.name, style),
        Text(_duration(goal.age)),
    ]
    if width >= WIDE:
        table.add_column(no_wrap=True, width=8)
        table.add_column(no_wrap=True, overflow="ellipsis")
        cells += [Text(goal.goal_id[:8], "dim"), Text(goal.progress)]
    table.add_row(*cells)
    return table


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 10_000 else f"{seconds / 3600:.1f} h"
