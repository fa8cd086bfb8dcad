"""The verbs about goals, and those of ``action`` and ``journal``."""

from __future__ import annotations

import os
import re
import shlex
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.app import SETTINGS, MessageVerb, new_group, verb
from turtleact.commands.options import (
    Interfaces,
    Json,
    Plain,
    ShowTypes,
    argument,
    count_of,
    flag,
    folder,
    in_seconds,
    message_of,
    name_of,
    only_one,
    or_max,
    span,
    speed,
    stdin_of,
    type_and_text,
    type_of,
    value,
    whole,
)
from turtleact.commands.settings import ConnectOptions, WrongOptions, quoted
from turtleact.errors import InvalidName

if TYPE_CHECKING:
    from turtleact.commands.goal_printer import View
    from turtleact.commands.held_goals import Change
    from turtleact.commands.message_text import Style
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
Ids: TypeAlias = Annotated[
    list[str] | None,
    argument(
        "ID|NAME",
        "The ids of goals, or actions with one running goal each. With --all or --before, the "
        "action.",
        completion.goal_ids,
    ),
]
Journal: TypeAlias = Annotated[
    Path | None,
    value(metavar="FILE", text="Read this journal instead of asking the servers."),
]
AllPaused: TypeAlias = Annotated[
    bool, flag("--all", text="All goals of the action, or of all actions.")
]
CountActions: TypeAlias = Annotated[bool, count_of("--count-actions")]

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


def _written(reach: ConnectOptions, interfaces: Path | None) -> str:
    """Return the options that select the graph and the interfaces, as text for a command line."""
    options: dict[str, object] = {
        "connect": ",".join(reach.connect) or None,
        "config": reach.config,
        "interfaces": interfaces,
    }
    if str(reach.domain) != (os.environ.get("ROS_DOMAIN_ID") or "0"):
        options["domain"] = reach.domain
    return "".join(
        f" --{option} {shlex.quote(str(value))}"
        for option, value in options.items()
        if value is not None
    )


Speed: TypeAlias = Annotated[
    Any,  # a number or "max"
    value(
        metavar="FACTOR",
        text="How fast time passes: 2 is twice as fast as real time; up to 100, or max.",
        panel=EMBEDDED,
        parser=or_max(speed),
        autocompletion=completion.words("max"),
    ),
]
Timeout: TypeAlias = Annotated[
    float | None,
    in_seconds(
        *("--timeout", "-t"),
        text="Cancel the goal if it takes longer. With 0, exit as soon as a server has "
        "accepted it: the goal goes on.",
    ),
]
Embedded: TypeAlias = Annotated[
    bool,
    flag(
        "--embedded",
        text="Always start a world in this process. By default, only if no server is in reach.",
        panel=EMBEDDED,
    ),
]
Reattach: TypeAlias = Annotated[
    float,
    in_seconds(
        "--reattach", text="If the server is not there yet or goes away, wait so long for it."
    ),
]


def send_goal(
    reach: ConnectOptions,
    name: Name,
    type_name: Type = None,
    goal: Annotated[str | None, message_of("goal", "GOAL")] = None,
    *,
    feedback: Annotated[
        bool, flag("--feedback", "-f", text="Print each feedback message.")
    ] = False,
    timeout: Timeout = None,
    reattach: Reattach = 0.0,
    stdin: Annotated[bool, stdin_of("goal")] = False,
    goal_file: Annotated[
        Path | None, value(metavar="PATH", text="Read the goal from a file.")
    ] = None,
    json: Annotated[
        bool, flag("--json", text="Print one JSON object per line, including feedback.")
    ] = False,
    plain: Plain = False,
    interfaces: Interfaces = None,
    speed: Speed = None,
    seed: Annotated[
        int | None,
        value(metavar="N", text="The seed of its random choices.", panel=EMBEDDED, parser=whole),
    ] = None,
    embedded: Embedded = False,
) -> int:
    """``send-goal`` and ``action send_goal``."""
    type_name, goal = type_and_text(type_name, goal, "goal")
    only_one("how it is shown", json=json, plain=plain)
    only_one("the goal", GOAL=goal is not None, stdin=stdin, goal_file=goal_file is not None)
    way = "speed" if speed is not None else "seed" if seed is not None else "embedded"
    is_embedded = embedded or speed is not None or seed is not None
    only_one("where to send it", **{way: is_embedded}, connect=bool(reach.connect))
    if is_embedded and timeout == 0:
        problem = "leaves the goal to a server, and an embedded world ends with the command"
        raise WrongOptions(f"--timeout 0 {problem}")
    if is_embedded and reattach:
        raise WrongOptions(
            "--reattach is for servers in other processes, not for an embedded world"
        )
    from turtleact.commands.message_text import GoalText, make_known
    from turtleact.commands.send_goal import GoalRequest, GoalSender

    text = GoalText.read(goal, stdin=stdin, path=folder(goal_file))
    make_known(folder(interfaces))
    request = GoalRequest(
        name,
        type_name,
        text,
        None if is_embedded else reach,
        1.0 if speed is None else speed,
        seed or 0,
        _written(reach, interfaces),
        feedback,
        timeout,
        "json" if json else _view(plain=plain),
        reattach,
    )
    sender = GoalSender(request)
    return sender.interrupts.run(sender.send())


