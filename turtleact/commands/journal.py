"""Implements ``goals --journal``, ``result --journal`` and ``journal prune``.

These verbs need no graph, because they work on the file of a journal. It does not matter whether
the server that writes the journal is running, has ended or was killed.
"""

from __future__ import annotations

import json
import time
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from turtleact.commands import VERBS
from turtleact.commands.app import new_group, verb
from turtleact.commands.options import argument, span, value
from turtleact.commands.output import counted, duration, note, say, say_lines, say_table
from turtleact.errors import InvalidMessage, TurtleactError, UsageError
from turtleact.names import resolve_name

if TYPE_CHECKING:
    from turtleact.goals.records import GoalRecord
    from turtleact.interfaces import Message

__all__ = ["app", "print_goals", "print_result"]

SECOND = 10**9
"""The number of nanoseconds in a second."""

HEADINGS = ("id", "action", "state", "age", "took", "reason")

BLOCK = 1000
"""How many goals are printed at a time. A journal may hold more goals than fit in memory."""

app = new_group("journal", VERBS["journal"])


@verb(app)
def prune(
    file: Annotated[Path, argument("FILE", "The journal.")],
    *,
    keep: Annotated[
        float,
        value(
            metavar="TIME",
            text="Keep the goals that ended within this time, such as 7d, 12h or 30min.",
            parser=span,
        ),
    ],
) -> int:
    """Delete goals that ended long ago. A server may be writing the journal meanwhile."""
    from turtleact.journal import database

    count = database.prune(file, time.time_ns() - round(keep * 1e9))
    say(f"deleted {counted(count, 'goal')}\n")
    return 0


def print_goals(path: Path, name: str | None, since: int, *, as_json: bool) -> int:
    """Print the goals of a journal, as a table or as JSON, and return the exit status.

    Args:
        path: The file of the journal.
        name: The name of the action; None for all actions.
        since: Print only goals accepted at or after this time (ns since the epoch); 0 for all
            goals.
        as_json: Whether to print one JSON object per line.

    Raises:
        JournalError: if the journal cannot be read.
        InvalidName: if the name breaks ROS 2's rules.
    """
    from turtleact.journal.database import read_goals

    action = None if name is None else resolve_name(name)
    found = (goal for goal in read_goals(path, since) if action in (None, goal.action))
    now, is_empty = time.time_ns(), True
    widths = [len(heading) for heading in HEADINGS]
    while goals := list(islice(found, BLOCK)):
        if as_json:
            say_lines(_as_json(goal, now) for goal in goals)
        else:
            rows = [_row(goal, now) for goal in goals]
            heading = [HEADINGS] if is_empty else []
            say_table([*heading, *rows], widths)
        is_empty = False
    if is_empty and not as_json:
        note("the journal has no such goal" if action or since else "the journal has no goals")
    return 0


def print_result(path: Path, wanted: str, interfaces: str | None) -> int:
    """Print the result of a goal, and return the exit status.

    Args:
        path: The file of the journal.
        wanted: The beginning of the goal's id (hexadecimal).
        interfaces: A folder with more interface files; None for no folder.

    Raises:
        JournalError: if the journal cannot be read.
        UsageError: if the ids of several goals begin with ``wanted``.
        TurtleactError: if there is no such goal, if the goal has not ended, or if the action's type
            is unknown or has changed.
    """
    from turtleact.journal.database import find_goals

    goals = find_goals(path, wanted)
    if len(goals) > 1:
        shown = ", ".join(goal.id.hex() for goal in goals)
        raise UsageError(f"'{wanted}' is the beginning of several goals: {shown}")
    if not goals:
        raise TurtleactError(f"journal '{path}' has no goal {wanted}")
    from turtleact.commands.goal_printer import EXIT_STATUS, result_text
    from turtleact.commands.message_text import make_known
    from turtleact.goals.client import Outcome

    (goal,) = goals
    if not goal.ended:
        raise TurtleactError(
            f"goal {goal.id.hex()} of {goal.action} has not ended: the journal says "
            f"{goal.status.name}, with {goal.feedback_count} feedback messages"
        )
    make_known(interfaces)
    say(result_text(Outcome(goal.status, _result(goal))))
    if goal.reason:
        note(f"the goal was aborted: {goal.reason}")
    return EXIT_STATUS[goal.status]


def _result(goal: GoalRecord) -> Message:
    from turtleact.commands.graph import interface_class
    from turtleact.interfaces import Action, WireFormat, type_hash

    action_type = interface_class(Action, goal.type_name, f"action '{goal.action}'")
    if not goal.result and goal.type_hash != type_hash(action_type):
        return action_type.Result()  # the goal was ended because its type had changed
    try:
        if goal.type_hash == type_hash(action_type):
            result: Message = WireFormat(action_type.Result).decode(goal.result)
            return result
    except InvalidMessage:
        pass
    reason = f" ({' '.join(goal.reason.split())})" if goal.reason else ""
    raise TurtleactError(
        f"goal {goal.id.hex()} has ended {goal.status.name}{reason}, but its result cannot be "
        f"read: {goal.type_name} has changed since the goal was accepted"
    )


def _row(goal: GoalRecord, now: int) -> tuple[str, ...]:
    took = duration(_seconds(goal.ended - goal.accepted)) if goal.ended else ""
    age = duration(_seconds(now - goal.accepted))
    state = f"{goal.status.name}{' (paused)' if goal.is_paused and not goal.ended else ''}"
    return goal.id.hex(), goal.action, state, age, took, " ".join(goal.reason.split())


def _as_json(goal: GoalRecord, now: int) -> str:
    return json.dumps(
        {
            "id": goal.id.hex(),
            "action": goal.action,
            "type": goal.type_name,
            "state": goal.status.name,
            "paused": goal.is_paused and not goal.ended,
            "stamp": _time(goal.stamp),
            "age": _seconds(now - goal.accepted),
            "accepted": _time(goal.accepted),
            "ended": _time(goal.ended) if goal.ended else None,
            "reason": goal.reason,
            "feedback_count": goal.feedback_count,
            "crashes": goal.crashes,
        }
    )


def _time(moment: int) -> dict[str, int]:
    sec, nanosec = divmod(moment, SECOND)
    return {"sec": sec, "nanosec": nanosec}


def _seconds(nanoseconds: int) -> float:
    return max(0, nanoseconds) / SECOND  # the clock may have been set back
