"""``goals``, ``cancel``, ``watch`` and ``result``, as Typer sees them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import only_one, quoted
from turtleact.commands.verbs.looking import Look, Plan, on_graph, planned_on_known_graph
from turtleact.commands.verbs.reading import Verb
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.transcript import View
    from turtleact.node import Node

__all__ = ["app", "moment"]

_GOAL_ID = re.compile(r"[0-9a-f]{4,32}")
_SECONDS = re.compile(r"(?P<whole>[0-9]{1,10})(?:\.(?P<part>[0-9]{0,9}))?")

_Name = Annotated[
    str | None,
    typer.Argument(
        metavar="NAME",
        help="The action; all of them if left out.",
        autocompletion=completing.actions,
    ),
]
_Id = Annotated[
    str,
    typer.Argument(
        metavar="ID", help="The goal's id, or how it begins.", autocompletion=completing.goal_ids
    ),
]
_Ids = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="ID...|NAME",
        help="The goals' ids; with --all or --before the action.",
        autocompletion=completing.goal_ids,
    ),
]
_Plain = Annotated[bool, typer.Option("--plain", help="No live display, even on a terminal.")]
_Json = Annotated[bool, typer.Option("--json", help="Print one JSON object a line.")]
_All = Annotated[bool, typer.Option("--all", help="All goals of an action, or of all actions.")]
_Before = Annotated[
    str | None,
    typer.Option(
        "--before",
        metavar="T",
        help="Goals accepted up to then: 2026-11-21T20:15, or seconds since 1970.",
    ),
]

_EXAMPLES = """\b
Examples:
  turtleact cancel 71a9 0d4f
  turtleact cancel --all /patrol
  turtleact cancel --before 2026-11-21T20:15:00Z
"""

app = typer.Typer()


@app.command("goals", cls=Verb, help=VERBS["goals"])
@on_graph
def goals(name: _Name = None, *, json: _Json = False) -> Look:
    """``goals``."""
    from turtleact.commands import held_goals

    return lambda node: held_goals.print_goals(node, name, as_json=json)


@app.command("cancel", cls=Verb, help=VERBS["cancel"], epilog=_EXAMPLES)
@on_graph
def cancel(what: _Ids = None, *, all_: _All = False, before: _Before = None) -> Look:
    """``cancel``."""
    only_one("which goals are meant", all=all_, before=before is not None)
    given = what or []
    is_many = all_ or before is not None
    if is_many and len(given) > 1:
        raise UsageError("--all and --before take one action, or none for all of them")
    if not is_many and not given:
        raise UsageError("give the ids of goals, or --all; 'turtleact goals' lists them")
    ids = [] if is_many else [_goal_id(text) for text in given]
    until = 0 if before is None else moment(before)

    async def look(node: Node) -> int:
        from turtleact.commands import held_goals

        if is_many:
            return await held_goals.cancel_many(node, given[0] if given else None, until)
        return await held_goals.cancel(node, ids)

    return look


@app.command("watch", cls=Verb, help=VERBS["watch"])
@planned_on_known_graph
def watch(goal_id: _Id, *, plain: _Plain = False) -> Plan:
    """``watch``."""
    return _follow(goal_id, "plain" if plain else "auto", hears_feedback=True)


@app.command("result", cls=Verb, help=VERBS["result"])
@planned_on_known_graph
def result(goal_id: _Id) -> Plan:
    """``result``."""
    return _follow(goal_id, "plain", hears_feedback=False)


def moment(text: str) -> int:
    """A moment as nanoseconds since the epoch, above zero.

    Args:
        text: Seconds since the epoch, or a date and time as ISO 8601 says them; the local time if
            it names no zone.

    Raises:
        UsageError: if it is neither.
    """
    seconds = _SECONDS.fullmatch(text)
    if seconds:
        nanoseconds = int(seconds["whole"] + (seconds["part"] or "").ljust(9, "0"))
    else:
        nanoseconds = _moment_of_iso(text)
    if not 0 < nanoseconds < _LATEST:
        problem = "is a time such as 2026-11-21T20:15:00Z, or seconds since 1970"
        raise UsageError(f"--before {problem}, not {quoted(text)}")
    return nanoseconds


_LATEST = 2**31 * 1_000_000_000
"""The first moment that ROS 2's ``builtin_interfaces/msg/Time`` cannot say."""


def _moment_of_iso(text: str) -> int:
    """The same of ISO 8601; 0 if it is not."""
    from datetime import datetime

    try:
        return round(datetime.fromisoformat(text).timestamp() * 1e6) * 1000
    except (ValueError, OverflowError):
        return 0


def _goal_id(text: str) -> str:
    digits = text.replace("-", "").lower()
    if not _GOAL_ID.fullmatch(digits):
        problem = "is no goal id: it has 32 hexadecimal digits, of which the first 4 will do"
        raise UsageError(f"{quoted(text)} {problem}")
    return digits


def _follow(goal_id: str, view: View, *, hears_feedback: bool) -> Plan:
    wanted = _goal_id(goal_id)

    def plan(interrupts: Interrupts) -> Look:
        from turtleact.commands import held_goals, transcript

        telling = transcript.choose_transcript(
            view, wants_feedback=hears_feedback, wants_feedback_live=False
        )
        interrupts.restore = telling.close

        async def look(node: Node) -> int:
            try:
                return await held_goals.follow(node, wanted, telling, hears_feedback=hears_feedback)
            finally:
                telling.close()

        return look

    return plan
