"""``run``, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from turtleact.commands import VERBS
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import Domain, Job, quoted, reach
from turtleact.commands.verbs.reading import Verb
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from turtleact.commands.interrupts import Interrupts

__all__ = ["app"]

_FIBONACCI = "turtleact.actions.fibonacci"

_PROGRAMS = (
    ("turtlesim", "turtlesim_node"),
    ("turtlesim", "turtle_teleop_key"),
    ("action_tutorials_py", "fibonacci_action_server"),
    ("action_tutorials_cpp", "fibonacci_action_server"),
    ("examples_rclpy_minimal_action_server", "server"),
    ("examples_rclcpp_minimal_action_server", "action_server_member_functions"),
)
"""The programs of ROS 2 that have their like here; those of other packages serve Fibonacci."""

_RosArguments = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="--ros-args ...", help="Of turtle_teleop_key: -r FROM:=TO, -p NAME:=VALUE."
    ),
]

app = typer.Typer()


@app.command("run", cls=Verb, help=VERBS["run"], context_settings={"ignore_unknown_options": True})
def run(
    package: Annotated[
        str,
        typer.Argument(
            metavar="PACKAGE",
            help="turtlesim or action_tutorials_py.",
            autocompletion=completing.words(*dict.fromkeys(package for package, _ in _PROGRAMS)),
        ),
    ],
    executable: Annotated[
        str,
        typer.Argument(
            metavar="EXECUTABLE",
            help="turtlesim_node, turtle_teleop_key or fibonacci_action_server.",
            autocompletion=completing.words(*(name for _, name in _PROGRAMS)),
        ),
    ],
    arguments: _RosArguments = None,
    *,
    domain: Domain = None,
) -> Job:
    """``run``: the programs of ROS 2 that have their like here."""
    if (package, executable) not in _PROGRAMS:
        known = ", ".join(f"'{package} {executable}'" for package, executable in _PROGRAMS)
        raise UsageError(
            f"'{package} {executable}' is not there: turtleact runs {known}; your own actions are "
            "for 'turtleact serve module:object'"
        )
    if executable == "turtle_teleop_key":
        from turtleact.commands.verbs.teleop import turtle_teleop_key

        return turtle_teleop_key(arguments or (), domain)
    if arguments:
        raise UsageError(
            f"{quoted(' '.join(arguments))} is not taken: names stay as they are, and parameters "
            "are for 'turtleact param set' and 'load', once it runs"
        )
    from turtleact.commands.verbs.serve import Fleet, serve

    if package != "turtlesim":
        return serve([_FIBONACCI], no_sim=True, domain=domain)
    where = reach(domain=domain)

    def job(interrupts: Interrupts) -> int:
        from turtleact.commands.interfaces import make_known
        from turtleact.commands.serve import Service, run

        make_known(None)
        turtlesim = Service(
            (), (), where, Fleet(), None, where.locks().settings(), True, turtlesim_only=True
        )
        return run(turtlesim, interrupts)

    return job