verb(app, "send-goal", cls=MessageVerb, help=VERBS["send-goal"], epilog=EXAMPLES)(send_goal)
verb(action, "send_goal", cls=MessageVerb, help=VERBS["send-goal"], epilog=EXAMPLES)(send_goal)


@verb(app, help=VERBS["goals"])
def goals(
    reach: ConnectOptions,
    name: Annotated[
        str | None, argument("NAME", "The action. If left out, all actions.", completion.actions)
    ] = None,
    *,
    json: Json = False,
    journal: Journal = None,
    since: Annotated[
        str | None,
        value(
            metavar="TIME",
            text="With --journal: only goals accepted within this time, such as 1h, or since "
            "then, such as 2026-11-21T20:15.",
        ),
    ] = None,
) -> int:
    """``goals``."""
    if journal is not None:
        from turtleact.commands.journal import print_goals

        first = 0 if since is None else _since(since)
        return print_goals(journal, name, first, as_json=json)
    if since is not None:
        raise WrongOptions("--since needs --journal: servers forget goals soon after their end")
    from turtleact.commands import graph, held_goals

    return graph.run(reach, partial(held_goals.print_goals, name=name, as_json=json))


@verb(app, help=VERBS["cancel"], epilog=_CANCELING)
def cancel(
    reach: ConnectOptions,
    what: Ids = None,
    *,
    all_: Annotated[
        bool, flag("--all", text="Cancel all goals of the action, or of all actions.")
    ] = False,
    before: Annotated[
        str | None,
        value(
            metavar="TIME",
            text="Cancel the goals accepted up to this time: 2026-11-21T20:15, or seconds since "
            "1970.",
        ),
    ] = None,
) -> int:
    """``cancel``."""
    only_one("which goals are meant", all=all_, before=before is not None)
    until = 0 if before is None else moment(before)
    return _change(reach, what, "cancel", is_many=all_, before=until)


@verb(app, help=VERBS["pause"], epilog=_PAUSING)
def pause(
    reach: ConnectOptions,
    what: Ids = None,
    *,
    all_: AllPaused = False,
    timeout: Annotated[
        float,
        in_seconds(
            "--timeout", text="If a body does not stand still within this time, its goal goes on."
        ),
    ] = 5.0,
) -> int:
    """``pause``."""
    return _change(reach, what, "pause", is_many=all_, timeout=timeout)


@verb(app, help=VERBS["resume"])
def resume(reach: ConnectOptions, what: Ids = None, *, all_: AllPaused = False) -> int:
    """``resume``."""
    return _change(reach, what, "resume", is_many=all_)


def _change(
    reach: ConnectOptions,
    what: list[str] | None,
    change: Change,
    *,
    is_many: bool,
    before: int = 0,
    timeout: float = 0.0,
) -> int:
    """Cancel, pause or resume goals, selected by their ids or by their actions."""
    is_many = is_many or bool(before)
    if not (is_many or what):
        raise WrongOptions("give the ids of goals, or --all; 'turtleact goals' lists them")
    from turtleact.commands import graph, held_goals
    from turtleact.names import resolve_name

    names = [resolve_name(text) if is_many else _id_or_name(text) for text in what or ()]
    selected = held_goals.Selection(names, is_many, before)
    return graph.run(reach, lambda node: held_goals.change(node, selected, change, timeout))


@verb(app, help=VERBS["watch"])
def watch(
    reach: ConnectOptions,
    what: Annotated[
        str | None,
        argument(
            "ID|NAME",
            "The goal's id, or its first four digits or more. Or an action with one running goal.",
            completion.goal_ids,
        ),
    ] = None,
    *,
    plain: Plain = False,
    interfaces: Interfaces = None,
) -> int:
    """``watch``."""
    if what is None:
        raise WrongOptions(
            "give the id of a goal, or an action with one running goal; 'turtleact goals' lists all"
        )
    return _follow(reach, interfaces, _id_or_name(what), _view(plain=plain))


@verb(app, help=VERBS["result"])
def result(
    reach: ConnectOptions,
    goal_id: Annotated[
        str | None,
        argument("ID", "The goal's id, or its first four digits or more.", completion.goal_ids),
    ] = None,
    *,
    journal: Journal = None,
    interfaces: Interfaces = None,
) -> int:
    """``result``."""
    if goal_id is None:
        raise WrongOptions("give the id of a goal; 'turtleact goals' lists them")
    wanted = _goal_id(goal_id)
    if journal is None:
        return _follow(reach, interfaces, wanted, None)
    from turtleact.commands.journal import print_result

    return print_result(journal, wanted, folder(interfaces))


