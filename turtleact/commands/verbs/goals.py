"""``goals``, ``cancel``, ``watch`` and ``result``, as Typer reads them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.settings import quoted
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Domain,
    Interfaces,
    Plain,
    on_graph,
    on_known_graph,
    only_one,
    reach,
)
from turtleact.commands.verbs.parsing import SETTINGS, Job, Verb
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.transcript import View
    from turtleact.commands.verbs.options import Look, Plan
    from turtleact.node import Node

__all__ = ["app", "moment"]

_GOAL_ID = re.compile(r"[0-9a-f]{4,32}")
_SECONDS = re.compile(r"(?P<whole>[0-9]{1,10})(?:\.(?P<part>[0-9]{0,9}))?")
_LATEST = 2**31 * 1_000_000_000
"""The first moment that is too late for ROS 2's ``builtin_interfaces/msg/Time``."""

Name: TypeAlias = Annotated[
    str | None,
    typer.Argument(
        metavar="NAME",
        help="The action. If left out, all actions.",
        autocompletion=completion.actions,
    ),
]
Id: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="ID",
        help="The goal's id, or its first four digits or more.",
        autocompletion=completion.goal_ids,
    ),
]
Ids: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="ID|NAME",
        help="The ids of goals. With --all or --before, the action.",
        autocompletion=completion.goal_ids,
    ),
]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print one JSON object a line.")]
All: TypeAlias = Annotated[
    bool, typer.Option("--all", help="Cancel all goals of the action, or of all actions.")
]
Before: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--before",
        metavar="TIME",
        help="Cancel the goals accepted until then: 2026-11-21T20:15, or seconds since 1970.",
    ),
]

_EXAMPLES = """\
[bold]Examples[/]
  turtleact cancel 71a9 0d4f
  turtleact cancel --all /patrol
  turtleact cancel --before 2026-11-21T20:15:00Z
"""

app = typer.Typer(**SETTINGS)


@app.command(cls=Verb, help=VERBS["goals"])
def goals(
    name: Name = None,
    *,
    json: Json = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``goals``."""
    from turtleact.commands import held_goals

    return on_graph(
        reach(connect, domain, config),
        lambda node: held_goals.print_goals(node, name, as_json=json),
    )


@app.command(cls=Verb, help=VERBS["cancel"], epilog=_EXAMPLES)
def cancel(
    what: Ids = None,
    *,
    all_: All = False,
    before: Before = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
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

    return on_graph(reach(connect, domain, config), look)


@app.command(cls=Verb, help=VERBS["watch"])
def watch(
    goal_id: Id,
    *,
    plain: Plain = False,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``watch``."""
    plan = _follow(goal_id, "plain" if plain else "auto", hears_feedback=True)
    return on_known_graph(reach(connect, domain, config), interfaces, plan)


@app.command(cls=Verb, help=VERBS["result"])
def result(
    goal_id: Id,
    *,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``result``."""
    plan = _follow(goal_id, "plain", hears_feedback=False)
    return on_known_graph(reach(connect, domain, config), interfaces, plan)


def moment(text: str) -> int:
    """A moment as nanoseconds since the epoch, above zero.

    Args:
        text: Seconds since the epoch, or a date and time as in ISO 8601; local time if it names no
            zone.

    Raises:
        UsageError: if it is neither.
    """
    seconds = _SECONDS.fullmatch(text)
    if seconds:
        nanoseconds = int(seconds["whole"] + (seconds["part"] or "").ljust(9, "0"))
    else:
        nanoseconds = _moment_of_iso(text)
    if not 0 < nanoseconds < _LATEST:
        problem = "takes a time such as 2026-11-21T20:15:00Z, or seconds since 1970"
        raise UsageError(f"--before {problem}, not {quoted(text)}")
    return nanoseconds


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
        problem = "is not a goal id, which has 32 hexadecimal digits; the first 4 are enough"
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
