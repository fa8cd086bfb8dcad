"""``send-goal``, as Typer reads it."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.settings import Place
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Domain,
    Interfaces,
    Plain,
    folder,
    message_of,
    only_one,
    reach,
    seconds,
    speed_or_max,
    type_and_text,
    type_of,
    whole,
)
from turtleact.commands.verbs.parsing import SETTINGS, Job, Verb

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.transcript import View

__all__ = ["EXAMPLES", "app", "send_goal"]

EXAMPLES = """\
[bold]Examples[/]
  turtleact send-goal fibonacci "order: 5" --feedback
  turtleact send-goal patrol "targets: [{x: 9, y: 7}, {x: 5, y: 1}]"
  turtleact send-goal go_to "{x: 2, y: 9}" --speed max --json
"""

EMBEDDED = "Embedded world"
"""The heading of its options."""

Name: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The action, such as /patrol.", autocompletion=completion.actions
    ),
]
Type: TypeAlias = Annotated[str | None, type_of("action", is_asked=True)]
Goal: TypeAlias = Annotated[str | None, message_of("goal", "GOAL")]
Feedback: TypeAlias = Annotated[
    bool, typer.Option("--feedback", "-f", help="Print each feedback message.")
]
Timeout: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--timeout",
        "-t",
        metavar="SECONDS",
        parser=seconds,
        help="Cancel the goal if it takes longer. With 0, leave as soon as it is accepted.",
    ),
]
Stdin: TypeAlias = Annotated[bool, typer.Option("--stdin", help="Read the goal from stdin.")]
GoalFile: TypeAlias = Annotated[
    Path | None, typer.Option("--goal-file", metavar="PATH", help="Read the goal from a file.")
]
Json: TypeAlias = Annotated[
    bool, typer.Option("--json", help="Print one JSON object a line, feedback included.")
]
Speed: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="FACTOR",
        help="How fast time passes, up to 100, or max.",
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
        help="Start a world in this process. Without this option, only if no server is in reach.",
        rich_help_panel=EMBEDDED,
    ),
]

app = typer.Typer(**SETTINGS)


@app.command("send-goal", cls=Verb, help=VERBS["send-goal"], epilog=EXAMPLES)
def send_goal(
    name: Name,
    type_name: Type = None,
    goal: Goal = None,
    *,
    feedback: Feedback = False,
    timeout: Timeout = None,
    stdin: Stdin = False,
    goal_file: GoalFile = None,
    json: Json = False,
    plain: Plain = False,
    interfaces: Interfaces = None,
    speed: Speed = None,
    seed: Seed = None,
    embedded: Embedded = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``send-goal`` and ``action send_goal``."""
    type_name, goal = type_and_text(type_name, goal, "goal")
    only_one("how it is shown", json=json, plain=plain)
    view: View = "json" if json else "plain" if plain else "auto"
    only_one("the goal", GOAL=goal is not None, stdin=stdin, goal_file=goal_file is not None)
    way = "speed" if speed is not None else "seed" if seed is not None else "embedded"
    is_embedded = embedded or speed is not None or seed is not None
    only_one("where to send it", **{way: is_embedded}, connect=connect is not None)
    said = {
        "connect": connect,
        "domain": None if str(domain) == (os.environ.get("ROS_DOMAIN_ID") or "0") else domain,
        "config": config,
        "interfaces": interfaces,
    }
    place = Place(
        1.0 if speed is None else speed_or_max(speed),
        seed or 0,
        None if is_embedded else reach(connect, domain, config),
        folder(interfaces),
        "".join(
            f" --{option} {shlex.quote(str(value))}"
            for option, value in said.items()
            if value is not None
        ),
    )

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known
        from turtleact.commands.message_text import GoalText
        from turtleact.commands.send_goal import Order, run

        path = None if goal_file is None else str(goal_file)
        text = GoalText.read(goal, stdin=stdin, path=path, interrupts=interrupts)
        make_known(place.interfaces)
        order = Order(name, type_name, text, place, feedback=feedback, timeout=timeout, view=view)
        return run(order, interrupts)

    return job
