"""The verb ``run``, which finds the program to run.

`turtleact.commands.programs` runs the program, unless it is built in.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.app import SETTINGS, Verb, verb
from turtleact.commands.options import (
    Interfaces,
    argument,
    flag,
    folder,
    ros_domain,
    value,
)
from turtleact.commands.output import printable
from turtleact.commands.settings import Fleet, Reach, Service, WrongOptions, quoted

if TYPE_CHECKING:
    from turtleact.commands.programs import Program

__all__ = ["app", "run"]

FIBONACCI = "turtleact.actions.fibonacci"

OWN_OPTIONS = ("--face", "--embedded", "--interfaces", "--connect", "--config")

ROS_OPTIONS = ("--ros-args", "-p", "--param", "--params-file", "-r", "--remap", "__node", "__ns")

MOST_LISTED = 40
"""The help lists at most this many programs. A sourced ROS installation has hundreds of them."""

_HELP = "'turtleact run --help' lists what can be run"


class How(NamedTuple):
    """How to run a user's program.

    Attributes:
        face: Which rclpy the program imports; see `turtleact.rclpy.face`.
        embedded: Whether to also start a world of turtles in the program's process.
        interfaces: A folder with additional interfaces; None if there is none.
        reach: The graph on which the program's rclpy nodes appear.
    """

    face: str
    embedded: bool
    interfaces: str | None
    reach: Reach


class Run(Verb):
    """The command ``run``. Its help lists the programs that can be run here."""

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401  # click's classes
        """Write the help, with the programs that can be run here."""
        from turtleact.commands.packages import runnable_here

        lines = [f"  {line}" for line in _listed(runnable_here())]
        self.epilog = "\n".join(["[bold]What can be run here[/]", *lines])
        super().format_help(ctx, formatter)


app = typer.Typer(**SETTINGS)


@verb(
    app,
    cls=Run,
    help=VERBS["run"],
    # What follows the package belongs to the program, even if it looks like an option of ours.
    context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
)
def run(
    reach: Reach,
    package: Annotated[
        str,
        argument(
            "PACKAGE",
            "The package, such as turtlesim, or a Python file such as lab.py.",
            completion.runnable_packages,
            show_default=False,
        ),
    ] = "",
    executable: Annotated[
        str,
        argument(
            "EXECUTABLE",
            "The program in the package, such as turtlesim_node.",
            completion.executables,
            show_default=False,
        ),
    ] = "",
    arguments: Annotated[
        list[str] | None, argument("ARGUMENTS", "The program's own arguments.", show_default=False)
    ] = None,
    *,
    face: Annotated[
        str,
        value(
            "--face",
            metavar="auto|turtleact|ros",
            text="Which rclpy the program imports: turtleact's, or that of a sourced ROS.",
        ),
    ] = "auto",
    embedded: Annotated[
        bool, flag("--embedded", text="Also start a world of turtles, for a rclpy program.")
    ] = False,
    interfaces: Interfaces = None,
) -> int:
    """``run``."""
    rest = list(arguments or ())
    how = How(face, embedded, folder(interfaces), reach)
    if not package:
        raise WrongOptions(f"what to run is missing: {_HELP}")
    if package.endswith(".py"):
        return _run(_file(package), [executable, *rest] if executable else rest, how)
    from turtleact.commands.packages import runnable_here

    program = _chosen(runnable_here(), package, executable)
    if program is not None:
        return _run(program, rest, how)
    return _run_built_in(package, executable, *_own_domain(rest, reach))


def _listed(known: Mapping[str, Mapping[str, object]]) -> list[str]:
    """The lines of the help that list the programs. At most `MOST_LISTED` programs are listed."""
    pairs = [f"{package} {name}" for package in sorted(known) for name in known[package]]
    left_out = len(pairs) - MOST_LISTED
    if left_out > 0:
        pairs[MOST_LISTED:] = [f"and {left_out} more: see 'turtleact pkg executables'"]
    return [printable(pair).replace("[", r"\[") for pair in (*pairs, "FILE.py")]


def _chosen(
    known: Mapping[str, Mapping[str, Program | None]], package: str, executable: str
) -> Program | None:
    """Find the executable of a package; None if it is built in.

    Raises:
        WrongOptions: if there is no such package or executable. The error suggests the nearest
            name.
    """
    from turtleact.interfaces.definition import did_you_mean

    if package not in known:
        where = "in the working directory, in its src, or in a sourced workspace"
        hint = did_you_mean(package, known)
        raise WrongOptions(f"there is no package {quoted(package)} {where}{hint}; {_HELP}")
    programs = known[package]
    if executable in programs:
        return programs[executable]
    has = f"it has {', '.join(programs)}" if programs else "it has none in Python"
    if not executable:
        raise WrongOptions(f"say which executable of package {quoted(package)} to run: {has}")
    hint = did_you_mean(executable, programs) or f": {has}"
    raise WrongOptions(f"package {quoted(package)} has no executable {quoted(executable)}{hint}")


def _file(name: str) -> Program:
    from turtleact.commands.programs import Program

    if Path(name).is_dir():
        raise WrongOptions(f"{quoted(name)} is a folder, not a Python file")
    if not Path(name).is_file():
        raise WrongOptions(f"there is no file {quoted(name)}")
    return Program(name, file=Path(name))


def _run(program: Program, arguments: Sequence[str], how: How) -> int:
    """Run a user's program, and return its exit status."""
    from turtleact.commands.interface_search import make_found
    from turtleact.commands.programs import run_program
    from turtleact.rclpy.impl.settings import Place
    from turtleact.rclpy.program import Options

    make_found(how.interfaces)
    os.environ["ROS_DOMAIN_ID"] = str(how.reach.domain)  # the program reads it, as in ROS
    config = how.reach.locks().settings()
    place = Place(how.reach.connect, config, is_embedded=how.embedded)
    return run_program(program, arguments, Options(how.face, place))


