"""A goal as a terminal shows it: its state, its feedback, how far it is, and the map beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from rich.console import Group
from rich.padding import Padding
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from turtleact.interfaces import to_dict
from turtleact.render.lines import STYLES, Picture, cut, inline, shortened
from turtleact.render.world import MapView, world_map

if TYPE_CHECKING:
    from turtleact.goal import GoalStatus
    from turtleact.interfaces import Message

__all__ = [
    "HIGHEST",
    "LOWEST",
    "GoalView",
    "feedback_table",
    "frame",
    "goal_panel",
    "progress_line",
]

NARROWEST: Final = 40
"""Columns below which there is no map."""

NARROWEST_TABLE: Final = 26
"""Columns that a map leaves for the feedback beside it."""

LOWEST, HIGHEST = 5, 24
"""Rows of a map, without its border."""


class GoalView(NamedTuple):
    """A goal as it is now.

    Attributes:
        name: The action.
        goal: What was sent; None if that is not known.
        goal_id: Its id in hexadecimal.
        status: Its state.
        age: Seconds since it was accepted.
        feedback: The last message, if there is one.
        fraction: How much is done, 0 to 1, if it can be told.
        progress: The same in words.
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
    """A bar, if the fraction is known, and what it says in words."""
    if fraction is None:
        return cut(f"  {text}", "dim")
    line = Table.grid(expand=True, padding=(0, 1, 0, 0))
    line.add_column(ratio=1)
    line.add_column(no_wrap=True, justify="right")
    line.add_row(ProgressBar(total=1.0, completed=fraction), f"{fraction:4.0%}  {text}")
    return Padding(line, (0, 0, 0, 2))


def feedback_table(feedback: Message | None, *, width: int, rows: int) -> Picture:
    """The fields of a message, a row each; long ones are cut, and so are more than ``rows``."""
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
        return Group(head, _feedback(goal, width=width, rows=max(left, 0)), progress)
    taken = 2 * rows + 2
    beside = Table.grid(padding=(0, 1, 0, 0))
    beside.add_column(width=taken, no_wrap=True)
    beside.add_column(ratio=1, vertical="middle")
    beside.add_row(world_map(world, rows), _feedback(goal, width=width - taken - 2, rows=rows))
    return Group(head, beside, progress)


def _feedback(goal: GoalView, *, width: int, rows: int) -> Picture:
    """The last feedback; what came before somebody else's goal was looked at is not known."""
    if goal.goal is None and goal.feedback is None:
        return cut("  no feedback since you watch", "dim")
    return feedback_table(goal.feedback, width=width, rows=rows)