@verb(action, "list")
async def list_actions(
    node: Node, *, types: ShowTypes = False, count: CountActions = False
) -> None:
    """List the actions on the graph."""
    from turtleact.commands import graph

    graph.print_list(node, "action", types=types, count=count, hidden=False)


@verb(action)
async def info(
    node: Node,
    name: Name,
    *,
    types: ShowTypes = False,
    count: Annotated[bool, count_of("--count")] = False,
) -> None:
    """Print which nodes serve an action and which are its clients."""
    from turtleact.commands import graph

    graph.print_action_info(node, name, types=types, count=count)


@verb(action, "type")
async def type_(node: Node, name: Name) -> int:
    """Print the type of an action."""
    from turtleact.commands import graph

    return graph.print_type(node, "action", name)


@verb(action)
async def find(
    node: Node, type_name: Annotated[str, type_of("action")], *, count: CountActions = False
) -> None:
    """List the actions of a type."""
    from turtleact.commands import graph

    graph.print_list(node, "action", type_name=type_name, count=count, hidden=False)


@verb(action)
def echo(
    reach: ConnectOptions,
    name: Name,
    type_name: Type = None,
    *,
    style: Style,
    interfaces: Annotated[
        str | None,
        value(
            *("--interfaces", "-i"),
            metavar="PART|PART",
            text="Print only these parts: GOAL_SERVICE, CANCEL_SERVICE, RESULT_SERVICE, "
            "FEEDBACK_TOPIC, STATUS_TOPIC. Or a folder with more interfaces, as for other verbs.",
        ),
    ] = None,
) -> int:
    """Print the feedback, the states, the requests and the responses of an action."""
    from turtleact.commands import event_echo, graph
    from turtleact.commands.message_text import make_known

    parts = None if interfaces is None else _parts(interfaces, event_echo.PARTS)
    make_known(interfaces if parts is None else None)
    shown = parts or event_echo.PARTS
    return graph.run(
        reach, lambda node: event_echo.echo_action(node, name, type_name, style, shown)
    )


def moment(text: str) -> int:
    """Parse a moment as nanoseconds since the epoch, above zero.

    Args:
        text: Seconds since the epoch, or a date and time as in ISO 8601. A time without a zone is
            local time.

    Raises:
        WrongOptions: if the text has neither of these forms, or if the moment is out of range.
    """
    seconds = _SECONDS.fullmatch(text)
    if seconds:
        nanoseconds = int(seconds["whole"] + (seconds["part"] or "").ljust(9, "0"))
    else:
        nanoseconds = _moment_of_iso(text)
    if not 0 < nanoseconds < _LATEST:
        problem = "takes a time such as 2026-11-21T20:15:00Z, or seconds since 1970"
        raise WrongOptions(f"--before {problem}, not {quoted(text)}")
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
        WrongOptions: if the text is neither a length of time nor a point in time.
    """
    try:
        return time.time_ns() - round(span(text) * 1e9)
    except typer.BadParameter:
        pass
    try:
        return moment(text)
    except WrongOptions:
        problem = "takes a length of time such as 1h, or a time such as 2026-11-21T20:15:00Z"
        raise WrongOptions(f"--since {problem}, not {quoted(text)}") from None


def _parts(text: str, known: tuple[str, ...]) -> list[str] | None:
    """Parse the value of ``--interfaces`` as names of parts of an action, separated by ``|``.

    Return None if the value is a folder instead.

    Raises:
        WrongOptions: if the value is neither a list of known parts nor a folder.
    """
    parts = [each.strip().upper() for each in text.split("|")]
    if all(each in known for each in parts):
        return parts
    if Path(text).is_dir():
        return None
    words = ", ".join(known)
    raise WrongOptions(f"--interfaces takes a folder, or some of {words}, not {quoted(text)}")


def _goal_id(text: str) -> str:
    digits = text.replace("-", "").lower()
    if not _GOAL_ID.fullmatch(digits):
        problem = "is not a goal id, which has 32 hexadecimal digits; the first 4 are enough"
        raise WrongOptions(f"{quoted(text)} {problem}. 'turtleact goals' lists all goals")
    return digits


def _id_or_name(text: str) -> str:
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


def _follow(reach: ConnectOptions, interfaces: Path | None, wanted: str, view: View | None) -> int:
    """Follow a goal. Without a view, only wait for the result."""
    from turtleact.commands import held_goals
    from turtleact.commands.message_text import make_known

    make_known(folder(interfaces))
    return held_goals.run(reach, wanted, view, _written(reach, interfaces))