def _own_domain(arguments: Sequence[str], where: Reach) -> tuple[list[str], Reach]:
    """Remove ``--domain N`` from a built-in program's arguments, and put N into its `Reach`."""
    rest = list(arguments)
    if "--domain" in rest[:-1]:
        place = rest.index("--domain")
        where = where._replace(domain=ros_domain(rest[place + 1]))
        del rest[place : place + 2]
    return rest, where


def _run_built_in(package: str, executable: str, arguments: Sequence[str], where: Reach) -> int:
    """Run a built-in program, and return its exit status."""
    if executable == "turtle_teleop_key":
        from turtleact.commands.turtlesim import turtle_teleop_key

        return turtle_teleop_key(arguments, where)
    if arguments:
        raise WrongOptions(_not_taken(package, executable, arguments))
    from turtleact.commands.interface_search import make_known
    from turtleact.commands.serving import run

    make_known(None)
    targets = () if package == "turtlesim" else (FIBONACCI,)
    service = Service(
        targets,
        (),
        where,
        None if targets else Fleet(),
        None,
        where.locks().settings(),
        True,
        turtlesim_only=True,
        node_name=executable if targets else "turtleact",
    )
    return run(service)


def _not_taken(package: str, executable: str, arguments: Sequence[str]) -> str:
    """Explain why a built-in program does not take these arguments, and what to do."""
    first = arguments[0].partition("=")[0]
    if first in OWN_OPTIONS:
        said = first if first == "--embedded" else f"{first} VALUE"
        right = f"turtleact run {said} {package} {executable}"
        return f"{first} is an option of 'run', so it stands before the package: {right}"
    if first in ROS_OPTIONS:
        return (
            f"{quoted(' '.join(arguments))} is not taken: names cannot be remapped, and parameters "
            "are for 'turtleact param set' and 'load', once it runs"
        )
    problem = f"{executable} takes no {quoted(first)}: it is built in and has no options"
    return f"{problem}. 'turtleact serve' has some: see 'turtleact serve --help'"
