"""Declares the turtlesim verbs ``teleop`` and ``snapshot`` for Typer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from turtleact.commands import VERBS
from turtleact.commands.settings import Reach, quoted
from turtleact.commands.verbs import SETTINGS, Job, Verb
from turtleact.commands.verbs.options import (
    Config,
    Connect,
    Domain,
    Plain,
    on_graph,
    only_one,
    reach,
)
from turtleact.errors import UsageError

__all__ = ["app", "ros_arguments", "teleop", "turtle_teleop_key"]

SCALE = 2.0
"""The default speeds. Source: turtlesim's teleop_turtle_key.cpp."""

REMAPS = ("turtle1/cmd_vel", "turtle1/rotate_absolute")
SCALES = ("scale_linear", "scale_angular")

Turtle: TypeAlias = Annotated[
    str | None,
    typer.Option("--turtle", metavar="NAME", help="Which turtle. If left out, turtle1."),
]
Linear: TypeAlias = Annotated[
    float, typer.Option("--scale-linear", metavar="SPEED", help="How fast it drives (m/s).")
]
Angular: TypeAlias = Annotated[
    float, typer.Option("--scale-angular", metavar="RATE", help="How fast it turns (rad/s).")
]
Embedded: TypeAlias = Annotated[
    bool, typer.Option("--embedded", help="Start a world in this process.")
]
File: TypeAlias = Annotated[
    Path, typer.Argument(metavar="FILE", help="The picture: NAME.png or NAME.svg.")
]

_SNAPSHOTS = """\
[bold]Examples[/]
  turtleact snapshot turtles.png
  turtleact snapshot turtles.svg --connect tcp/127.0.0.1:7447
"""

app = typer.Typer(**SETTINGS)


class TeleopVerb(Verb):
    """The verb ``teleop``, whose error for a turtle's name names the option for it."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]  # as in `Verb`
        """Parse the arguments, and fail if there is one that is no option."""
        ctx.allow_extra_args = True
        left = super().parse_args(ctx, args)
        if left and not ctx.resilient_parsing:
            ctx.fail(f"Got unexpected extra argument ({left[0]}). Did you mean --turtle {left[0]}?")
        return left


@app.command(cls=TeleopVerb, help=VERBS["teleop"])
def teleop(
    *,
    turtle: Turtle = None,
    scale_linear: Linear = SCALE,
    scale_angular: Angular = SCALE,
    plain: Plain = False,
    embedded: Embedded = False,
    connect: Connect = None,
    domain: Domain = 0,
    config: Config = None,
) -> Job:
    """``teleop``."""
    only_one("where to drive", embedded=embedded, connect=connect is not None)
    where = None if embedded else reach(connect, domain, config)
    speeds = {"--scale-linear": scale_linear, "--scale-angular": scale_angular}
    return _driving(turtle, {}, speeds, where, is_plain=plain)


def turtle_teleop_key(arguments: Sequence[str], where: Reach) -> Job:
    """Return the job that ``run turtlesim turtle_teleop_key`` executes.

    Args:
        arguments: The program's arguments: none, or ``--ros-args`` followed by ROS arguments.
        where: The graph of the turtle.

    Raises:
        UsageError: if the arguments are malformed, or name a topic or parameter that the program
            does not have.
    """
    remaps, parameters = ros_arguments(arguments)
    for kind, given, known in (("topic", remaps, REMAPS), ("parameter", parameters, SCALES)):
        for name in given.keys() - set(known):
            hint = " and ".join(known)
            raise UsageError(f"turtle_teleop_key has no {kind} {quoted(name)}: it has {hint}")
    speeds = {name: _speed(name, parameters.get(name, str(SCALE))) for name in SCALES}
    return _driving(None, remaps, speeds, where, is_plain=False)


@app.command(cls=Verb, help=VERBS["snapshot"], epilog=_SNAPSHOTS)
def snapshot(
    file: File, *, connect: Connect = None, domain: Domain = 0, config: Config = None
) -> Job:
    """``snapshot``."""
    if file.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"FILE must end in .png or .svg, unlike {quoted(str(file))}")
    from turtleact.commands.user_messages import take

    return on_graph(reach(connect, domain, config), lambda node: take(node, file))


def ros_arguments(arguments: Sequence[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Parse the remappings and the parameters that follow ``--ros-args``.

    Raises:
        UsageError: if there is an argument of another kind.
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


def _driving(
    turtle: str | None,
    remaps: dict[str, str],
    speeds: dict[str, float],
    where: Reach | None,
    *,
    is_plain: bool,
) -> Job:
    """Make the job that drives a turtle.

    Args:
        turtle: The turtle's name. If it is None, the name is taken from ``remaps``. If ``remaps``
            contains no turtle's name, the job drives turtle1, or the only turtle if there is no
            turtle1.
        remaps: Other names for the turtle's topic and action.
        speeds: The linear speed (m/s) and the angular speed (rad/s), in this order. Error messages
            name each speed by its key.
        where: The graph of the turtle; None to start an embedded world.
        is_plain: Whether to leave out the live map.
    """
    for name, value in speeds.items():
        if not math.isfinite(value):
            raise UsageError(f"{name} is a number, not '{value}'")
    linear, angular = speeds.values()

    def job() -> int:
        from turtleact.commands.teleop import Order, run

        order = Order(
            turtle, remaps, linear=linear, angular=angular, is_plain=is_plain, reach=where
        )
        return run(order)

    return job


def _speed(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{name} is a number, not {quoted(text)}") from None
