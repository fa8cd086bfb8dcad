"""The turtlesim verbs ``teleop`` and ``snapshot``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.app import SETTINGS, Verb, verb
from turtleact.commands.options import Embedded, Plain, argument, only_one, value
from turtleact.commands.output import say
from turtleact.commands.settings import ConnectOptions, WrongOptions, quoted
from turtleact.errors import ServerUnavailable, ServiceTimeout, TurtleactError

if TYPE_CHECKING:
    from turtleact.node import Node

__all__ = ["app", "turtle_teleop_key"]

SCALE = 2.0
"""The default speeds. Source: turtlesim's teleop_turtle_key.cpp."""

PATIENCE = 10.0
"""How long to wait for a world's picture, which a thread draws (s, wall clock)."""

REMAPS = ("turtle1/cmd_vel", "turtle1/rotate_absolute")
SCALES = ("scale_linear", "scale_angular")

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


@verb(app, cls=TeleopVerb, help=VERBS["teleop"])
def teleop(
    reach: ConnectOptions,
    *,
    turtle: Annotated[
        str | None,
        value(metavar="NAME", text="Which turtle. If left out, turtle1."),
    ] = None,
    scale_linear: Annotated[
        float, value(metavar="SPEED", text="How fast it drives (m/s).")
    ] = SCALE,
    scale_angular: Annotated[
        float, value(metavar="RATE", text="How fast it turns (rad/s).")
    ] = SCALE,
    plain: Plain = False,
    embedded: Embedded = False,
) -> int:
    """``teleop``."""
    only_one("where to drive", embedded=embedded, connect=bool(reach.connect))
    from turtleact.commands.teleop import TeleopOptions, run

    where = None if embedded else reach
    return run(TeleopOptions(turtle, {}, scale_linear, scale_angular, plain, where))


def turtle_teleop_key(arguments: Sequence[str], where: ConnectOptions) -> int:
    """Run ``turtlesim turtle_teleop_key``, and return the exit status.

    Args:
        arguments: The program's arguments: none, or ``--ros-args`` followed by ROS arguments.
        where: The graph of the turtle.

    Raises:
        WrongOptions: if the arguments are malformed, or name a topic or parameter that the program
            does not have.
    """
    remaps, parameters = _ros_arguments(arguments)
    for kind, given, known in (("topic", remaps, REMAPS), ("parameter", parameters, SCALES)):
        for name in given.keys() - set(known):
            hint = " and ".join(known)
            raise WrongOptions(f"turtle_teleop_key has no {kind} {quoted(name)}: it has {hint}")
    linear, angular = (_speed(name, parameters.get(name, str(SCALE))) for name in SCALES)
    from turtleact.commands.teleop import TeleopOptions, run

    return run(TeleopOptions(None, remaps, linear, angular, is_plain=False, reach=where))


@verb(app, help=VERBS["snapshot"], epilog=_SNAPSHOTS)
def snapshot(
    reach: ConnectOptions,
    file: Annotated[Path, argument("FILE", "The picture: NAME.png or NAME.svg.")],
) -> int:
    """``snapshot``."""
    if file.suffix.lower() not in (".png", ".svg"):
        raise WrongOptions(f"FILE must end in .png or .svg, unlike {quoted(str(file))}")
    from turtleact.commands import graph

    return graph.run(reach, lambda node: _take(node, file))


async def _take(node: Node, path: Path) -> int:
    """Ask the world for a picture, and write the picture to a file.

    Raises:
        ServerUnavailable: if there is no world on the graph.
        ServiceTimeout: if the world does not answer.
        TurtleactError: if the world cannot make the picture, or the file cannot be written.
    """
    import anyio

    from turtleact.sim.world_services import TakeSnapshot
    from turtleact.transports.graph import types_by_name

    services = types_by_name(node.transport.endpoints(), "service")
    names = [name for name, types in services.items() if TakeSnapshot.type_name in types]
    if not names:
        problem = "there is no world on this graph: 'turtleact serve' starts one"
        raise ServerUnavailable("/world/snapshot", problem, kind="service")
    client = node.service_client(TakeSnapshot, names[0])
    kind = path.suffix.lower().removeprefix(".")
    answer = None
    with anyio.move_on_after(PATIENCE):
        answer = await client.call(TakeSnapshot.Request(kind))
    if answer is None:
        raise ServiceTimeout(client.name, PATIENCE)
    if answer.problem:
        raise TurtleactError(answer.problem)
    try:
        path.write_bytes(answer.data)
    except OSError as error:
        problem = f"{path} cannot be written: {error.strerror or error}; name another file"
        raise TurtleactError(problem) from None
    say(f"{path}: {len(answer.data)} bytes\n")
    return 0


def _ros_arguments(arguments: Sequence[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Parse the remappings and the parameters that follow ``--ros-args``.

    Raises:
        WrongOptions: if there is an argument of another kind.
    """
    remaps: dict[str, str] = {}
    parameters: dict[str, str] = {}
    kinds = {"-r": remaps, "--remap": remaps, "-p": parameters, "--param": parameters}
    if arguments and arguments[0] != "--ros-args":
        raise WrongOptions(f"expected --ros-args, not {quoted(arguments[0])}")
    words: Iterator[str] = iter(arguments[1:])
    for option in words:
        if option not in kinds:
            problem = "are -r FROM:=TO and -p NAME:=VALUE"
            raise WrongOptions(f"--ros-args {problem}, not {quoted(option)}")
        name, separator, given = next(words, "").partition(":=")
        if not (name and separator and given):
            raise WrongOptions(f"{option} takes NAME:=VALUE, such as {REMAPS[0]}:=turtle2/cmd_vel")
        kinds[option][name.removeprefix("/")] = given
    return remaps, parameters


def _speed(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise WrongOptions(f"{name} is a number, not {quoted(text)}") from None
