"""``teleop``, as Typer sees it, and the arguments of ``run turtlesim turtle_teleop_key``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs.arguments import Config, Connect, Domain, Job, only_one, quoted, reach
from turtleact.commands.verbs.reading import Verb
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["app", "ros_arguments", "teleop", "turtle_teleop_key"]

SCALE = "2.0"
"""The speeds, unless something else is said; source: turtlesim's teleop_turtle_key.cpp."""

REMAPS = ("turtle1/cmd_vel", "turtle1/rotate_absolute")
SCALES = ("scale_linear", "scale_angular")

_Turtle = Annotated[
    str | None, typer.Option("--turtle", metavar="NAME", help="Which turtle; turtle1 if left out.")
]
_Linear = Annotated[
    str, typer.Option("--scale-linear", metavar="SPEED", help="How fast it goes ahead (m/s).")
]
_Angular = Annotated[
    str, typer.Option("--scale-angular", metavar="RATE", help="How fast it turns (rad/s).")
]
_Plain = Annotated[bool, typer.Option("--plain", help="No live map, even on a terminal.")]
_Embedded = Annotated[
    bool, typer.Option("--embedded", help="Use a world in this process, whatever is in reach.")
]

app = typer.Typer()


@app.command("teleop", cls=Verb, help=VERBS["teleop"])
def teleop(
    *,
    turtle: _Turtle = None,
    scale_linear: _Linear = SCALE,
    scale_angular: _Angular = SCALE,
    plain: _Plain = False,
    embedded: _Embedded = False,
    connect: Connect = None,
    domain: Domain = None,
    config: Config = None,
) -> Job:
    """``teleop``."""
    linear = _speed("--scale-linear", scale_linear)
    angular = _speed("--scale-angular", scale_angular)
    only_one("where to drive", embedded=embedded, connect=connect is not None)
    where = None if embedded else reach(connect, domain, config)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.teleop import Order, run

        order = Order(turtle, {}, linear=linear, angular=angular, is_plain=plain, reach=where)
        return run(order, interrupts)

    return job


def turtle_teleop_key(arguments: Sequence[str], domain: str | None) -> Job:
    """``run turtlesim turtle_teleop_key``.

    Args:
        arguments: What ROS 2 takes behind ``--ros-args``.
        domain: As for ``teleop``.

    Raises:
        UsageError: if they are none, or nothing here has those names.
    """
    remaps, parameters = ros_arguments(arguments)
    for kind, given, known in (("topic", remaps, REMAPS), ("parameter", parameters, SCALES)):
        for name in given.keys() - set(known):
            hint = " and ".join(known)
            raise UsageError(f"turtle_teleop_key has no {kind} {quoted(name)}: it has {hint}")
    linear, angular = (_speed(name, parameters.get(name, SCALE)) for name in SCALES)
    where = reach(None, domain)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.teleop import Order, run

        order = Order(None, remaps, linear=linear, angular=angular, is_plain=False, reach=where)
        return run(order, interrupts)

    return job


def ros_arguments(arguments: Sequence[str]) -> tuple[dict[str, str], dict[str, str]]:
    """The remappings and the parameters that ``--ros-args`` gives.

    Raises:
        UsageError: if there is anything else.
    """
    remaps: dict[str, str] = {}
    parameters: dict[str, str] = {}
    kinds = {"-r": remaps, "--remap": remaps, "-p": parameters, "--param": parameters}
    if arguments and arguments[0] != "--ros-args":
        raise UsageError(f"expected --ros-args, not {quoted(arguments[0])}")
    words: Iterator[str] = iter(arguments[1:])
    for option in words:
        if option not in kinds:
            raise UsageError(f"--ros-args are -r FROM:=TO and -p NAME:=VALUE, not {quoted(option)}")
        name, separator, value = next(words, "").partition(":=")
        if not (name and separator and value):
            raise UsageError(f"{option} takes NAME:=VALUE, such as {REMAPS[0]}:=turtle2/cmd_vel")
        kinds[option][name.removeprefix("/")] = value
    return remaps, parameters


def _speed(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{option} is a number, not {quoted(text)}")
    return value
