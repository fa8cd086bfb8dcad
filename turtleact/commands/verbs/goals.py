"""Declares the verbs about goals and the group ``action`` for Typer."""

from __future__ import annotations

import os
import re
import shlex
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.settings import Place, Reach, quoted
from turtleact.commands.verbs import SETTINGS, Job, Verb, new_group
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Csv,
    Domain,
    Flow,
    FullLength,
    Interfaces,
    MessageVerb,
    NoArrays,
    NoStrings,
    Plain,
    ShowTypes,
    Truncate,
    count_of,
    folder,
    in_seconds,
    journal_in,
    message_of,
    name_of,
    on_graph,
    on_known_graph,
    only_one,
    reach,
    span,
    speed_or_max,
    stdin_of,
    style,
    type_and_text,
    type_of,
    whole,
)
from turtleact.errors import InvalidName, UsageError

if TYPE_CHECKING:
    from turtleact.commands.transcript import View
    from turtleact.commands.verbs.options import Look
    from turtleact.node import Node

__all__ = ["action", "app", "moment"]

_GOAL_ID = re.compile(r"[0-9a-f]{4,32}")
_HEXADECIMAL = re.compile(r"[0-9a-fA-F-]+")
_SECONDS = re.compile(r"(?P<whole>[0-9]{1,10})(?:\.(?P<part>[0-9]{0,9}))?")
_LATEST = 2**31 * 1_000_000_000
"""The first time (ns since the epoch) that does not fit in a ``builtin_interfaces/msg/Time``."""

EXAMPLES = """\
[bold]Examples[/]
  turtleact send-goal fibonacci "order: 5" --feedback
  turtleact send-goal patrol "targets: [{x: 9, y: 7}, {x: 5, y: 1}]"
  turtleact send-goal go_to "{x: 2, y: 9}" --speed max --json
"""

EMBEDDED = "Embedded world"
"""The heading of the options that start a world."""

Name: TypeAlias = Annotated[str, name_of("action", "/patrol", completion.actions)]
Type: TypeAlias = Annotated[str | None, type_of("action", is_asked=True)]
PartsOrFolder: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--interfaces",
        "-i",
        metavar="PART|PART",
        help="Print only these parts: GOAL_SERVICE, CANCEL_SERVICE, RESULT_SERVICE, "
        "FEEDBACK_TOPIC, STATUS_TOPIC. Or a folder with more interfaces, as for other verbs.",
    ),
]
Goal: TypeAlias = Annotated[str | None, message_of("goal", "GOAL")]
Feedback: TypeAlias = Annotated[
    bool, typer.Option("--feedback", "-f", help="Print each feedback message.")
]
Timeout: TypeAlias = Annotated[
    float | None,
    in_seconds(
        "--timeout",
        "-t",
        text="Cancel the goal if it takes longer. With 0, exit as soon as a server has accepted "
        "it: the goal goes on.",
    ),
]
Reattach: TypeAlias = Annotated[
    float,
    in_seconds(
        "--reattach", text="If the server is not there yet or goes away, wait so long for it."
    ),
]
Stdin: TypeAlias = Annotated[bool, stdin_of("goal")]
GoalFile: TypeAlias = Annotated[
    Path | None, typer.Option("--goal-file", metavar="PATH", help="Read the goal from a file.")
]
JsonEvents: TypeAlias = Annotated[
    bool, typer.Option("--json", help="Print one JSON object per line, including feedback.")
]
Speed: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="FACTOR",
        help="How fast time passes: 2 is twice as fast as real time; up to 100, or max.",
        autocompletion=completion.words("max"),
        rich_help_panel=EMBEDDED,
    ),
]
Seed: TypeAlias = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        parser=whole,
        help="The seed of its random choices.",
        rich_help_panel=EMBEDDED,
    ),
]
Embedded: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--embedded",
        help="Always start a world in this process. By default, only if no server is in reach.",
        rich_help_panel=EMBEDDED,
    ),
]

