"""What a terminal shows of a server or a robot: lines that stay, the map, a table, the log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from rich.console import Group
from rich.table import Table
from rich.text import Text

from turtleact.render.goal import HIGHEST, LOWEST
from turtleact.render.lines import STYLES, Picture, cut, printable
from turtleact.render.world import MapView, world_map

if TYPE_CHECKING:
    from turtleact.goal import GoalStatus

__all__ = ["Board", "GoalRow", "board"]

NARROWEST_TABLE: Final = 30
"""Columns that a map leaves for the goals beside it."""

WIDE: Final = 72
"""Columns from which on a table tells of a goal's id and progress, too."""

LEAST_LOG: Final = 3
"""Lines that a map leaves for the log below it."""


class GoalRow(NamedTuple):
    """A goal in a table.

    Attributes:
        name: The action.
        goal_id: Its id in hexadecimal.
        status: Its state.
        age: How long it has run so far, or ran (s).
        progress: How much is done, in words.
    """

    name: str
    goal_id: str
    status: GoalStatus
    age: float
    progress: str = ""


class Board(NamedTuple):
    """A server or a robot as it is now.

    Attributes:
        heading: Lines that are always there.
        world: The world, if there is one.
        goals: The goals, in the order in which they are shown; None if there are never any.
        more: How many goals there are besides.
        keys: Lines that say which keys there are, beside the map.
        log: What has happened, the newest last.
    """

    heading: Sequence[str]
    world: MapView | None = None
    goals: Sequence[GoalRow] | None = None
    more: int = 0
    keys: Sequence[str] = ()
    log: Sequence[str] = ()


def board(view: Board, *, width: int, height: int) -> Picture:
    """All of it, arranged for a window: the table beside the map, or in its place, then the log.

    Args:
        view: What there is.
        width: Columns of the window.
        height: Lines that may be used.
    """
    head = [cut(printable(line), "bold") for line in view.heading[:height]]
    left = height - len(head)
    rows = min(HIGHEST, left - 2 - LEAST_LOG, (width - NARROWEST_TABLE) // 2)
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
    """The keys, and the goals; at most so many lines."""
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
