"""The verb ``run``. `turtleact.commands.programs` finds and runs the programs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from turtleact.commands import VERBS, completion
from turtleact.commands.app import SETTINGS, Verb, verb
from turtleact.commands.options import Interfaces, argument, flag, ros_domain
from turtleact.commands.output import printable
from turtleact.commands.programs import Program, Programs, run_program, runnable_here
from turtleact.commands.settings import Fleet, Reach, Service, WrongOptions, quoted

__all__ = ["app"]

FIBONACCI = "turtleact.actions.fibonacci"

MOST_LISTED = 40
"""The help lists at most this many programs. A sourced ROS installation has hundreds of them."""

_HELP = "'turtleact run --help' lists what can be run"


class Run(Verb):
    """The command ``run``. Its help lists the programs that can be run here."""

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401  # click's classes
        """Write the help, with the programs that can be run here."""
        known = runnable_here()
        pairs = [f"{package} {name}" for package in sorted(known) for name in known[package]]
        if len(pairs) > MOST_LISTED:
            more = f"and {len(pairs) - MOST_LISTED} more: see 'turtleact pkg executables'"
            pairs[MOST_LISTED:] = [more]
        lines = [printable(f"  {each}").replace("[", r"\[") for each in (*pairs, "FILE.py")]
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
        Literal["auto", "turtleact", "ros"],
        typer.Option(
            metavar="auto|turtleact|ros",
            help="Which rclpy the program imports: turtleact's, or that of a sourced ROS.",
        ),
    ] = "auto",
    embedded: Annotated[
        bool, flag("--embedded", text="Also start a world of turtles, for a rclpy program.")
    ] = False,
    interfaces: Interfaces = None,
) -> int:
    """``run``."""
    rest = list(arguments or ())
    if not package:
        raise WrongOptions(f"what to run is missing: {_HELP}")
    if package.endswith(".py"):
        program: Program | None = _file(package)
        rest = [executable, *rest] if executable else rest
    else:
        program = _chosen(runnable_here(), package, executable)
    if program is None:
        return _run_built_in(package, executable, rest, reach)
    from turtleact.commands.interface_search import make_found
    from turtleact.rclpy.face import Place
    from turtleact.rclpy.program import Options

    make_found(None if interfaces is None else str(interfaces))
    os.environ["ROS_DOMAIN_ID"] = str(reach.domain)  # the program reads it, as in ROS
    place = Place(reach.connect, reach.locks().settings(), is_embedded=embedded)
    return run_program(program, rest, Options(face, place))


def _chosen(known: Programs, package: str, executable: str) -> Program | None:
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
    if not Path(name).is_file():
        raise WrongOptions(f"there is no file {quoted(name)}")
    return Program(name, file=Path(name))


def _run_built_in(package: str, executable: str, arguments: Sequence[str], reach: Reach) -> int:
    """Run a built-in program, and return its exit status."""
    rest = list(arguments)
    if "--domain" in rest[:-1]:
        place = rest.index("--domain")
        reach = reach._replace(domain=ros_domain(rest[place + 1]))
        del rest[place : place + 2]
    if executable == "turtle_teleop_key":
        from turtleact.commands.turtlesim import turtle_teleop_key

        return turtle_teleop_key(rest, reach)
    if rest:
        raise WrongOptions(
            f"{executable} is built in and takes no {quoted(rest[0])}: options of 'run' stand "
            "before the package, and parameters are for 'turtleact param set', once it runs"
        )
    from turtleact.commands.interface_search import make_known
    from turtleact.commands.serving import run

    make_known(None)
    targets = () if package == "turtlesim" else (FIBONACCI,)
    service = Service(
        targets,
        (),
        reach,
        None if targets else Fleet(),
        None,
        reach.locks().settings(),
        True,
        turtlesim_only=True,
        node_name=executable if targets else "turtleact",
    )
    return run(service)
