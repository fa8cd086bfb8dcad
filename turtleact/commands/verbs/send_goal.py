"""``send-goal``, as Typer sees it."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import (
    Config,
    Connect,
    Domain,
    Interfaces,
    Job,
    Reach,
    message_of,
    number,
    only_one,
    reach,
    speed_factor,
    type_and_text,
    type_of,
    whole,
)
from turtleact.commands.verbs.grouping import grouped
from turtleact.commands.verbs.reading import Verb

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts
    from turtleact.commands.transcript import View

__all__ = ["EXAMPLES", "Place", "app", "send_goal"]

EXAMPLES = """\b
Examples:
  turtleact send-goal fibonacci "order: 5" --feedback
  turtleact send-goal patrol "targets: [{x: 9, y: 7}, {x: 5, y: 1}]"
  turtleact send-goal go_to "{x: 2, y: 9}" --speed max --json
"""

_Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="The action, such as /patrol.", autocompletion=completing.actions
    ),
]
_Type = Annotated[str | None, type_of("action", is_asked=True)]
_Goal = Annotated[str | None, message_of("goal", "GOAL")]
_Feedback = Annotated[
    bool, typer.Option("--feedback", "-f", help="Print each feedback message, and let it stand.")
]
_Timeout = Annotated[
    str | None,
    typer.Option(
        "--timeout",
        "-t",
        metavar="SECONDS",
        help="Cancel the goal if it takes longer; 0 leaves once it is accepted.",
    ),
]
_Stdin = Annotated[bool, typer.Option("--stdin", help="Read the goal from stdin.")]
_GoalFile = Annotated[
    str | None, typer.Option("--goal-file", metavar="PATH", help="Read the goal from a file.")
]
_Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object a line, feedback included.")
]
_Plain = Annotated[bool, typer.Option("--plain", help="No live display, even on a terminal.")]
_Speed = Annotated[
    str | None,
    typer.Option(
        metavar="FACTOR",
        help="How fast time passes in the embedded world, or max.",
        autocompletion=completing.words("max"),
    ),
]
_Seed = Annotated[
    str | None, typer.Option(metavar="NUMBER", help="What its random choices begin with.")
]
_Embedded = Annotated[
    bool,
    typer.Option(
        "--embedded",
        help="Use a world in this process; so do --speed and --seed, and whoever finds no server.",
    ),
]

app = typer.Typer()


class Place(NamedTuple):
    """Where a goal is sent.

    Attributes:
        speed: Of the embedded world.
        seed: Of the embedded world.
        reach: Where to look for a server first; None means in the embedded world alone.
        interfaces: The folder of interfaces that are to be known; none if None.
        options: Those that say so, as other verbs take them, a space before each.
    """

    speed: float | str = 1.0
    seed: int = 0
    reach: Reach | None = None
    interfaces: str | None = None
    options: str = ""


def _place(
    *,
    speed: _Speed = None,
    seed: _Seed = None,
    embedded: _Embedded = False,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
    interfaces: Interfaces = None,
) -> Place:
    is_embedded = embedded or speed is not None or seed is not None
    way = "speed" if speed is not None else "seed" if seed is not None else "embedded"
    only_one("where to send it", **{way: is_embedded}, connect=connect is not None)
    said = {"connect": connect, "domain": domain, "config": config, "interfaces": interfaces}
    return Place(
        speed_factor("1" if speed is None else speed, or_max=True),
        whole("--seed", seed or "0"),
        None if is_embedded else reach(connect, domain, config),
        interfaces,
        "".join(
            f" --{name} {shlex.quote(text)}" for name, text in said.items() if text is not None
        ),
    )


@app.command("send-goal", cls=Verb, help=VERBS["send-goal"], epilog=EXAMPLES)
@grouped(place=_place)
def send_goal(
    name: _Name,
    type_name: _Type = None,
    goal: _Goal = None,
    *,
    feedback: _Feedback = False,
    timeout: _Timeout = None,
    stdin: _Stdin = False,
    goal_file: _GoalFile = None,
    json: _Json = False,
    plain: _Plain = False,
    place: Place,
) -> Job:
    """``send-goal`` and ``action send_goal``."""
    type_name, goal = type_and_text(type_name, goal, "goal")
    only_one("how it is shown", json=json, plain=plain)
    view: View = "json" if json else "plain" if plain else "auto"
    seconds = None if timeout is None else number("--timeout", timeout)
    only_one("the goal", GOAL=goal is not None, stdin=stdin, goal_file=goal_file is not None)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known
        from turtleact.commands.message_text import GoalText
        from turtleact.commands.send_goal import Order, run

        text = GoalText.read(goal, stdin=stdin, path=goal_file, interrupts=interrupts)
        make_known(place.interfaces)
        order = Order(name, type_name, text, place, feedback=feedback, timeout=seconds, view=view)
        return run(order, interrupts)

    return job
