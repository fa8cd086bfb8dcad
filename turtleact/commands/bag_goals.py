"""``bag goals``: the goals in a bag, as a table or as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import anyio

from turtleact.commands.output import duration, note, say, say_names
from turtleact.interfaces import to_json
from turtleact.interfaces.conversion import to_dict
from turtleact.interfaces.text import flow
from turtleact.names import resolve_name
from turtleact.recording import RecordedGoal, goals

__all__ = ["print_goals"]

HEADINGS = ("id", "action", "state", "took", "feedback", "goal", "result", "reason")

LONGEST = 40
"""A goal or result is cut after so many characters in a table."""


def print_goals(path: Path, name: str | None, *, as_json: bool) -> int:
    """Print the goals in a bag, and return the exit status.

    Raises:
        BagError: if there is no bag, or a place in it is damaged.
        InvalidName: if the name breaks ROS 2's rules.
    """
    actions = None if name is None else [resolve_name(name)]

    async def gather() -> list[RecordedGoal]:
        return await goals(path, actions=actions)

    found = anyio.run(gather)
    if as_json:
        say("".join(f"{_as_json(each)}\n" for each in found))
    elif found:
        rows = [HEADINGS, *map(_row, found)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        say_names("".join(f"{_aligned(row, widths)}\n" for row in rows))
    else:
        note("the bag has no goals")
    return 0


def _aligned(row: tuple[str, ...], widths: list[int]) -> str:
    return "  ".join(map(str.ljust, row, widths)).rstrip()


def _row(goal: RecordedGoal) -> tuple[str, ...]:
    return (
        goal.id.hex(),
        goal.action,
        "rejected" if goal.accepted is False else goal.status.name,
        "" if goal.duration is None else duration(goal.duration),
        str(goal.feedback_count),
        _short(goal.goal),
        _short(goal.result),
        goal.reason if goal.accepted is not False else "",
    )


def _short(message: object) -> str:
    if message is None:
        return "?"
    text = " ".join(flow(to_dict(message)).split())  # type: ignore[arg-type]  # a message
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"


def _as_json(goal: RecordedGoal) -> str:
    values: dict[str, object] = {
        "id": goal.id.hex(),
        "action": goal.action,
        "type": goal.type_name,
        "state": "REJECTED" if goal.accepted is False else goal.status.name,
        "stamp": goal.stamp,
        "duration": goal.duration,
        "feedback": goal.feedback_count,
        "states": [{"stamp": stamp, "state": status.name} for stamp, status in goal.states],
        "goal": None if goal.goal is None else json.loads(to_json(goal.goal)),
        "result": None if goal.result is None else json.loads(to_json(goal.result)),
        "reason": goal.reason,
    }
    return json.dumps(values, ensure_ascii=False)