AnyName: TypeAlias = Annotated[
    str | None,
    typer.Argument(
        metavar="NAME",
        help="The action. If left out, all actions.",
        autocompletion=completion.actions,
    ),
]
Id: TypeAlias = Annotated[
    str | None,
    typer.Argument(
        metavar="ID",
        help="The goal's id, or its first four digits or more.",
        autocompletion=completion.goal_ids,
    ),
]
IdOrName: TypeAlias = Annotated[
    str | None,
    typer.Argument(
        metavar="ID|NAME",
        help="The goal's id, or its first four digits or more. Or an action with one running goal.",
        autocompletion=completion.goal_ids,
    ),
]
Ids: TypeAlias = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="ID|NAME",
        help="The ids of goals, or actions with one running goal each. With --all or --before, the "
        "action.",
        autocompletion=completion.goal_ids,
    ),
]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")]
Journal: TypeAlias = Annotated[
    Path | None, journal_in(None, "Read this journal instead of asking the servers.")
]
Since: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--since",
        metavar="TIME",
        help="With --journal: only goals accepted within this time, such as 1h, or since then, "
        "such as 2026-11-21T20:15.",
    ),
]
All: TypeAlias = Annotated[
    bool, typer.Option("--all", help="Cancel all goals of the action, or of all actions.")
]
AllPaused: TypeAlias = Annotated[
    bool, typer.Option("--all", help="All goals of the action, or of all actions.")
]
Standing: TypeAlias = Annotated[
    float,
    in_seconds(
        "--timeout", text="If a body does not stand still within this time, its goal goes on."
    ),
]
Before: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--before",
        metavar="TIME",
        help="Cancel the goals accepted up to this time: 2026-11-21T20:15, or seconds since 1970.",
    ),
]

KnownType: TypeAlias = Annotated[str, type_of("action")]
CountActions: TypeAlias = Annotated[bool, count_of("--count-actions")]
Count: TypeAlias = Annotated[bool, count_of("--count")]

_CANCELING = """\
[bold]Examples[/]
  turtleact cancel 71a9 0d4f
  turtleact cancel --all /patrol
  turtleact cancel --before 2026-11-21T20:15:00Z
"""

_PAUSING = """\
[bold]Examples[/]
  turtleact pause 71a9
  turtleact pause --all /patrol
  turtleact resume --all
"""

app = typer.Typer(**SETTINGS)
action = new_group("action")


def _written(*, domain: int, **options: object) -> str:
    """Return the options that select the graph, as text for a command line."""
    if str(domain) != (os.environ.get("ROS_DOMAIN_ID") or "0"):
        options["domain"] = domain
    return "".join(
        f" --{option} {shlex.quote(str(value))}"
        for option, value in options.items()
        if value is not None
    )


