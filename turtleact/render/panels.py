"""Arranges what a terminal shows about a goal, a server or a robot.

For a goal: its state, feedback and progress, and a map. For a server or a robot: a heading, a map,
a table of goals or of keys, and the log.
"""

from __future__ import annotations

from collections.abc import Sequence
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
"""At least this many columns are left for the feedback beside a map."""

LOWEST, HIGHEST = 5, 24
"""The rows of a map, not counting its border."""


class GoalView(NamedTuple):
    """A goal as it is now.

    Attributes:
        name: The name of the action.
        goal: The goal message; None if it is unknown.
        goal_id: The id of the goal, in hexadecimal.
        status: Its state.
        age: How long ago the goal was accepted (s).
        feedback: The last feedback, if there is one.
        fraction: The progress, 0 to 1, if it is known.
        progress: The progress in words.
        motion: The turtle's motion if it is unusual, such as ``reversing``; otherwise empty.
        is_paused: Whether the goal is paused.
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


def goal_panel(view: GoalView) -> Group:
    """Two lines.

    The first shows the action, the goal's state and its age; the second shows the goal.
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
            f" {view.age:.1f} s",
            _motion(view.motion),
        ),
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
    """The fields of a message, each in a row. Long fields and a long table are cut."""
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
        goal: The goal to show.
        world: The world, if the goal drives a turtle.
        width: The columns of the window.
        height: How many lines to use at most.
    """
    head, progress = goal_panel(goal), progress_line(goal.fraction, goal.progress)
    below = [] if goal.fraction is None and not goal.progress else [progress]
    left = height - 3 - len(below)
    rows = min(HIGHEST, left - 2, (width - NARROWEST_TABLE) // 2)
    if world is None or width < NARROWEST or rows < LOWEST:
        return Group(head, _feedback(goal, width=width, rows=max(left, 0)), *below)
    taken = 2 * rows + 2
    beside = Table.grid(padding=(0, 1, 0, 0))
    beside.add_column(width=taken, no_wrap=True)
    beside.add_column(ratio=1, vertical="middle")
    beside.add_row(world_map(world, rows), _feedback(goal, width=width - taken - 2, rows=rows))
    return Group(head, beside, *below)


def _motion(motion: str) -> tuple[str, str]:
    return (f"  {motion}" if motion else "", "bold yellow")


def _feedback(goal: GoalView, *, width: int, rows: int) -> Picture:
    """The last feedback. If somebody else sent the goal, earlier feedback is unknown."""
    if goal.goal is None and goal.feedback is None:
        return cut("  no feedback since you began to watch", "dim")
    return feedback_table(goal.feedback, width=width, rows=rows)


NARROWEST_BOARD: Final = 30
"""At least this many columns are left for the goals beside a map."""

WIDE: Final = 72
"""A table shows goal ids and progress too if it has at least this many columns."""

SHORTEST: Final = 20
"""The width of the column of names, if no name is longer."""

LONGEST_STATUS: Final = 9
LONGEST_DURATION: Final = 8
"""The widths of the columns beside the names."""

LEAST_LOG: Final = 3
"""At least this many lines are left for the log below a map."""

INDENT: Final = "  "
"""The indent of the second and later lines of a wrapped log line."""


class GoalRow(NamedTuple):
    """A goal in a table.

    Attributes:
        name: The action.
        goal_id: The id of the goal, in hexadecimal.
        status: Its state.
        age: How long the goal has run (s).
        progress: The progress in words.
        turtle: The turtle that the goal drives; empty if it drives none.
        colour: The colour of that turtle.
        targets: Its targets, in order.
        motion: Whether the goal was resumed, and whether it is paused; if not paused, also the
            turtle's motion, as in `GoalView`.
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
    head = _heading(view.heading, width, height)
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
    return Group(*head, *middle, *_log(view.log, width, left))


def _heading(lines: Sequence[str], width: int, height: int) -> list[Picture]:
    """The lines, wrapped between words. They are cut if they need more than half of the height."""
    wrapped = [part for line in lines for part in wrap(printable(line), width) or [""]]
    if len(wrapped) > max(height // 2, len(lines)):
        wrapped = [printable(line) for line in lines]
    return [cut(line, "bold") for line in wrapped[:height]]


def _log(lines: Sequence[str], width: int, rows: int) -> list[Picture]:
    """The newest lines of the log, wrapped between words, in at most ``rows`` lines.

    An error says first what is wrong and where. So if there is no room for a whole line, its
    beginning is shown.
    """
    shown: list[str] = []
    for line in reversed(lines):
        if (left := rows - len(shown)) <= 0:
            break
        parts = [printable(line)]
        if cell_len(parts[0]) > width:
            parts = wrap(parts[0], width, subsequent_indent=INDENT, break_on_hyphens=False)
        if len(parts) > left:
            rest = [part.strip() for part in parts[left:]]
            parts[left - 1 :] = [" ".join([parts[left - 1], *rest])]  # cut at the window's edge
        shown[:0] = parts
    return [cut(part, "dim") for part in shown]


def _table(view: Board, width: int, rows: int) -> list[Picture]:
    """The keys and the goals, in at most ``rows`` lines."""
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
    """A goal in one line, or in several lines if one would cut the name of its action."""
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
    """The turtle, its targets as on the map, and how it moves."""
    text = Text(printable(goal.turtle), goal.colour)
    for target in goal.targets:
        text.append(f" {target.number}{TICK if target.is_reached else ''}", target.style)
    return text.append(*_motion(goal.motion))


def _cut(line: Text) -> Text:
    line.no_wrap, line.overflow = True, "ellipsis"
    return line


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 10_000 else f"{seconds / 3600:.1f} h"