@app.command("send-goal", cls=MessageVerb, help=VERBS["send-goal"], epilog=EXAMPLES)
def send_goal(
    name: Name,
    type_name: Type = None,
    goal: Goal = None,
    *,
    feedback: Feedback = False,
    timeout: Timeout = None,
    reattach: Reattach = 0.0,
    stdin: Stdin = False,
    goal_file: GoalFile = None,
    json: JsonEvents = False,
    plain: Plain = False,
    interfaces: Interfaces = None,
    speed: Speed = None,
    seed: Seed = None,
    embedded: Embedded = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Make the job of ``send-goal`` and ``action send_goal``."""
    type_name, goal = type_and_text(type_name, goal, "goal")
    only_one("how it is shown", json=json, plain=plain)
    view: View = "json" if json else "plain" if plain else "auto"
    only_one("the goal", GOAL=goal is not None, stdin=stdin, goal_file=goal_file is not None)
    way = "speed" if speed is not None else "seed" if seed is not None else "embedded"
    is_embedded = embedded or speed is not None or seed is not None
    only_one("where to send it", **{way: is_embedded}, connect=connect is not None)
    if is_embedded and timeout == 0:
        problem = "leaves the goal to a server, and an embedded world ends with the command"
        raise UsageError(f"--timeout 0 {problem}")
    if is_embedded and reattach:
        raise UsageError("--reattach is for servers in other processes, not for an embedded world")
    place = Place(
        1.0 if speed is None else speed_or_max(speed),
        seed or 0,
        None if is_embedded else reach(connect, domain, config),
        folder(interfaces),
        _written(connect=connect, domain=domain, config=config, interfaces=interfaces),
    )

    def job() -> int:
        from turtleact.commands.interfaces import make_known
        from turtleact.commands.message_text import GoalText
        from turtleact.commands.send_goal import Order, run

        path = None if goal_file is None else str(goal_file)
        text = GoalText.read(goal, stdin=stdin, path=path)
        make_known(place.interfaces)
        order = Order(name, type_name, text, place, feedback, timeout, view, reattach)
        return run(order)

    return job


@app.command(cls=Verb, help=VERBS["goals"])
def goals(
    name: AnyName = None,
    *,
    json: Json = False,
    journal: Journal = None,
    since: Since = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``goals``."""
    if journal is not None:
        first = 0 if since is None else _since(since)
        return _read(lambda goals: goals.print_goals(journal, name, first, as_json=json))
    if since is not None:
        raise UsageError("--since needs --journal: servers forget goals soon after their end")
    from turtleact.commands import held_goals

    return on_graph(
        reach(connect, domain, config),
        lambda node: held_goals.print_goals(node, name, as_json=json),
    )


@app.command(cls=Verb, help=VERBS["cancel"], epilog=_CANCELING)
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
        raise UsageError("--all and --before take one action; without one, they mean all actions")
    if not is_many and not given:
        raise UsageError("give the ids of goals, or --all; 'turtleact goals' lists them")
    ids = [] if is_many else [_watched(text) for text in given]
    until = 0 if before is None else moment(before)

    async def look(node: Node) -> int:
        from turtleact.commands import held_goals

        if is_many:
            return await held_goals.cancel_many(node, given[0] if given else None, until)
        return await held_goals.cancel(node, ids)

    return on_graph(reach(connect, domain, config), look)


@app.command(cls=Verb, help=VERBS["pause"], epilog=_PAUSING)
def pause(
    what: Ids = None,
    *,
    all_: AllPaused = False,
    timeout: Standing = 5.0,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``pause``."""
    look = _switch(what or [], is_all=all_, is_paused=True, timeout=timeout)
    return on_graph(reach(connect, domain, config), look)


@app.command(cls=Verb, help=VERBS["resume"])
def resume(
    what: Ids = None,
    *,
    all_: AllPaused = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``resume``."""
    look = _switch(what or [], is_all=all_, is_paused=False, timeout=0.0)
    return on_graph(reach(connect, domain, config), look)


def _switch(given: list[str], *, is_all: bool, is_paused: bool, timeout: float) -> Look:
    """Return a function that pauses or resumes goals, selected by their ids or by their action."""
    if is_all and len(given) > 1:
        raise UsageError("--all takes one action; without one, it means all actions")
    if not is_all and not given:
        raise UsageError("give the ids of goals, or --all; 'turtleact goals' lists them")
    ids = [] if is_all else [_watched(text) for text in given]

    async def look(node: Node) -> int:
        from turtleact.commands import held_goals

        if is_all:
            name = given[0] if given else None
            return await held_goals.switch_all(node, name, is_paused=is_paused, timeout=timeout)
        return await held_goals.switch(node, ids, is_paused=is_paused, timeout=timeout)

    return look


@app.command(cls=Verb, help=VERBS["watch"])
def watch(
    what: IdOrName = None,
    *,
    plain: Plain = False,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``watch``."""
    if what is None:
        raise UsageError(
            "give the id of a goal, or an action with one running goal; 'turtleact goals' lists all"
        )
    options = _written(connect=connect, domain=domain, config=config, interfaces=interfaces)
    where, view = reach(connect, domain, config), _view(plain=plain)
    return _follow(where, interfaces, _watched(what), view, options)


@app.command(cls=Verb, help=VERBS["result"])
def result(
    goal_id: Id = None,
    *,
    journal: Journal = None,
    interfaces: Interfaces = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``result``."""
    if goal_id is None:
        raise UsageError("give the id of a goal; 'turtleact goals' lists them")
    wanted = _goal_id(goal_id)
    if journal is not None:
        return _read(lambda goals: goals.print_result(journal, wanted, folder(interfaces)))
    options = _written(connect=connect, domain=domain, config=config, interfaces=interfaces)
    return _follow(reach(connect, domain, config), interfaces, wanted, None, options)


action.command("send_goal", cls=MessageVerb, help=VERBS["send-goal"], epilog=EXAMPLES)(send_goal)


@action.command("list", cls=Verb)
def list_actions(
    *,
    types: ShowTypes = False,
    count: CountActions = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the actions on the graph."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_list(node, "action", types=types, count=count, hidden=False),
    )


@action.command(cls=Verb)
def info(
    name: Name,
    *,
    types: ShowTypes = False,
    count: Count = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print which nodes serve an action and which are its clients."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_action_info(node, name, types=types, count=count),
    )


@action.command("type", cls=Verb)
def type_(name: Name, *, connect: Connect = None, domain: Domain = 0, config: Config = None) -> Job:
    """Print the type of an action."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config), lambda node: listing.print_type(node, "action", name)
    )


@action.command(cls=Verb)
def find(
    type_name: KnownType,
    *,
    count: CountActions = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """List the actions of a type."""
    from turtleact.commands import listing

    return on_graph(
        reach(connect, domain, config),
        lambda node: listing.print_found(node, "action", type_name, count=count, hidden=False),
    )


@action.command(cls=Verb)
def echo(
    name: Name,
    type_name: Type = None,
    *,
    csv: Csv = False,
    flow: Flow = False,
    full_length: FullLength = False,
    truncate_length: Truncate = 128,
    no_arr: NoArrays = False,
    no_str: NoStrings = False,
    interfaces: PartsOrFolder = None,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """Print the feedback, the states, the requests and the responses of an action."""
    from turtleact.commands import event_echo

    parts = None if interfaces is None else _parts(interfaces, event_echo.PARTS)
    longest = None if full_length else truncate_length
    order = event_echo.Order(
        name,
        type_name,
        style(csv=csv, flow=flow, longest=longest, no_arr=no_arr, no_str=no_str),
        parts or event_echo.PARTS,
    )
    return on_known_graph(
        reach(connect, domain, config),
        Path(interfaces) if interfaces is not None and parts is None else None,
        lambda: lambda node: event_echo.echo_action(node, order),
    )


def moment(text: str) -> int:
    """Parse a moment as nanoseconds since the epoch, above zero.

    Args:
        text: Seconds since the epoch, or a date and time as in ISO 8601. A time without a zone is
            local time.

    Raises:
        UsageError: if the text has neither of these forms, or if the moment is out of range.
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
    """Parse an ISO 8601 date and time as nanoseconds; 0 if the text is not one."""
    from datetime import datetime

    try:
        return round(datetime.fromisoformat(text).timestamp() * 1e6) * 1000
    except (ValueError, OverflowError):
        return 0


def _since(text: str) -> int:
    """Parse the value of ``--since`` as nanoseconds since the epoch.

    The value is a point in time, or a length of time that ends now.

    Raises:
        UsageError: if the text is neither a length of time nor a point in time.
    """
    try:
        return time.time_ns() - round(span(text) * 1e9)
    except typer.BadParameter:
        pass
    try:
        return moment(text)
    except UsageError:
        problem = "takes a length of time such as 1h, or a time such as 2026-11-21T20:15:00Z"
        raise UsageError(f"--since {problem}, not {quoted(text)}") from None


def _parts(text: str, known: tuple[str, ...]) -> list[str] | None:
    """Parse the value of ``--interfaces`` as names of parts of an action, separated by ``|``.

    Return None if the value is a folder instead.

    Raises:
        UsageError: if the value is neither a list of known parts nor a folder.
    """
    parts = [each.strip().upper() for each in text.split("|")]
    if all(each in known for each in parts):
        return parts
    if Path(text).is_dir():
        return None
    words = ", ".join(known)
    raise UsageError(f"--interfaces takes a folder, or some of {words}, not {quoted(text)}")


def _read(look: Callable[[ModuleType], int]) -> Job:
    """Return a job that imports `turtleact.commands.journaled_goals` and passes it to ``look``."""

    def job() -> int:
        from turtleact.commands import journaled_goals

        return look(journaled_goals)

    return job


def _goal_id(text: str) -> str:
    digits = text.replace("-", "").lower()
    if not _GOAL_ID.fullmatch(digits):
        problem = "is not a goal id, which has 32 hexadecimal digits; the first 4 are enough"
        raise UsageError(f"{quoted(text)} {problem}. 'turtleact goals' lists all goals")
    return digits


def _watched(text: str) -> str:
    """Return the text as a goal's id, or as an action's full name, which begins with a slash."""
    from turtleact.names import resolve_name

    if _HEXADECIMAL.fullmatch(text):
        return _goal_id(text)
    try:
        return resolve_name(text)
    except InvalidName:
        return _goal_id(text)  # raises an error


def _view(*, plain: bool) -> View:
    return "plain" if plain else "auto"


def _follow(
    where: Reach, interfaces: Path | None, wanted: str, view: View | None, options: str
) -> Job:
    """Return the job that follows a goal. Without a view, it only waits for the result."""

    def job() -> int:
        from turtleact.commands import held_goals
        from turtleact.commands.interfaces import make_known

        make_known(folder(interfaces))
        return held_goals.run(where, wanted, view, options)

    return job
